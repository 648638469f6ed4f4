"""Fourteen small problems for the comparison with Ipopt, each with the weights of its objective times a factor.

They are nearly degenerate on purpose: controls at their bounds most of the time, rows that are active over a whole
phase, weights that differ by many decades, switching surfaces that depend on the state, phases of different sizes.
"""

from collections.abc import Callable, Mapping
from math import pi

import casadi as cs

from piaffe import ocp


def _limit(path: str, bound: float) -> object:
    return ocp.inequality(lambda s: getattr(s, path), lower=-bound, upper=bound, name=f"{path} limit")


def double_integrator(factor: float = 1.0) -> ocp.Problem:
    """A mass moves by 1.9 m in 2.8 s with at most 1 m/s²; the least time is 2.757 s: nearly bang-bang."""
    model = ocp.Model(
        "mass", state={"x": 1, "v": 1}, control={"u": 1}, modes={"go": lambda s: {"x": s.v, "v": s.u}}, integrator="rk4"
    )
    motion = ocp.Motion(ocp.Phase("go", "go", 2.8, {"x": 1.9}))
    limits = ocp.Constraints(
        _limit("u", 1.0),
        ocp.equality(lambda s: cs.vertcat(s.x - 1.9, s.v), at="end", name="arrive"),
    )
    return ocp.Problem(
        motion, model.until_end(dt=0.05), ocp.Objective(ocp.regularize("u", factor)), limits, initial=[0.0, 0.0]
    )


def bryson_denham(factor: float = 1.0) -> ocp.Problem:
    """Bryson and Denham's problem with another bound, x ≤ 0.11, from speed 1 to speed −1 in 1 s."""
    model = ocp.Model(
        "denham", state={"x": 1, "v": 1}, control={"u": 1}, modes={"go": lambda s: {"x": s.v, "v": s.u}},
        integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("go", "go", 1.0, {"x": 0.0}))
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.x, upper=0.11, name="ceiling"),
        ocp.equality(lambda s: cs.vertcat(s.x, s.v + 1.0), at="end", name="arrive"),
    )
    return ocp.Problem(
        motion, model.until_end(dt=0.02), ocp.Objective(ocp.regularize("u", factor)), limits, initial=[0.0, 1.0]
    )


def cart_pole(factor: float = 1.0) -> ocp.Problem:
    """A cart of 0.8 kg swings up a pole of 0.25 kg and 0.6 m with at most 12 N on a rail of ±0.6 m."""

    def move(s):
        sine, cosine, m, length = cs.sin(s.angle), cs.cos(s.angle), 0.25, 0.6
        spread = 0.8 + m * sine**2
        push = s.force + m * sine * (length * s.spin**2 + 9.81 * cosine)
        turn = -s.force * cosine - m * length * s.spin**2 * cosine * sine - (0.8 + m) * 9.81 * sine
        return {"place": s.speed, "angle": s.spin, "speed": push / spread, "spin": turn / (length * spread)}

    model = ocp.Model(
        "cart", state={"place": 1, "angle": 1, "speed": 1, "spin": 1}, control={"force": 1}, modes={"swing": move},
        integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("swing", "swing", 1.6, {"angle": pi}))
    objective = ocp.Objective(
        ocp.track("angle", 0.3 * factor), ocp.regularize("force", 0.02 * factor),
        ocp.track("angle", 60.0 * factor, at="end"), ocp.regularize("spin", 4.0 * factor, at="end"),
        ocp.regularize("place", 4.0 * factor, at="end"), ocp.regularize("speed", 4.0 * factor, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(_limit("force", 12.0), _limit("place", 0.6))
    return ocp.Problem(motion, model.until_end(dt=0.04), objective, limits, initial=[0.0, 0.0, 0.0, 0.0])


def pendulum(factor: float = 1.0) -> ocp.Problem:
    """A pendulum whose motor lifts half of its weight swings up and rests: it must swing to both sides."""
    model = ocp.Model(
        "pendulum", state={"angle": 1, "spin": 1}, control={"torque": 1},
        modes={"swing": lambda s: {"angle": s.spin, "spin": s.torque - 0.1 * s.spin - 9.81 * cs.sin(s.angle)}},
        integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("swing", "swing", 3.0, {"angle": pi}))
    objective = ocp.Objective(
        ocp.regularize("torque", 0.05 * factor), ocp.regularize("spin", 0.01 * factor),
        ocp.track("angle", 0.05 * factor),
    )  # fmt: skip
    limits = ocp.Constraints(
        _limit("torque", 5.0), ocp.equality(lambda s: cs.vertcat(s.angle - pi, s.spin), at="end", name="stand")
    )
    return ocp.Problem(motion, model.until_end(dt=0.05), objective, limits, initial=[0.0, 0.0])


def van_der_pol(factor: float = 1.0) -> ocp.Problem:
    """Van der Pol's oscillator from (0, 1.2) with |u| ≤ 0.8 and y ≥ −0.35."""
    model = ocp.Model(
        "oscillator", state={"y": 1, "v": 1}, control={"u": 1},
        modes={"go": lambda s: {"y": s.v, "v": (1 - s.y**2) * s.v - s.y + s.u}}, integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("go", "go", 6.0, {"y": 0.0}))
    objective = ocp.Objective(
        ocp.regularize("y", 2.0 * factor), ocp.regularize("v", 1.0 * factor), ocp.regularize("u", 1.0 * factor)
    )
    limits = ocp.Constraints(_limit("u", 0.8), ocp.inequality(lambda s: s.y, lower=-0.35, name="floor"))
    return ocp.Problem(motion, model.until_end(dt=0.1), objective, limits, initial=[0.0, 1.2])


def bouncing_balls(factor: float = 1.0) -> ocp.Problem:
    """Two balls, of other restitutions, bounce in turn; a bounded thrust on each must bring both to a height."""

    def fall(s):
        return {"a": s.va, "b": s.vb, "va": s.pa - 9.81, "vb": s.pb - 9.81}

    model = ocp.Model(
        "balls", state={"a": 1, "b": 1, "va": 1, "vb": 1}, control={"pa": 1, "pb": 1}, modes={"fall": fall}
    )
    motion = ocp.Motion(
        ocp.Phase(
            "first", "fall", 0.4, until=ocp.equality(lambda s: s.a, name="ground of a"),
            reset=ocp.reset(lambda s: {"va": -0.75 * s.va}),
        ),
        ocp.Phase(
            "second", "fall", 0.2, until=ocp.equality(lambda s: s.b, name="ground of b"),
            reset=ocp.reset(lambda s: {"vb": -0.6 * s.vb}),
        ),
        ocp.Phase("rise", "fall", 0.3, {"a": 0.9, "b": 0.5}),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.track("a", 300.0 * factor, at="end"), ocp.track("b", 300.0 * factor, at="end"),
        ocp.regularize("pa", 1.0 * factor), ocp.regularize("pb", 0.5 * factor),
    )  # fmt: skip
    limits = ocp.Constraints(_limit("pa", 3.5), _limit("pb", 3.5))
    return ocp.Problem(motion, model.until_end(dt=0.02), objective, limits, initial=[0.8, 1.6, 0.0, 0.0])


def slope(factor: float = 1.0) -> ocp.Problem:
    """A ball lands on a slope of 0.3, where its normal speed reverses in part: the place of landing is free."""
    rise, restitution = 0.3, 0.7
    normal = cs.DM([-rise, 1.0]) / (1 + rise**2) ** 0.5

    def bounce(s):
        velocity = cs.vertcat(s.vx, s.vz)
        after = velocity - (1 + restitution) * cs.dot(normal, velocity) * normal
        return {"vx": after[0], "vz": after[1]}

    def fly(s):
        return {"x": s.vx, "z": s.vz, "vx": s.ax, "vz": s.az - 9.81}

    model = ocp.Model(
        "slope ball", state={"x": 1, "z": 1, "vx": 1, "vz": 1}, control={"ax": 1, "az": 1}, modes={"fly": fly},
        integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(
        ocp.Phase(
            "fall", "fly", 0.45, {"x": 0.3, "z": 0.1},
            until=ocp.equality(lambda s: s.z - rise * s.x - 0.05 * cs.sin(4 * s.x), name="surface"),
            reset=ocp.reset(bounce),
        ),
        ocp.Phase("rise", "fly", 0.35, {"x": -0.2, "z": 0.75}),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.regularize("ax", 0.4 * factor), ocp.regularize("az", 0.4 * factor),
        ocp.track("x", 80.0 * factor, at="end"), ocp.track("z", 80.0 * factor, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(_limit("ax", 4.0), _limit("az", 2.5))
    return ocp.Problem(motion, model.until_end(dt=0.025), objective, limits, initial=[0.0, 1.1, 0.6, 0.0])


def hopper(factor: float = 1.0) -> ocp.Problem:
    """A mass hops: its flight has five states with the angle of its leg, its stance four polar ones."""

    def fly(s):
        return {"x": s.vx, "z": s.vz, "vx": 0 * s.swing, "vz": -9.81 + 0 * s.swing, "lean": s.swing}

    def push(s):
        stretch = s.length * s.turn**2 - 9.81 * cs.cos(s.tilt) + 180.0 * (0.9 - s.length) + s.thrust
        spin = (9.81 * cs.sin(s.tilt) - 2 * s.rate * s.turn) / s.length
        return {"length": s.rate, "tilt": s.turn, "rate": stretch, "turn": spin}

    flight = ocp.Model(
        "flight", state={"x": 1, "z": 1, "vx": 1, "vz": 1, "lean": 1}, control={"swing": 1}, modes={"fly": fly},
        integrator="rk4",
    )  # fmt: skip
    stance = ocp.Model(
        "stance", state={"length": 1, "tilt": 1, "rate": 1, "turn": 1}, control={"thrust": 1}, modes={"push": push},
        integrator="rk4",
    )  # fmt: skip

    def land(s):  # the foot is at x − 0.9 sin(lean): tilt = lean
        sine, cosine = cs.sin(s.lean), cs.cos(s.lean)
        return {
            "length": 0.9 + 0 * s.x, "tilt": s.lean,
            "rate": s.vx * sine + s.vz * cosine, "turn": (s.vx * cosine - s.vz * sine) / 0.9,
        }  # fmt: skip

    def leave(s):
        sine, cosine = cs.sin(s.tilt), cs.cos(s.tilt)
        return {
            "x": s.length * sine, "z": s.length * cosine,
            "vx": s.rate * sine + s.length * s.turn * cosine, "vz": s.rate * cosine - s.length * s.turn * sine,
            "lean": s.tilt,
        }  # fmt: skip

    motion = ocp.Motion(
        ocp.Phase(
            "fall", "fly", 0.2, {"x": 0.2, "z": 0.88, "lean": -0.2},
            until=ocp.equality(lambda s: s.z - 0.9 * cs.cos(s.lean), name="touch"), reset=ocp.reset(land),
        ),
        ocp.Phase(
            "push", "push", 0.26, {"length": 0.85, "tilt": 0.0},
            until=ocp.equality(lambda s: s.length - 0.9, name="let go"), reset=ocp.reset(leave),
        ),
        ocp.Phase("rise", "fly", 0.2, {"x": 0.4, "z": 1.1, "lean": -0.1}),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.regularize("swing", 0.1 * factor), ocp.regularize("thrust", 0.005 * factor),
        ocp.track("x", 30.0 * factor, at="end"), ocp.track("z", 30.0 * factor, at="end"),
        ocp.track("lean", 1.0 * factor, at="end"),
    )  # fmt: skip
    limits = ocp.Constraints(
        _limit("swing", 3.0), _limit("thrust", 18.0), ocp.inequality(lambda s: s.length, lower=0.72, name="knee")
    )
    schedule = flight.over(0.2, dt=0.02) + stance.over(0.26, dt=0.02) + flight.over(0.2, dt=0.02)
    return ocp.Problem(motion, schedule, objective, limits, initial=[0.0, 1.08, 1.1, 0.0, 0.0])


def quadrotor(factor: float = 1.0) -> ocp.Problem:
    """A planar quadrotor of 0.7 kg flies past two poles, one on each side, and stops."""
    mass, inertia, arm = 0.7, 0.006, 0.17

    def fly(s):
        total = s.left + s.right
        return {
            "x": s.vx, "z": s.vz, "roll": s.rate, "vx": -total * cs.sin(s.roll) / mass,
            "vz": total * cs.cos(s.roll) / mass - 9.81, "rate": arm * (s.right - s.left) / inertia,
        }  # fmt: skip

    model = ocp.Model(
        "quadrotor", state={"x": 1, "z": 1, "roll": 1, "vx": 1, "vz": 1, "rate": 1},
        control={"left": 1, "right": 1}, modes={"fly": fly}, integrator="rk4",
    )  # fmt: skip
    motion = ocp.Motion(ocp.Phase("fly", "fly", 1.6, {"x": 2.0, "z": 0.0}))
    hover = mass * 9.81 / 2
    objective = ocp.Objective(
        ocp.track("left", 0.05 * factor, to=hover), ocp.track("right", 0.05 * factor, to=hover),
        ocp.regularize("rate", 0.01 * factor), ocp.regularize("roll", 0.1 * factor),
    )  # fmt: skip

    def pole(x: float, z: float) -> Callable[..., cs.SX]:
        return lambda s: (s.x - x) ** 2 + (s.z - z) ** 2 - 0.0625

    limits = ocp.Constraints(
        ocp.inequality(lambda s: cs.vertcat(s.left, s.right), lower=0.0, upper=6.5, name="thrust"),
        ocp.inequality(pole(0.7, 0.12), name="first pole"), ocp.inequality(pole(1.35, -0.1), name="second pole"),
        ocp.equality(
            lambda s: cs.vertcat(s.x - 2.0, s.z, s.roll, s.vx, s.vz, s.rate), at="end", name="stop"
        ),
    )  # fmt: skip
    return ocp.Problem(motion, model.until_end(dt=0.04), objective, limits, initial=[0.0] * 6)


def stiff_chain(factor: float = 1.0) -> ocp.Problem:
    """Three masses on springs of 5 to 2000 N/m, pushed at one end; the weights reach from 1e-4 to 1e4."""

    def move(s):
        first, second, third = 2000.0 * s.a, 100.0 * (s.b - s.a), 5.0 * (s.c - s.b)
        return {
            "a": s.va, "b": s.vb, "c": s.vc, "va": s.push - first + second - 0.5 * s.va,
            "vb": -second + third - 0.5 * s.vb, "vc": -third - 0.5 * s.vc,
        }  # fmt: skip

    names = ("a", "b", "c", "va", "vb", "vc")
    model = ocp.Model(
        "chain", state=dict.fromkeys(names, 1), control={"push": 1}, modes={"move": move}, integrator="rk4"
    )
    motion = ocp.Motion(ocp.Phase("move", "move", 1.0, {"c": 0.05}))
    objective = ocp.Objective(
        ocp.track("c", 1e4 * factor), ocp.regularize("vb", 1.0 * factor), ocp.regularize("push", 1e-4 * factor),
        ocp.regularize("a", 1e2 * factor), ocp.regularize("vc", 10.0 * factor, at="end"),
    )  # fmt: skip
    return ocp.Problem(
        motion, model.until_end(dt=0.02), objective, ocp.Constraints(_limit("push", 60.0)), initial=[0.0] * 6
    )


def held_row(factor: float = 1.0) -> ocp.Problem:
    """A cart that wishes to be at 0 must stay beyond a wall: the row is active over a whole phase."""
    model = ocp.Model(
        "cart", state={"x": 1, "v": 1}, control={"u": 1},
        modes={name: (lambda s: {"x": s.v, "v": s.u - 0.2 * s.v}) for name in ("free", "held")},
    )  # fmt: skip
    motion = ocp.Motion(
        ocp.Phase("free", "free", 0.6, {"x": 0.0}), ocp.Phase("held", "held", 0.8, {"x": 0.0}),
        ocp.Phase("back", "free", 0.6, {"x": 0.0}),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.track("x", 6.0 * factor), ocp.regularize("u", 0.05 * factor), ocp.regularize("v", 0.2 * factor)
    )
    limits = ocp.Constraints(
        ocp.inequality(lambda s: s.x, lower=0.4, name="wall", when="held"), _limit("u", 9.0),
    )  # fmt: skip
    return ocp.Problem(motion, model.until_end(dt=0.04), objective, limits, initial=[0.1, 0.0])


def planar_bound(speed: float, factor: float = 1.0) -> ocp.Problem:
    """A planar body of 9 kg bounds once: hind leg, flight, front leg, flight."""
    mass, inertia, arm, mu = 9.0, 0.25, 0.19, 0.6
    period = 0.14 + 0.08 + 0.14 + 0.08
    hind, front = -arm + 0.07 * speed, arm + (0.22 + 0.07) * speed

    def stance(foot: float):
        def move(s):
            torque = s.x * 0 + (foot - s.x) * s.fz + s.z * s.fx
            return {
                "x": s.vx, "z": s.vz, "pitch": s.rate, "vx": s.fx / mass, "vz": s.fz / mass - 9.81,
                "rate": -torque / inertia,
            }  # fmt: skip

        return move

    def fly(s):
        return {
            "x": s.vx, "z": s.vz, "pitch": s.rate, "vx": 0 * s.fx, "vz": 0 * s.fz - 9.81, "rate": 0 * s.fx,
        }  # fmt: skip

    names = ("x", "z", "pitch", "vx", "vz", "rate")
    model = ocp.Model(
        "bounder", state=dict.fromkeys(names, 1), control={"fx": 1, "fz": 1},
        modes={"hind": stance(hind), "fly": fly, "front": stance(front)},
    )  # fmt: skip
    at = {name: {"x": speed * t, "z": 0.27} for name, t in (("a", 0.14), ("b", 0.22), ("c", 0.36), ("d", period))}
    motion = ocp.Motion(
        ocp.Phase("hind", "hind", 0.14, at["a"]), ocp.Phase("leap", "fly", 0.08, at["b"]),
        ocp.Phase("front", "front", 0.14, at["c"]), ocp.Phase("fall", "fly", 0.08, at["d"]),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.track("z", 40.0 * factor), ocp.track("x", 5.0 * factor), ocp.regularize("pitch", 8.0 * factor),
        ocp.track("vx", 2.0 * factor, to=speed), ocp.regularize("rate", 0.1 * factor),
        ocp.regularize("fx", 2e-4 * factor), ocp.regularize("fz", 2e-4 * factor),
        ocp.track("z", 50.0 * factor, at="end"), ocp.regularize("pitch", 5.0 * factor, at="end"),
    )  # fmt: skip
    stands = ("hind", "front")
    limits = ocp.Constraints(
        ocp.inequality(
            lambda s: cs.vertcat(mu * s.fz - s.fx, mu * s.fz + s.fx), name="cone", unit="N", scale=20.0, when=stands
        ),
        ocp.inequality(lambda s: s.fz, upper=230.0, name="load", unit="N", scale=20.0, when=stands),
        ocp.inequality(lambda s: s.z, lower=0.24, name="height"),
        ocp.equality(lambda s: s.z - 0.27, at="end", name="same height"),
    )  # fmt: skip
    start = [0.0, 0.27, 0.0, speed, 0.0, 0.0]
    return ocp.Problem(motion, model.until_end(dt=0.01), objective, limits, initial=start)


PROBLEMS: Mapping[str, Callable[[float], ocp.Problem]] = {
    "double integrator, weight 1": double_integrator,
    "double integrator, weight 1e-3": lambda factor: double_integrator(1e-3 * factor),
    "Bryson and Denham": bryson_denham,
    "cart-pole": cart_pole,
    "pendulum": pendulum,
    "Van der Pol": van_der_pol,
    "bouncing balls": bouncing_balls,
    "slope": slope,
    "hopper of two sizes": hopper,
    "quadrotor": quadrotor,
    "stiff chain": stiff_chain,
    "held row": held_row,
    "planar bound, 0.5 m/s": lambda factor: planar_bound(0.5, factor),
    "planar bound, 1.2 m/s": lambda factor: planar_bound(1.2, factor),
}
