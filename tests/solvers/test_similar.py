"""A body scaled in length, with times, forces and weights scaled alike, takes the same iterations."""

from functools import cache

import casadi as cs
import pytest

from piaffe import ocp
from piaffe.solvers import MSiLQR, Solution


def bound(size: float) -> ocp.Problem:
    """A planar body of 9 kg bounds; lengths, masses, times and forces of another size are those of a similar body."""
    time, force, speed, g = size**0.5, size**3, 0.8 * size**0.5, 9.81
    mass, inertia, arm, mu = 9.0 * size**3, 0.25 * size**5, 0.19 * size, 0.6
    hind, front = -arm + 0.07 * time * speed, arm + 0.29 * time * speed

    def stance(foot: float):
        def move(s):
            torque = (foot - s.x) * s.fz + s.z * s.fx
            return {
                "x": s.vx, "z": s.vz, "pitch": s.rate, "vx": s.fx / mass, "vz": s.fz / mass - g,
                "rate": -torque / inertia,
            }  # fmt: skip

        return move

    def fly(s):
        return {"x": s.vx, "z": s.vz, "pitch": s.rate, "vx": 0 * s.fx, "vz": 0 * s.fz - g, "rate": 0 * s.fx}

    names = ("x", "z", "pitch", "vx", "vz", "rate")
    model = ocp.Model(
        "bounder", state=dict.fromkeys(names, 1), control={"fx": 1, "fz": 1},
        modes={"hind": stance(hind), "fly": fly, "front": stance(front)},
    )  # fmt: skip
    motion = ocp.Motion(*(
        ocp.Phase(name, mode, duration * time, {"x": speed * end * time, "z": 0.27 * size})
        for name, mode, duration, end in (
            ("hind", "hind", 0.14, 0.14), ("leap", "fly", 0.08, 0.22), ("front", "front", 0.14, 0.36),
            ("fall", "fly", 0.08, 0.44),
        )
    ))  # fmt: skip
    rate = 1 / time  # running costs are integrals
    objective = ocp.Objective(
        ocp.track("z", 40 * rate / size**2), ocp.track("x", 5 * rate / size**2), ocp.regularize("pitch", 8 * rate),
        ocp.track("vx", 2 * rate / size, to=speed), ocp.regularize("rate", 0.1 * rate * size),
        ocp.regularize("fx", 2e-4 * rate / force**2), ocp.regularize("fz", 2e-4 * rate / force**2),
        ocp.track("z", 50 / size**2, at="end"), ocp.regularize("pitch", 5.0, at="end"),
    )  # fmt: skip
    stands, unit = ("hind", "front"), 20.0 * force
    limits = ocp.Constraints(
        ocp.inequality(lambda s: cs.vertcat(mu * s.fz - s.fx, mu * s.fz + s.fx), name="cone", scale=unit, when=stands),
        ocp.inequality(lambda s: s.fz, upper=230 * force, name="load", scale=unit, when=stands),
        ocp.inequality(lambda s: s.z, lower=0.24 * size, name="height", scale=size),
        ocp.equality(lambda s: s.z - 0.27 * size, at="end", name="same height", scale=size),
    )  # fmt: skip
    start = [0.0, 0.27 * size, 0.0, speed, 0.0, 0.0]
    return ocp.Problem(motion, model.until_end(dt=0.01 * time), objective, limits, initial=start)


@cache
def solved(size: float) -> Solution:
    return MSiLQR(bound(size), backend="numpy").solve()


@pytest.mark.parametrize("size", [0.01, 0.1, 10.0])
def test_a_similar_body_takes_similarly_many_iterations(size: float) -> None:
    reference, solution = solved(1.0), solved(size)
    assert solution.converged, solution.explain()
    assert reference.iterations / 2 <= solution.iterations <= 2 * reference.iterations
    assert solution.cost == pytest.approx(reference.cost, rel=1e-4)
