"""Twenty problems without a solution, two of each kind, as functions of a relaxation of the row at fault.

``CASES`` maps a name to a case: the problem, the constraints that contradict each other, and the problem in which one
of them is relaxed by an amount, by the name of the constraint.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import casadi as cs

from piaffe import ocp


@dataclass(frozen=True)
class Case:
    """A problem without a solution.

    Args:
        problem: returns the problem with the bound of one constraint moved outwards; its arguments are the name of the
            constraint and the distance in the rows' unit. An equality becomes a band of this half-width.
        at_fault: names of the constraints that no trajectory meets together.
    """

    problem: Callable[[str, float], ocp.Problem]
    at_fault: tuple[str, ...]


def _rows(relaxed: str, by: float) -> tuple[Callable[..., object], Callable[..., object]]:
    """Return ``at_most`` and ``equal``: constraints, that of a name relaxed."""

    def at_most(name: str, function: Callable[..., object], upper: float, **more: object) -> object:
        extra = by if name == relaxed else 0.0
        return ocp.inequality(function, upper=upper + extra, name=name, **more)

    def equal(name: str, function: Callable[..., object], **more: object) -> object:
        if name == relaxed:
            return ocp.inequality(function, lower=-by, upper=by, name=name, **more)
        return ocp.equality(function, name=name, **more)

    return at_most, equal


mass = ocp.Model(
    "mass", state={"x": 1, "v": 1}, control={"u": 1},
    modes={"one": lambda s: {"x": s.v, "v": s.u}, "two": lambda s: {"x": s.v, "v": s.u}},
)  # fmt: skip
"""A mass on a line; the two modes are the same."""


def _mass(
    constraints: list[object], *phases: tuple[str, float, str], start: tuple[float, float] = (0.0, 0.0)
) -> ocp.Problem:
    motion = ocp.Motion(*(ocp.Phase(name, mode, duration, {"x": 0.0}) for name, duration, mode in phases))
    objective = ocp.Objective(ocp.regularize("u", 0.1), ocp.regularize("v", 0.1))
    return ocp.Problem(motion, mass.until_end(dt=0.05), objective, ocp.Constraints(*constraints), initial=list(start))


ONE, TWO = (("go", 1.0, "one"),), (("first", 0.6, "one"), ("second", 0.6, "two"))


def bounds_at_one_node(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _mass(
        [at_most("below", lambda s: s.x, 0.2, at="end"), at_most("above", lambda s: -s.x, -0.5, at="end")], *ONE
    )


plane = ocp.Model(
    "plane", state={"x": 1, "y": 1}, control={"u": 1, "w": 1}, modes={"go": lambda s: {"x": s.u, "y": s.w}}
)


def disc_and_half_plane(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    limits = ocp.Constraints(
        at_most("disc", lambda s: s.x**2 + s.y**2, 1.0, at="end"),
        at_most("half plane", lambda s: -s.x - s.y, -1.8, at="end"),
    )
    objective = ocp.Objective(ocp.regularize("u", 1.0), ocp.regularize("w", 1.0))
    motion = ocp.Motion(ocp.Phase("go", "go", 0.8, {"x": 0.0, "y": 0.0}))
    return ocp.Problem(motion, plane.until_end(dt=0.1), objective, limits, initial=[0.1, 0.0])


def there_and_back(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _mass(
        [
            at_most("force", lambda s: cs.vertcat(s.u, -s.u), 6.0),
            at_most("there", lambda s: -s.x, -0.6, at="phase_end", when="first"),
            at_most("back", lambda s: s.x, -0.8, at="phase_end", when="second"),
        ],
        *TWO,
    )


def slow_and_far(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _mass([at_most("speed", lambda s: s.v, 0.5), at_most("far", lambda s: -s.x, -0.9, at="end")], *ONE)


arm = ocp.Model(
    "arm", state={"a": 1, "b": 1}, control={"ra": 1, "rb": 1}, modes={"move": lambda s: {"a": s.ra, "b": s.rb}},
    quantities={
        "tip": lambda s: cs.vertcat(
            0.4 * cs.cos(s.a) + 0.3 * cs.cos(s.a + s.b), 0.4 * cs.sin(s.a) + 0.3 * cs.sin(s.a + s.b)
        )
    },
)  # fmt: skip


def _arm(*constraints: object) -> ocp.Problem:
    objective = ocp.Objective(ocp.regularize("ra", 0.1), ocp.regularize("rb", 0.1))
    motion = ocp.Motion(ocp.Phase("move", "move", 0.8, {"a": 0.5, "b": 0.6}))
    return ocp.Problem(motion, arm.until_end(dt=0.1), objective, ocp.Constraints(*constraints), initial=[0.5, 0.6])


def tip_too_far(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    _, equal = _rows(relaxed, by)
    return _arm(equal("tip", lambda s: s.tip - cs.DM([0.75, 0.2]), at="end"))


def tip_behind_a_stop(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _arm(
        at_most("elbow", lambda s: -s.b, -0.5), at_most("shoulder", lambda s: s.a, 0.6),
        equal("height", lambda s: s.tip[1] - 0.65, at="end"),
    )  # fmt: skip


pendulum = ocp.Model(
    "pendulum", state={"angle": 1, "spin": 1}, control={"torque": 1},
    modes=dict.fromkeys(
        ("swing", "hold"), lambda s: {"angle": s.spin, "spin": s.torque - 9.81 * cs.sin(s.angle)}
    ),
)  # fmt: skip


def _pendulum(*constraints: object) -> ocp.Problem:
    objective = ocp.Objective(ocp.regularize("torque", 0.02), ocp.regularize("spin", 0.02))
    motion = ocp.Motion(
        ocp.Phase("swing", "swing", 0.6, {"angle": 1.2}), ocp.Phase("hold", "hold", 0.4, {"angle": 1.2})
    )
    limits = ocp.Constraints(*constraints)
    return ocp.Problem(motion, pendulum.until_end(dt=0.05), objective, limits, initial=[0.0, 0.0])


def weak_motor_holds(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _pendulum(
        at_most("torque", lambda s: cs.vertcat(s.torque, -s.torque), 7.0),
        equal("held", lambda s: s.angle - 1.2, when="hold"),
    )


def weak_motor_lifts(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _pendulum(
        at_most("torque", lambda s: cs.vertcat(s.torque, -s.torque), 2.0),
        at_most("lifted", lambda s: -s.angle, -1.4, at="end"),
    )


block = ocp.Model(
    "block", state={"x": 1, "v": 1}, control={"pull": 1, "press": 1},
    modes={"slide": lambda s: {"x": s.v, "v": s.pull / 2.0}},
)  # fmt: skip
"""A block of 2 kg that a foot moves by its friction."""


def _block(*constraints: object) -> ocp.Problem:
    objective = ocp.Objective(ocp.regularize("pull", 0.01), ocp.regularize("press", 0.001))
    motion = ocp.Motion(ocp.Phase("slide", "slide", 0.6, {"x": 0.0}))
    limits = ocp.Constraints(*constraints)
    return ocp.Problem(motion, block.until_end(dt=0.05), objective, limits, initial=[0.0, 0.0])


def slippery_start(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _block(
        at_most("cone", lambda s: cs.vertcat(s.pull - 0.4 * s.press, -s.pull - 0.4 * s.press), 0.0),
        at_most("load", lambda s: s.press, 19.62), at_most("place", lambda s: -s.x, -1.2, at="end"),
    )  # fmt: skip


def too_steep(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    weight = 19.62
    return _block(
        at_most("cone", lambda s: cs.vertcat(s.pull - 0.4 * s.press, -s.pull - 0.4 * s.press), 0.0),
        equal("along", lambda s: s.pull - weight * 0.5), at_most("across", lambda s: s.press, weight * 0.87),
    )  # fmt: skip


def early_landing(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _mass(
        [
            at_most("thrust", lambda s: cs.vertcat(s.u, -s.u), 4.0),
            equal("landing", lambda s: s.x + 1.0, at="phase_end", when="first"),
        ],
        *TWO,
    )


def surface_beyond_the_rail(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _mass(
        [
            at_most("rail", lambda s: s.x, 0.5),
            equal("surface", lambda s: s.x + 0.1 * cs.sin(s.v) - 0.8, at="phase_end", when="first"),
            at_most("speed", lambda s: cs.vertcat(s.v, -s.v), 1.5),
        ],
        *TWO,
    )


def too_short(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _mass(
        [
            at_most("force", lambda s: cs.vertcat(s.u, -s.u), 2.0),
            equal("arrival", lambda s: cs.vertcat(s.x - 0.7, s.v), at="end"),
        ],
        *ONE,
    )


def short_flight(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    """The force is zero in the second phase: what the first gives it must be enough."""
    at_most, equal = _rows(relaxed, by)
    return _mass(
        [
            at_most("kick", lambda s: cs.vertcat(s.u, -s.u), 3.0, when="first"),
            equal("flight", lambda s: s.u, when="second"),
            at_most("landing", lambda s: -s.x, -2.0, at="end"),
        ],
        *TWO,
    )


def two_places(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    _, equal = _rows(relaxed, by)
    return _mass([equal("left", lambda s: s.x - 0.3, at="end"), equal("right", lambda s: s.x - 0.5, at="end")], *ONE)


def proportional_rows(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    _, equal = _rows(relaxed, by)
    return _mass(
        [
            equal("sum", lambda s: s.x + s.v - 1.0, at="end"),
            equal("thrice the sum", lambda s: 3 * s.x + 3 * s.v - 2.4, at="end"),
        ],
        *ONE,
    )


def end_beyond_the_path(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _mass([at_most("path", lambda s: s.x, 0.5), equal("end", lambda s: s.x - 0.8, at="end")], *ONE)


def end_faster_than_the_path(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, equal = _rows(relaxed, by)
    return _mass(
        [at_most("path", lambda s: cs.vertcat(s.v, -s.v), 0.3), equal("end", lambda s: s.v - 1.0, at="end")], *ONE
    )


def start_below(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _mass([at_most("floor", lambda s: -s.x, -0.2)], *ONE)


def start_too_fast(relaxed: str = "", by: float = 0.0) -> ocp.Problem:
    at_most, _ = _rows(relaxed, by)
    return _mass(
        [at_most("speed", lambda s: s.v, 1.0), at_most("force", lambda s: cs.vertcat(s.u, -s.u), 3.0)], *ONE,
        start=(0.0, 1.6),
    )  # fmt: skip


CASES: Mapping[str, Case] = {
    "bounds at one node": Case(bounds_at_one_node, ("below", "above")),
    "disc and half plane at one node": Case(disc_and_half_plane, ("disc", "half plane")),
    "there and back": Case(there_and_back, ("force", "there", "back")),
    "slow and far": Case(slow_and_far, ("speed", "far")),
    "tip too far": Case(tip_too_far, ("tip",)),
    "tip behind a stop": Case(tip_behind_a_stop, ("shoulder", "height")),
    "weak motor holds": Case(weak_motor_holds, ("torque", "held")),
    "weak motor lifts": Case(weak_motor_lifts, ("torque", "lifted")),
    "slippery start": Case(slippery_start, ("cone", "load", "place")),
    "too steep": Case(too_steep, ("cone", "along", "across")),
    "early landing": Case(early_landing, ("thrust", "landing")),
    "surface beyond the rail": Case(surface_beyond_the_rail, ("rail", "surface")),
    "too short": Case(too_short, ("force", "arrival")),
    "short flight": Case(short_flight, ("kick", "flight", "landing")),
    "two places": Case(two_places, ("left", "right")),
    "proportional rows": Case(proportional_rows, ("sum", "thrice the sum")),
    "end beyond the path": Case(end_beyond_the_path, ("path", "end")),
    "end faster than the path": Case(end_faster_than_the_path, ("path", "end")),
    "start below": Case(start_below, ("floor",)),
    "start too fast": Case(start_too_fast, ("speed",)),
}
