"""Small problems with known answers, or small enough for a referee; each is built afresh by its function.

``PROBLEMS`` lists the nonlinear ones, ``linear_quadratic`` has a closed form.
"""

from collections.abc import Callable, Hashable, Mapping
from math import pi

import casadi as cs
import numpy as np

from piaffe import ocp
from piaffe.ocp import rotation
from piaffe.ocp.language.model import Dynamics, Node, Quantities, Reset, Slot
from piaffe.ocp.language.quantity import Bound, Quantity

WISH, LIMIT, WEIGHT = 2.0, 0.5, 3.0
"""The control that :func:`pulling` wishes, its bound, and the weight of the wish."""


def pulling() -> ocp.Problem:
    """Each stage alone wishes a control above its bound; at the bound the multiplier is w (a − b) = 4.5."""
    model = ocp.Model("drift", state={"x": 1}, control={"pull": 1}, modes={"go": lambda s: {"x": s.pull}})
    wish = ocp.track("pull", WEIGHT, to=WISH)
    bound = ocp.Constraints(ocp.inequality(lambda s: s.pull, upper=LIMIT, name="bound", unit="N"))
    motion = ocp.Motion(ocp.Phase("go", "go", 0.5))
    return ocp.Problem(motion, model.until_end(dt=0.1), ocp.Objective(wish), bound, initial=[0.0])


def linear_quadratic() -> ocp.Problem:
    """Three linear models of 4, 3 and 2 states and 2, 1 and 0 controls, with affine resets from one to the next."""
    cart = ocp.Model(
        "cart", state={"a": 2, "b": 2}, control={"push": 2},
        modes={"linear": lambda s: {"a": s.b, "b": s.push - 0.4 * s.a - 0.1 * s.b + cs.DM([0.3, -0.2])}},
    )  # fmt: skip
    spring = ocp.Model(
        "spring", state={"c": 2, "d": 1}, control={"pull": 1},
        modes={"linear": lambda s: {"c": cs.vertcat(s.d, s.c[0] - s.c[1]), "d": s.pull - 2 * s.c[0]}},
    )  # fmt: skip
    decay = ocp.Model(
        "decay", state={"e": 2}, modes={"linear": lambda s: {"e": cs.vertcat(-s.e[0], s.e[0] - 3 * s.e[1])}}
    )
    mix = ocp.reset(lambda s: {"c": cs.vertcat(s.a[0] + 0.5 * s.b[1], s.a[1] - 0.2), "d": -0.7 * s.b[0] + 0.1})
    fold = ocp.reset(lambda s: {"e": cs.vertcat(s.c[0] + s.d, 2 * s.c[1] - 0.3)})
    motion = ocp.Motion(
        ocp.Phase("one", "linear", 0.5, {"a": (1.0, -1.0)}, reset=mix),
        ocp.Phase("two", "linear", 0.4, {"c": (0.5, 0.2)}, reset=fold),
        ocp.Phase("three", "linear", 0.3, {"e": (0.1, -0.4)}),
    )
    objective = ocp.Objective(
        ocp.track("a", (1.0, 2.0)), ocp.track("b", 0.1), ocp.regularize("push", (0.01, 0.03)),
        ocp.track("c", (3.0, 1.0)), ocp.regularize("pull", 0.02), ocp.track("e", 1.0),
        ocp.track("a", 5.0, at="phase_end"), ocp.track("e", 20.0, at="end"),
    )  # fmt: skip
    schedule = cart.over(0.5, dt=0.1) + spring.over(0.4, dt=0.05) + decay.over(0.3, dt=0.1)
    return ocp.Problem(motion, schedule, objective, initial=[0.2, -0.1, 0.0, 0.4])


def bouncing_ball(restitution: float | ocp.Parameter = 0.8, limit: float = 3.0) -> ocp.Problem:
    """A ball with a little thrust hits the ground after 0.45 s and must be high 0.4 s later; the thrust saturates."""
    ball = ocp.Model(
        "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
        modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
    )  # fmt: skip
    motion = ocp.Motion(
        ocp.Phase(
            "drop", "fall", 0.45,
            until=ocp.equality(lambda s: s.z, name="ground", unit="m"),
            reset=ocp.reset(lambda s: {"vz": -restitution * s.vz}),
        ),
        ocp.Phase("rise", "fall", 0.40, {"z": 1.1}),
    )  # fmt: skip
    objective = ocp.Objective(ocp.track("z", 2000.0, at="end"), ocp.regularize("thrust", 1.0))
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.thrust, lower=-limit, upper=limit, name="thrust limit", unit="N")
    )
    return ocp.Problem(motion, ball.until_end(dt=0.025), objective, limits, initial=[1.0, 0.0])


def swing_up() -> ocp.Problem:
    """A cart swings its pole up with a limited force on a short rail."""

    def cart_pole(s):
        sine, cosine = cs.sin(s.angle), cs.cos(s.angle)  # angle 0 hangs, pi stands; cart 1 kg, pole 0.3 kg, 0.5 m
        spread = 1.0 + 0.3 * sine**2
        force = s.force + 0.3 * sine * (0.5 * s.spin**2 + 9.81 * cosine)
        turn = -s.force * cosine - 0.3 * 0.5 * s.spin**2 * cosine * sine - 1.3 * 9.81 * sine
        return {"place": s.speed, "angle": s.spin, "speed": force / spread, "spin": turn / (0.5 * spread)}

    pole = ocp.Model(
        "cart pole", state={"place": 1, "angle": 1, "speed": 1, "spin": 1}, control={"force": 1},
        modes={"swing": cart_pole}, integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("swing", "swing", 1.5, {"angle": pi}))
    objective = ocp.Objective(
        ocp.track("angle", 0.5), ocp.regularize("place", 0.1), ocp.regularize("force", 0.01),
        ocp.track("angle", 50.0, at="end"), ocp.regularize("spin", 5.0, at="end"),
        ocp.regularize("speed", 5.0, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.force, lower=-12, upper=12, name="force limit", unit="N"),
        ocp.inequality(lambda s: s.place, lower=-0.5, upper=0.5, name="rail", unit="m"),
    )
    return ocp.Problem(motion, pole.until_end(dt=0.05), objective, limits, initial=np.zeros(4))


def flying_body() -> ocp.Problem:
    """A rigid body turns by 2.4 rad on its way past a sphere and must arrive with a given attitude at a given place."""
    inertia = cs.DM([0.06, 0.22, 0.27])
    body = ocp.Model(
        "body", control={"force": 3, "torque": 3},
        state={"position": 3, "attitude": "rotation", "velocity": 3, "rate": 3},
        modes={
            "fly": lambda s: {
                "position": s.velocity,
                "attitude": s.rate,
                "velocity": rotation.matrix(s.attitude) @ s.force,
                "rate": (s.torque - cs.cross(s.rate, inertia * s.rate)) / inertia,
            }
        },
    )  # fmt: skip
    goal = rotation.np_from_rpy(np.array([2.4, 0.3, -0.5]))
    motion = ocp.Motion(ocp.Phase("fly", "fly", 1.0, {"position": (1.0, 0.0, 0.2), "attitude": (2.4, 0.3, -0.5)}))
    objective = ocp.Objective(
        ocp.regularize("force", 0.02), ocp.regularize("torque", 1.0), ocp.regularize("velocity", 0.1),
        ocp.track(Quantity("attitude", "rad", "rotation"), 0.1), ocp.regularize("rate", 0.5, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(
        ocp.inequality(lambda s: cs.sumsqr(s.position - cs.DM([0.5, 0.05, 0.1])) - 0.04, name="sphere", unit="m^2"),
        ocp.equality(lambda s: s.position - cs.DM([1.0, 0.0, 0.2]), at="end", name="arrive", unit="m"),
        ocp.equality(
            lambda s: rotation.log(rotation.multiply(rotation.conjugate(cs.DM(goal)), s.attitude)),
            at="end", name="face", unit="rad",
        ),
    )  # fmt: skip
    start = np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], np.zeros(6)])
    return ocp.Problem(motion, body.until_end(dt=0.05), objective, limits, initial=start)


def hopper() -> ocp.Problem:
    """A point mass on a springy leg falls, touches down, pushes off and must reach a height and a place."""

    def flight(s):
        return {"x": s.vx, "z": s.vz, "vx": 0.0 * s.push, "vz": -9.81 + 0.0 * s.push, "foot": s.swing}

    def stance(s):
        length = cs.sqrt((s.x - s.foot) ** 2 + s.z**2)
        pull = (200.0 * (1.0 - length) + s.push) / length
        return {"x": s.vx, "z": s.vz, "vx": pull * (s.x - s.foot), "vz": pull * s.z - 9.81, "foot": 0.0 * s.swing}

    leg = ocp.Model(
        "hopper", state={"x": 1, "z": 1, "vx": 1, "vz": 1, "foot": 1}, control={"push": 1, "swing": 1},
        modes={"flight": flight, "stance": stance}, integrator="rk4",
    )  # fmt: skip

    def reach(s):
        return (s.x - s.foot) ** 2 + s.z**2 - 1.0

    motion = ocp.Motion(
        ocp.Phase("fall", "flight", 0.2, {"x": 0.2, "z": 0.95, "foot": 0.3}, until=ocp.equality(reach, name="touch")),
        ocp.Phase("push", "stance", 0.24, {"x": 0.45, "z": 1.0}, until=ocp.equality(reach, name="leave")),
        ocp.Phase("rise", "flight", 0.2, {"x": 0.65, "z": 1.2}),
    )
    objective = ocp.Objective(
        ocp.regularize("push", 0.01), ocp.regularize("swing", 0.1),
        ocp.track("x", 50.0, at="end"), ocp.track("z", 50.0, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.push, lower=-20, upper=20, name="push limit", unit="N"),
        ocp.inequality(lambda s: s.z, lower=0.87, name="height", unit="m", when="push"),
    )
    return ocp.Problem(motion, leg.until_end(dt=0.02), objective, limits, initial=[0.0, 1.185, 1.0, 0.0, 0.1])


def tumbling() -> ocp.Problem:
    """A free rigid body loses half of its rate on the way, and a quarter turn is added; not among ``PROBLEMS``."""
    inertia = cs.DM([0.06, 0.22, 0.27])

    def fly(s):
        return {"attitude": s.rate, "rate": (s.torque - cs.cross(s.rate, inertia * s.rate)) / inertia}

    body = ocp.Model("tumbling", control={"torque": 3}, state={"attitude": "rotation", "rate": 3}, modes={"fly": fly})
    quarter = cs.DM(rotation.np_from_rpy(np.array([pi / 2, 0.0, 0.0])))
    jolt = ocp.reset(lambda s: {"attitude": rotation.multiply(s.attitude, quarter), "rate": 0.5 * s.rate})
    motion = ocp.Motion(
        ocp.Phase("before", "fly", 0.2, {"attitude": (0.4, 0.3, -0.5)}, reset=jolt),
        ocp.Phase("after", "fly", 0.2, {"attitude": (2.4, 0.3, -0.5)}),
    )
    objective = ocp.Objective(
        ocp.regularize("torque", 1.0),
        ocp.track(Quantity("attitude", "rad", "rotation"), 1.0),
        ocp.regularize("rate", 0.1),
    )
    start = np.array([1.0, 0.0, 0.0, 0.0, 0.5, 0.2, -0.3])
    return ocp.Problem(motion, body.until_end(dt=0.05), objective, initial=start)


PLACE, SPEED, JERK = Quantity("place", "m"), Quantity("speed", "m/s"), Quantity("jerk", "N s")


class Rope(ocp.ModelBase):
    """A mass of 2 kg on a rope of 1 m, slack or taut: dynamics and impact are implicit, as contacts are.

    z is acceleration and tension; ``taut`` flags the tension, ``tightens`` the impulse at a phase's end.
    """

    def __init__(self) -> None:
        state = ocp.Manifold((ocp.Block(PLACE, ("x", "z")), ocp.Block(SPEED, ("x", "z"), rate_of=PLACE)))
        control = ocp.Manifold((ocp.Block(Quantity("force", "N"), ("x", "z")),))
        slots = (Slot("taut", 1, (0.0,)), Slot("tightens", 1, (0.0,)), Slot("mass", 1, (2.0,)))
        super().__init__("rope", state, control, slots=slots)

    def mode_key(self, mode: Hashable) -> str:
        return "rope"

    def node_parameters(self, node: Node) -> dict[str, np.ndarray]:
        tightens = node.next_mode == "taut" and node.mode == "slack"
        return {"taut": np.array([float(node.mode == "taut")]), "tightens": np.array([float(tightens)])}

    def implicit_size(self, key: str) -> int:
        return 3

    def reset_size(self, key: str) -> int:
        return 3

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        place, speed, a, tension, taut = x[:2], x[2:], z[:2], z[2], p["taut"]
        push = p["mass"] * (a + cs.DM([0, 9.81])) - u + taut * tension * place
        pull = taut * (cs.dot(place, a) + cs.sumsqr(speed) + 20 * cs.dot(place, speed)) + (1 - taut) * tension
        blocks = ((self.state.blocks[0], place), (self.state.blocks[1], speed), (self.control.blocks[0], u))
        makers = {b.quantity.path: lambda b=b, v=v: Bound(b.quantity, v, b.labels) for b, v in blocks}
        makers["tension"] = lambda: Bound(Quantity("tension", "N"), tension, ("",), mask=taut)
        next_state = cs.vertcat(place + p["dt"] * speed, speed + p["dt"] * a)
        return Dynamics(
            cs.vertcat(push, pull), next_state, Quantities("rope", makers), outputs=(Quantity("tension", "N"),)
        )

    def lands(self, node: Node) -> bool:
        return bool(self.node_parameters(node)["tightens"][0])

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        place, speed, after, impulse, on = x[:2], x[2:], z[:2], z[2], p["tightens"]
        jump = p["mass"] * (after - speed) + on * impulse * place
        makers = {b.quantity.path: lambda b=b, v=v: Bound(b.quantity, v, b.labels)
                  for b, v in zip(self.state.blocks, (place, speed), strict=True)}  # fmt: skip
        makers["jerk"] = lambda: Bound(JERK, impulse, ("",), mask=on)
        implicit = cs.vertcat(jump, on * cs.dot(place, after) + (1 - on) * impulse)
        return Reset(implicit, cs.vertcat(place, after), Quantities("rope", makers), outputs=(JERK,))

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        place = quantities.bind("place").value
        return Bound(Quantity("length", "m"), cs.sumsqr(place) - 1, ("",), mask=p["tightens"])


def rope(limit: float = 3.0) -> ocp.Problem:
    """A thrown mass falls into its rope and swings up on it; the tension and the force are bounded."""
    model = Rope()
    motion = ocp.Motion(
        ocp.Phase("throw", "slack", 0.4, {"place": (0.75, -0.6)}),
        ocp.Phase("swing", "taut", 0.6, {"place": (-0.6, -0.7)}),
    )
    objective = ocp.Objective(
        ocp.regularize("force", 0.02), ocp.track(SPEED, 0.05), ocp.track(PLACE, 40.0, at="end"),
        ocp.regularize("tension", 1e-3),
    )  # fmt: skip
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.tension, lower=0, upper=60, name="tension", unit="N", scale=10.0),
        ocp.inequality(lambda s: s.force, lower=-limit, upper=limit, name="force limit", unit="N"),
    )
    return ocp.Problem(motion, model.until_end(dt=0.02), objective, limits, initial=[0.2, 0.1, 1.2, 0.0])


def sideways(s: ocp.NodeView) -> cs.SX:
    """Return the horizontal part of the impulse [N s]."""
    return s.jerk * s.place[0]


def jerk_left(s: ocp.NodeView, most: cs.SX) -> cs.SX:
    """Return what the impulse may still grow by [N s]."""
    return most - s.jerk


def jerked_rope(most: float = 7.2) -> ocp.Problem:
    """The rope's impulse has a cost that depends on the speed before it, a largest value, and a given direction."""
    problem = rope()
    jerk = ocp.residual(lambda s: cs.vertcat(s.jerk, s.jerk * s.speed[1]), unit="N s").weighted(
        (0.002, 0.0002), at="phase_end", when="throw", name="jerk"
    )
    tension = ocp.inequality(
        lambda s, most: s.tension, lower=0, upper=60, name="tension", unit="N", scale=10.0, parameters={"most": most},
        at_reset=ocp.ResetRows(
            function=jerk_left, unit="N s", scale=lambda model: 0.5, labels=("impulse",)
        ),
    )  # fmt: skip
    aim = ocp.equality(lambda s: sideways(s) - 5.0, name="aim", unit="N s", scale=2.0, at="phase_end", when="throw")
    objective = ocp.Objective(problem.objective, jerk)
    limits = ocp.Constraints(tension, problem.constraints.terms[1], aim)
    return ocp.Problem(problem.motion, problem.schedule, objective, limits, initial=problem.initial)


HEIGHT, RISE, THRUST, BLOW = (
    Quantity("height", "m"),
    Quantity("rise", "m/s"),
    Quantity("thrust", "N"),
    Quantity("blow", "N s"),
)


class Bouncer(ocp.ModelBase):
    """A mass of 1 kg that bounces at each phase's end: its reset is explicit, without a z, and supplies the impulse."""

    def __init__(self) -> None:
        state = ocp.Manifold((ocp.Block(HEIGHT, ("",)), ocp.Block(RISE, ("",), rate_of=HEIGHT)))
        super().__init__("bouncer", state, ocp.Manifold((ocp.Block(THRUST, ("",)),)))

    def mode_key(self, mode: Hashable) -> str:
        return "fall"

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        next_state = cs.vertcat(x[0] + p["dt"] * x[1], x[1] + p["dt"] * (u - 9.81))
        blocks = (*self.state.blocks, *self.control.blocks)
        makers = {b.quantity.path: lambda b=b, v=v: Bound(b.quantity, v, b.labels)
                  for b, v in zip(blocks, (x[0], x[1], u), strict=True)}  # fmt: skip
        return Dynamics(cs.SX(0, 1), next_state, Quantities("bouncer", makers))

    def lands(self, node: Node) -> bool:
        return node.next_mode is not None

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        makers = {"blow": lambda: Bound(BLOW, -1.8 * x[1], ("",)), "rise": lambda: Bound(RISE, x[1], ("",))}
        return Reset(cs.SX(0, 1), cs.vertcat(x[0], -0.8 * x[1]), Quantities("bouncer", makers), outputs=(BLOW,))


def bouncer(weight: float = 3.0) -> ocp.Problem:
    """The bouncer lands after 0.3 s; the impulse of its bounce has a cost and a largest value."""
    motion = ocp.Motion(ocp.Phase("drop", "falls", 0.3), ocp.Phase("rise", "rises", 0.3))
    objective = ocp.Objective(
        ocp.regularize(THRUST, 0.1), ocp.regularize(BLOW, weight, at="phase_end", when="drop", name="blow")
    )
    limits = ocp.Constraints(
        ocp.equality(lambda s: s.height, at="phase_end", when="drop", name="ground", unit="m"),
        ocp.inequality(lambda s: s.blow, upper=3.0, at="phase_end", when="drop", name="largest blow", unit="N s"),
    )
    return ocp.Problem(motion, Bouncer().until_end(dt=0.02), objective, limits, initial=[0.4, 0.0])


PROBLEMS: Mapping[str, Callable[[], ocp.Problem]] = {
    "bouncing ball": bouncing_ball,
    "swing up": swing_up,
    "flying body": flying_body,
    "hopper": hopper,
    "rope": rope,
    "jerked rope": jerked_rope,
    "bouncer": bouncer,
}
