"""Impulses in a solve: the cone holds, both backends agree, files store them, the published rule is still there."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.models import base, feet, joints, measures, stance
from piaffe.ocp import CompiledProblem, compile_problem, verify
from piaffe.solvers import MSiLQR, Options, Solution, solve_batch
from tests.problems import bouncer

EVERY = "FL FR HL HR"


@cache
def body(impact: str = "contact") -> models.WholeBody:
    return models.WholeBody(models.load("solo12"), impact=impact, integrator="euler")  # type: ignore[arg-type]  # a literal


def stumble(impact: str = "contact", *terms: ocp.Cost, impulses: bool = True, mu: float = 0.5) -> ocp.Problem:
    """Solo12 is thrown sideways and lands on a diagonal first, then on all feet: the diagonal is held."""
    motion = ocp.Motion(
        ocp.Phase("fly", stance(""), 0.10, ocp.Keyframe(position=(0.03, 0.06, 0.24), joints="stand")),
        ocp.Phase("two", stance("FL HR"), 0.08, ocp.Keyframe(position=(0.04, 0.08, 0.23), joints="stand")),
        ocp.Phase("four", stance(EVERY), 0.10, ocp.Keyframe(position=(0.04, 0.08, 0.23), joints="stand")),
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=30), ocp.track(base.orientation, weight=5),
        ocp.track(base.linear_velocity, weight=1.0), ocp.track(base.angular_velocity, weight=0.3),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.01),
        ocp.regularize(joints.torque, weight=0.05), *terms,
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(mu, impulses=impulses), models.torque_limits())
    start = body().state(position=(0, 0, 0.28), joints="stand", linear_velocity=(0.3, 0.9, -0.3))
    return ocp.Problem(motion, body(impact).until_end(dt=0.01), objective, limits, initial=start)


@cache
def compiled(**options: bool) -> CompiledProblem:
    return compile_problem(stumble(**options))


@cache
def solved(**options: bool) -> Solution:
    return MSiLQR(compiled(**options)).solve()


def impulses(solution: Solution) -> dict[str, np.ndarray]:
    """Return the recorded impulses by phase, (4, 3)."""
    phases = solution.trajectory.phases
    return {part.name: part.reset_outputs[feet.impulse].reshape(4, 3) for part in phases if part.reset_outputs}


def test_the_measures_of_impacts_are_those_of_landing_feet() -> None:
    first, second = measures.impacts(solved().trajectory)
    assert (first.phase, first.time, second.phase) == ("fly", pytest.approx(0.10), "two")
    np.testing.assert_allclose(second.impulses[[1, 2]], by_hand(solved(), 1)[[1, 2]], atol=1e-4)
    assert np.isnan(second.impulses[[0, 3]]).all()  # held, not landing
    assert first.ratio == pytest.approx(max(tangential(by_hand(solved(), 0)[k]) for k in (0, 3)), abs=1e-4)
    assert first.normal.min() > 0
    pulled = measures.Impact("pull", 0.0, np.array([[0.1, 0.0, -0.2], [np.nan] * 3]))
    assert pulled.ratio == np.inf


def by_hand(solution: Solution, i: int) -> np.ndarray:
    """Return the impulses that explain the jump of the velocity after a phase, (4, 3)."""
    x, after = solution.trajectory.phases[i].states[-1], solution.trajectory.phases[i + 1].states[0]
    nq, names = body().nq, solution.trajectory.phases[i + 1].mode
    rows = np.flatnonzero(np.repeat(body().flags(names), 3))
    gained = body().mass_matrix(x) @ (after[nq:] - x[nq:])
    out = np.zeros(12)
    out[rows] = np.linalg.lstsq(body().contact_jacobian(x)[rows].T, gained, rcond=None)[0]
    return out.reshape(4, 3)


def tangential(impulse: np.ndarray) -> float:
    return float(np.abs(impulse[:2]).max() / impulse[2])


def test_the_impulses_of_landing_feet_are_in_their_cone() -> None:
    free, limited = solved(impulses=False), solved()
    assert free.converged
    assert limited.converged
    landing = [(i, k) for i, feet in ((0, (0, 3)), (1, (1, 2))) for k in feet]
    assert max(tangential(by_hand(free, i)[k]) for i, k in landing) > 0.6
    for i, k in landing:
        assert by_hand(limited, i)[k, 2] > 0
        assert tangential(by_hand(limited, i)[k]) <= 0.5 + 1e-3
    assert limited.cost > free.cost


def test_the_recorded_impulses_explain_the_jump_of_the_velocity() -> None:
    found = impulses(solved())
    assert list(found) == ["fly", "two"]
    for i, name in enumerate(found):
        np.testing.assert_allclose(found[name], by_hand(solved(), i), atol=1e-4)
    np.testing.assert_array_equal(found["fly"][[1, 2]], np.zeros((2, 3)))
    assert np.abs(found["two"][[0, 3]]).min() > 0  # held


def test_held_feet_rest_after_the_impact() -> None:
    x = solved().trajectory.phases[2].states[0]
    speeds = body().contact_jacobian(x) @ x[body().nq :]
    assert np.abs(speeds).max() < 1e-4
    published = MSiLQR(stumble("landing")).solve().trajectory.phases[2].states[0]
    speeds = (body().contact_jacobian(published) @ published[body().nq :]).reshape(4, 3)
    assert np.abs(speeds[[1, 2]]).max() < 1e-4
    assert np.abs(speeds[[0, 3]]).max() > 1e-3


def test_both_backends_make_the_same_iterates() -> None:
    options = Options(max_iterations=25)
    one, other = (MSiLQR(compiled(), options, backend=name).solve() for name in ("native", "numpy"))
    assert one.status is other.status
    for name in ("iteration", "step_size", "regularization", "barrier_weight"):
        assert [getattr(r, name) for r in one.history] == [getattr(r, name) for r in other.history]
    np.testing.assert_allclose([r.merit for r in one.history], [r.merit for r in other.history], rtol=1e-7)
    for a, b in zip(one.phases, other.phases, strict=True):
        for name, values in a.multipliers.items():
            np.testing.assert_allclose(values, b.multipliers[name], rtol=1e-5, atol=1e-7, err_msg=name)


def test_a_verified_solution_names_its_impulses() -> None:
    found = [v for v in verify(compiled(), solved().trajectory).violations if "impulse" in v.name]
    assert len(found) == 20
    assert max(v.ratio for v in found) <= 1.0
    assert {v.name for v in found} >= {"friction cone impulse FL normal", "friction cone impulse HR -y"}


def test_a_cost_on_impulses_softens_the_landing() -> None:
    softer = MSiLQR(stumble("contact", ocp.regularize(feet.impulse, 20.0, at="phase_end", name="impulses"))).solve()
    assert softer.converged
    normal = [sum(np.sum(values[:, 2] ** 2) for values in impulses(s).values()) for s in (solved(), softer)]
    assert normal[1] < 0.9 * normal[0]
    first, second = impulses(softer)["fly"], impulses(softer)["two"]
    expected = 10.0 * (np.sum(first**2) + np.sum(second[[1, 2]] ** 2))  # the held feet do not count
    assert softer.term_costs["impulses"] == pytest.approx(expected, rel=1e-6)


def test_a_ratio_of_impulses_counts_only_where_feet_land() -> None:
    """The ratio is 0/0 at the ends where feet only lift; there its rows have no effect."""
    ratio = ocp.residual(lambda s: s.feet.impulse[0] / s.feet.impulse[2]).weighted(0.01, at="phase_end", name="ratio")
    motion = ocp.Motion(
        ocp.Phase("stand", stance(EVERY), 0.06), ocp.Phase("three", stance("FR HL HR"), 0.06, {"joints": "crouch"}),
        ocp.Phase("land", stance(EVERY), 0.06),
    )  # fmt: skip
    objective = ocp.Objective(
        ocp.regularize(joints.torque, 0.05), ocp.track(joints.velocity, 0.1), ocp.track(base.position, 10.0), ratio
    )
    x = body().state(joints="stand", linear_velocity=(0.1, 0.0, 0.0))
    problem = compile_problem(ocp.Problem(motion, body().until_end(dt=0.02), objective, initial=x))
    options = Options(max_iterations=6)
    one, other = (MSiLQR(problem, options, backend=name).solve() for name in ("native", "numpy"))
    assert np.isfinite(one.history[-1].merit)
    assert one.term_costs["ratio"] > 0
    np.testing.assert_allclose([r.merit for r in one.history], [r.merit for r in other.history], rtol=1e-8)


def test_a_warm_start_takes_up_the_impulses() -> None:
    again = MSiLQR(compiled()).solve(solved())
    assert again.iterations == 0
    assert again.converged
    rougher = compiled().with_parameters({"friction cone.mu": 0.8})
    assert MSiLQR(rougher).solve(solved()).cost < solved().cost


def test_a_warm_start_without_impulses_keeps_the_first_multipliers() -> None:
    """Solutions of the code before impulses were limited have fewer rows at the last nodes."""
    solution = MSiLQR(compiled()).solve(solved(impulses=False))
    assert solution.converged
    assert solution.cost == pytest.approx(solved().cost, rel=1e-3)


def test_a_batch_solves_each_friction() -> None:
    mus = np.array([0.4, 0.5, 0.8])
    batch = solve_batch(compiled(), parameters={"friction cone.mu": mus})
    assert batch.converged.all()
    assert np.all(np.diff(batch.cost) < 0)
    alone = MSiLQR(compiled().with_parameters({"friction cone.mu": 0.4})).solve()
    np.testing.assert_array_equal(batch.phases[0].states[0], alone.trajectory.phases[0].states)


def test_a_file_keeps_impulses_and_files_without_them_load(tmp_path: Path) -> None:
    path = solved().save(tmp_path / "new.npz")
    for a, b in zip(solved().trajectory.phases, Solution.load(path).trajectory.phases, strict=True):
        assert list(a.reset_outputs) == list(b.reset_outputs)
        for quantity, values in a.reset_outputs.items():
            np.testing.assert_array_equal(b.reset_outputs[quantity], values)
    assert [impact.ratio for impact in measures.impacts(Solution.load(path).trajectory)] == [
        impact.ratio for impact in measures.impacts(solved().trajectory)
    ]
    with np.load(path) as stored:
        arrays = dict(stored)
    header = json.loads(bytes(arrays.pop("header")).decode())
    del header["arrays"]  # files of earlier releases have no such entry
    for phase in header["phases"]:
        del phase["reset_outputs"]
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(tmp_path / "old.npz", **{name: v for name, v in arrays.items() if "reset_outputs" not in name})
    assert not any(part.reset_outputs for part in Solution.load(tmp_path / "old.npz").trajectory.phases)


def test_the_published_rule_without_limits_keeps_the_earlier_result() -> None:
    """The place is that of the code before impulses were limited and feet held, with Euler's step.

    The cost is that with all tolerances at 1e-7; the earlier one, 0.284303, was that of looser tolerances.
    """
    solution = MSiLQR(stumble("landing", impulses=False)).solve()
    assert solution.cost == pytest.approx(0.284270, rel=1e-4)
    base_at_end = solution.trajectory.phases[-1].states[-1, :3]
    np.testing.assert_allclose(base_at_end, [0.04839, 0.13714, 0.17882], atol=2e-4)


def test_ratios_of_impulses_tell_pulling_from_none() -> None:
    given = np.array([[0.3, -0.4, 1.0], [0.1, 0.0, -0.2], [1e-9, 0.0, -1e-8], [np.nan] * 3])
    np.testing.assert_array_equal(measures.impulse_ratios(given), [0.4, np.inf, np.nan, np.nan])
    assert measures.Impact("flight", 0.1, given).ratio == np.inf
    assert measures.Impact("flight", 0.1, given[[0, 2, 3]]).ratio == 0.4
    assert measures.Impact("flight", 0.1, given[2:]).ratio == 0.0


def test_a_reset_without_implicit_variables_has_impulses() -> None:
    solutions = [MSiLQR(bouncer(), backend=backend).solve().raise_if_failed() for backend in ("numpy", "native")]
    for solution in solutions:
        (blow,) = solution.trajectory.phases[0].reset_outputs.values()
        assert blow[0] == pytest.approx(-1.8 * solution.trajectory.phases[0].states[-1, 1])
        assert 0 < blow[0] <= 3.0 + 1e-4
        assert solution.term_costs["blow"] == pytest.approx(1.5 * blow[0] ** 2)
        assert not solution.trajectory.phases[1].reset_outputs
    assert solutions[0].cost == pytest.approx(solutions[1].cost, rel=1e-12)
    assert verify(compile_problem(bouncer()), solutions[0].trajectory).holds
