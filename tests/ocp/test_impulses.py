"""Terms on the impulses of impacts: where they apply, what their rows are, their numbers, and their errors."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ProblemError
from piaffe.models import feet, stance
from piaffe.ocp import CompiledPhase, CompiledProblem, compile_problem
from piaffe.ocp.reports.verify import solve

FACES = ("normal", "-x", "+x", "-y", "+y")
KEPT_SMALL = ocp.regularize(feet.impulse, 0.2, at="phase_end", name="impulses")
TORQUES = ocp.regularize("joints.torque")


@cache
def body() -> models.WholeBody:
    return models.WholeBody(models.load("solo12"))


def hop() -> ocp.Motion:
    """Stand, fly, land on a diagonal, then on all feet: the diagonal is held in the second landing."""
    every = stance("FL FR HL HR")
    return ocp.Motion(
        ocp.Phase("stand", every, 0.04), ocp.Phase("flight", stance(""), 0.04, {"joints": "crouch"}),
        ocp.Phase("half", stance("FL HR"), 0.04), ocp.Phase("stand again", every, 0.04),
    )  # fmt: skip


def problem(
    *terms: ocp.Cost, motion: ocp.Motion | None = None, cone: object = None, schedule: ocp.Schedule | None = None
) -> ocp.Problem:
    limits = ocp.Constraints(models.friction_cone(mu=0.6) if cone is None else cone)
    start = body().state(joints="stand", linear_velocity=(0.3, -0.2, -0.5), joint_velocities=np.linspace(-1, 1, 12))
    return ocp.Problem(
        motion or hop(), schedule or body().until_end(dt=0.02), ocp.Objective(TORQUES, *terms), limits, initial=start
    )


def added(phase: CompiledPhase, name: str) -> np.ndarray:
    """Return the part of a phase's weights or masks that belongs to the transition's rows."""
    kind = {"weight": "residual", "g_mask": "g", "h_mask": "h"}[name]
    return np.asarray(getattr(phase, f"end_{name}")[len(phase.mode.rows[f"terminal_{kind}"]) :])


def state_at(compiled: CompiledProblem, i: int) -> np.ndarray:
    """Return a moving state at the end of a phase."""
    rng = np.random.default_rng(i)
    return body().state.np_plus(compiled.phases[i].guess_states[-1], 0.3 * rng.standard_normal(36))


def rows_at(phase: CompiledPhase, x: np.ndarray) -> Mapping[str, np.ndarray]:
    assert phase.transition is not None
    f, p = phase.transition.functions, phase.p_transition
    values = f["rows"](x, solve(f["implicit"], x, p), p)
    return {kind: np.asarray(value).ravel() for kind, value in zip(("residual", "g", "h"), values, strict=True)}


def impulses_by_hand(x: np.ndarray, names: str) -> np.ndarray:
    """Return the impulses of the feet in an impact, from the mass matrix and the Jacobian alone, (4, 3)."""
    rows = np.flatnonzero(np.repeat(body().flags(names), 3))
    M, J, v = body().mass_matrix(x), body().contact_jacobian(x)[rows], x[body().nq :]
    out = np.zeros(12)
    out[rows] = -np.linalg.solve(J @ np.linalg.solve(M, J.T), J @ v)
    return out.reshape(4, 3)


# ---- where the rows apply


def test_rows_count_for_landing_feet_only() -> None:
    stand, flight, half, last = compile_problem(problem(KEPT_SMALL)).phases
    assert [phase.lands for phase in (stand, flight, half, last)] == [False, True, True, False]
    landing = {"flight": [1, 0, 0, 1], "half": [0, 1, 1, 0]}
    for phase in (flight, half):
        np.testing.assert_array_equal(added(phase, "g_mask"), np.repeat(landing[phase.name], 5))
        np.testing.assert_array_equal(added(phase, "weight"), 0.2 * np.repeat(landing[phase.name], 3))
    assert not added(stand, "g_mask").any()  # its feet only lift
    assert not added(stand, "weight").any()
    assert last.transition is None
    assert len(last.end_g_mask) == len(last.mode.rows["terminal_g"])


def test_held_feet_have_impulses_without_rows() -> None:
    compiled = compile_problem(problem(KEPT_SMALL))
    x, half = state_at(compiled, 2), compiled.phases[2]
    by_hand = impulses_by_hand(x, "FL FR HL HR")
    np.testing.assert_allclose(rows_at(half, x)["residual"], by_hand.ravel(), atol=1e-10)
    assert np.abs(by_hand[[0, 3]]).min() > 1e-4
    assert not added(half, "g_mask").reshape(4, 5)[[0, 3]].any()


def test_the_rows_are_the_pyramid_of_the_impulse_in_its_scale() -> None:
    compiled = compile_problem(problem())
    x, flight = state_at(compiled, 1), compiled.phases[1]
    px, py, pz = impulses_by_hand(x, "FL HR").T
    scale = 0.1 * body().robot.mass
    expected = np.stack([pz, 0.6 * pz - px, 0.6 * pz + px, 0.6 * pz - py, 0.6 * pz + py], axis=1) / scale
    np.testing.assert_allclose(rows_at(flight, x)["g"].reshape(4, 5), expected, atol=1e-10)
    rows = flight.transition.rows["g"] if flight.transition else ()
    assert [compiled.row_name(row) for row in rows[:5]] == [f"friction cone impulse FL {face}" for face in FACES]
    assert {row.unit for row in rows} == {"N s"}
    assert [row.scale for row in rows] == pytest.approx([scale] * 20)
    assert flight.end_rows("g")[-20:] == rows


def test_a_cut_by_the_schedule_is_no_phase_end() -> None:
    schedule = body().over(0.06, dt=0.02) + body().over(0.10, dt=0.02)
    compiled = compile_problem(problem(KEPT_SMALL, schedule=schedule))
    names = [phase.name for phase in compiled.phases]
    assert names == ["stand", "flight", "flight", "half", "stand again"]
    assert [added(phase, "weight").any() for phase in compiled.phases[:-1]] == [False, False, True, True]


def test_the_junction_of_two_models_has_the_rows_of_the_first() -> None:
    rigid = models.SingleRigidBody(body().robot)
    forces = ocp.regularize(feet.force, 0.01)
    schedule = body().over(0.08, dt=0.02) + rigid.over(0.08, dt=0.02)
    compiled = compile_problem(problem(KEPT_SMALL, forces, schedule=schedule))
    stand, flight, rest = compiled.phases
    assert not added(stand, "g_mask").any()
    np.testing.assert_array_equal(added(flight, "g_mask"), np.repeat([1, 0, 0, 1], 5))
    assert rest.transition is None
    x = state_at(compiled, 1)
    np.testing.assert_allclose(rows_at(flight, x)["residual"], impulses_by_hand(x, "FL HR").ravel(), atol=1e-10)


def test_a_rigid_body_has_no_impulses() -> None:
    rigid = models.SingleRigidBody(body().robot)
    objective = ocp.Objective(ocp.regularize(feet.force, 0.01))
    cone = ocp.Constraints(models.friction_cone(mu=0.6))
    cut = rigid.over(0.08, dt=0.02) + rigid.over(0.08, dt=0.04)
    compiled = compile_problem(ocp.Problem(hop(), cut, objective, cone, initial=rigid.state()))
    assert all(phase.transition is None or phase.transition.num_rows == 0 for phase in compiled.phases)


def test_impulses_can_be_left_out_of_the_cone() -> None:
    compiled = compile_problem(problem(cone=models.friction_cone(mu=0.6, impulses=False)))
    assert all(phase.transition is None or phase.transition.num_rows == 0 for phase in compiled.phases)
    assert "stage_g" in compiled.phases[0].mode.rows


def test_what_the_schedule_leaves_out_has_no_rows() -> None:
    cone = models.friction_cone(mu=0.6)
    compiled = compile_problem(problem(cone=cone, schedule=body().until_end(dt=0.02).without(cone)))
    assert all(phase.transition is None or phase.transition.num_rows == 0 for phase in compiled.phases)


def test_a_horizon_without_landing_accepts_the_terms() -> None:
    short = problem(KEPT_SMALL, schedule=body().over(0.04, dt=0.02))
    (stand,) = compile_problem(short).phases
    assert stand.transition is None
    assert compile_problem(short, t0=0.04).phases[0].name == "flight"


def test_terms_on_impulses_do_not_change_the_other_functions() -> None:
    cone = models.friction_cone(mu=0.6, impulses=False)
    plain, with_rows = compile_problem(problem(cone=cone)), compile_problem(problem())
    one, other = (each.phases[0].transition for each in (plain, with_rows))
    assert one is not None
    assert other is not None
    for name in ("implicit", "reset", "reset_d"):
        assert one.functions[name].n_instructions() == other.functions[name].n_instructions()


# ---- their numbers


def test_mu_is_one_parameter_of_forces_and_impulses() -> None:
    compiled = compile_problem(problem())
    assert [name for name in compiled.parameters if name.endswith(".mu")] == ["friction cone.mu"]
    changed = compiled.with_parameters({"friction cone.mu": 0.3})
    again = compile_problem(problem().with_parameters({"friction cone.mu": 0.3}))
    x = state_at(compiled, 1)
    before, after, fresh = (rows_at(each.phases[1], x)["g"] for each in (compiled, changed, again))
    pz = impulses_by_hand(x, "FL HR")[[0, 3], 2]
    drop = (before - after).reshape(4, 5)[[0, 3], 1:]
    np.testing.assert_allclose(drop, np.repeat(0.3 * pz[:, None], 4, axis=1) / (0.1 * body().robot.mass), atol=1e-12)
    np.testing.assert_array_equal(after, fresh)
    assert changed.parameters["friction cone.mu"] == 0.3


def test_a_weight_changes_where_feet_land_and_nowhere_else() -> None:
    compiled = compile_problem(problem(KEPT_SMALL))
    weights = np.arange(1.0, 13.0)
    changed = compiled.with_parameters({"impulses.weight": weights})
    again = compile_problem(problem(KEPT_SMALL).with_parameters({"impulses.weight": weights}))
    for phase, fresh in zip(changed.phases, again.phases, strict=True):
        np.testing.assert_array_equal(phase.end_weight, fresh.end_weight)
        np.testing.assert_array_equal(phase.p_transition, fresh.p_transition)
    np.testing.assert_array_equal(added(changed.phases[1], "weight"), weights * np.repeat([1, 0, 0, 1], 3))
    assert not added(changed.phases[0], "weight").any()
    np.testing.assert_array_equal(changed.parameters["impulses.weight"], weights)


def test_a_cost_can_be_declared_for_some_phases_and_with_a_target() -> None:
    push = ocp.track(feet.impulse, 1.0, to=np.arange(12.0), at="phase_end", when="half", name="push")
    compiled = compile_problem(problem(push))
    flight, half = compiled.phases[1:3]
    assert not added(flight, "weight").any()
    np.testing.assert_array_equal(added(half, "weight"), np.repeat([0, 1, 1, 0], 3))
    x = state_at(compiled, 2)
    expected = impulses_by_hand(x, "FL FR HL HR").ravel() - np.arange(12.0)
    np.testing.assert_allclose(rows_at(half, x)["residual"], expected, atol=1e-10)


def test_bounds_of_impulses_are_parameters_too() -> None:
    most = ocp.inequality(
        lambda s: s.feet.impulse["z"], upper=1.5, unit="N s", name="hard landing", at="phase_end",
        mask=lambda s: s.feet.landing,
    )  # fmt: skip
    compiled = compile_problem(problem(cone=most))
    x, flight = state_at(compiled, 1), compiled.phases[1]
    expected = 1.5 - impulses_by_hand(x, "FL HR")[:, 2]
    np.testing.assert_allclose(rows_at(flight, x)["g"], expected, atol=1e-10)
    np.testing.assert_array_equal(added(flight, "g_mask"), [1, 0, 0, 1])
    softer = compiled.with_parameters({"hard landing.upper": np.full(4, 0.5)})
    np.testing.assert_allclose(rows_at(softer.phases[1], x)["g"], expected - 1.0, atol=1e-10)
    both = ocp.inequality(lambda s: s.feet.impulse["z"], lower=1.0, upper=2.0, name="both", at="phase_end")
    bounded = compile_problem(problem(cone=both))
    with pytest.raises(ProblemError, match="bounds exclude each other"):
        bounded.with_parameters({"both.upper": np.full(4, 0.5)})
    unbounded = compiled.with_parameters({"hard landing.upper": np.full(4, np.inf)})
    assert not added(unbounded.phases[1], "g_mask").any()


def test_contacts_rebuild_nothing() -> None:
    compile_problem(problem(KEPT_SMALL))
    every = stance("FL FR HL HR")
    other = ocp.Motion(ocp.Phase("one", stance("FL"), 0.04), ocp.Phase("all", every, 0.04))
    assert compile_problem(problem(KEPT_SMALL, motion=other)).lowered == 0
    lifting = ocp.Motion(ocp.Phase("all", every, 0.04), ocp.Phase("one", stance("FL"), 0.04))
    assert compile_problem(problem(motion=lifting)).lowered == compile_problem(problem(motion=lifting)).lowered == 0


# ---- reports


def test_the_description_names_impacts() -> None:
    text = str(problem(KEPT_SMALL))
    line = next(line for line in text.splitlines() if line.startswith("impulses"))
    assert "solo12 (impacts)" in line
    assert "cannot supply" not in line
    line = next(line for line in text.splitlines() if line.startswith("friction cone"))
    assert "solo12, solo12 (impacts)" in line


def test_the_dimensional_report_counts_impulses() -> None:
    costs, constraints = ocp.report(compile_problem(problem(KEPT_SMALL)))
    impulses = next(cost for cost in costs if cost.name == "impulses")
    assert (impulses.unit, impulses.weight_unit, impulses.rows) == ("N s", "1/(N s)^2", 12)
    assert impulses.weights == (0.2, 0.2)
    assert impulses.cost > 0
    cone = next(each for each in constraints if each.name == "friction cone")
    standing, landing = (4, 0, 2, 4), (2, 2)  # feet of each phase, which has two stages, and of each landing
    assert cone.counted == 5 * (2 * sum(standing) + sum(landing))


def test_a_violated_impulse_is_verified_and_named() -> None:
    compiled = compile_problem(problem())
    parts, x = [], None
    for phase in compiled.phases:
        states = phase.guess_states.copy()
        if phase.name == "flight":
            states[-1] = x = state_at(compiled, 1)
        model = phase.mode.model
        parts.append(
            ocp.PhaseTrajectory(phase.name, phase.label, model.name, phase.times, states, phase.guess_controls, {},
                                model.state, model.control)
        )  # fmt: skip
    assert x is not None
    rows = rows_at(compiled.phases[1], x)["g"].reshape(4, 5)
    found = {v.name: v for v in ocp.verify(compiled, ocp.Trajectory(tuple(parts))).violations}
    for i, foot in ((0, "FL"), (3, "HR")):
        for face, row in zip(FACES, rows[i], strict=True):
            violation = found[f"friction cone impulse {foot} {face}"]
            at_flight = max(-row, 0.0)
            assert violation.amount >= at_flight - 1e-9
            assert violation.unit == "N s"
    worst = max(-rows[[0, 3]].min(), 0.0)
    assert worst > 0.1
    name = f"friction cone impulse {('FL', '', '', 'HR')[int(np.argmin(rows.min(axis=1)))]} "
    assert max(v.amount for v in found.values() if v.name.startswith(name)) == pytest.approx(worst)


@pytest.mark.parametrize("kind", ["equality", "inequality"])
def test_rows_of_ones_own_on_impulses_are_verified_where_feet_land_and_nowhere_else(kind: str) -> None:
    def row(s):  # type: ignore[no-untyped-def]
        return -0.1 - s.feet.impulse["z"]  # negative where no foot lands, too

    declare = ocp.equality if kind == "equality" else ocp.inequality
    term = declare(row, name="own", unit="N s", at="phase_end", mask=lambda s: s.feet.landing)
    compiled = compile_problem(problem(cone=term))
    parts, expected = [], np.zeros(4)
    for i, (phase, names) in enumerate(zip(compiled.phases, ("", "FL HR", "FL FR HL HR", ""), strict=True)):
        states = phase.guess_states.copy()
        states[-1] = state_at(compiled, i)
        if names:
            lands = [0, 3] if i == 1 else [1, 2]  # each foot lands once
            expected[lands] = 0.1 + impulses_by_hand(states[-1], names)[lands, 2]
        parts.append(
            ocp.PhaseTrajectory(phase.name, phase.label, "solo12", phase.times, states, phase.guess_controls, {},
                                body().state, body().control)
        )  # fmt: skip
    found = ocp.verify(compiled, ocp.Trajectory(tuple(parts))).violations
    own = [each for each in found if each.name.startswith("own")]
    assert {each.kind for each in own} == {kind}
    amounts = np.abs(expected) if kind == "equality" else np.maximum(expected, 0.0)
    assert amounts.max() < 0.099  # less than the 0.1 of a foot that does not land
    np.testing.assert_allclose(sorted(each.amount for each in own), sorted(amounts), atol=1e-9)
    assert {each.phase for each in own} == {"flight", "half"}


def test_other_quantities_at_an_impact_are_those_of_the_state_before_it() -> None:
    work = ocp.residual(lambda s: s.feet.velocity["z"] * s.feet.impulse["z"]).weighted(1.0, at="phase_end")
    compiled = compile_problem(problem(work))
    x = state_at(compiled, 1)
    speed = (body().contact_jacobian(x) @ x[body().nq :]).reshape(4, 3)[:, 2]
    expected = speed * impulses_by_hand(x, "FL HR")[:, 2]
    np.testing.assert_allclose(rows_at(compiled.phases[1], x)["residual"], expected, rtol=1e-9, atol=1e-12)
    assert np.abs(expected).max() > 1e-3


# ---- errors


@pytest.mark.parametrize(
    ("term", "expected"),
    [
        (
            ocp.regularize(feet.impulse, name="early"),
            r"term 'early' \(test_impulses.py:\d+\): applies nowhere - got model 'solo12' cannot supply 'feet.impulse' "
            r"\(it exists for terms with at=\"phase_end\", at the end of a phase whose next one lands feet\), "
            "expected at least one model and phase; correct it or remove it",
        ),
        (ocp.regularize(feet.impulse, at="end", name="late"), "term 'late' .* cannot supply 'feet.impulse'"),
        (
            ocp.residual(lambda s: s.feet.impulse[0] * s.joints.torque[0]).weighted(1.0, at="phase_end", name="mixed"),
            r"'mixed' .* cannot supply 'joints.torque' \(there is no control at the end of a phase\)",
        ),
        (
            ocp.regularize(feet.impulse, at="phase_end", when="stand", name="lifting"),
            "'lifting' .* cannot supply 'feet.impulse' .*; it is declared for phase 'stand' at 'phase_end', and no",
        ),
        (
            ocp.residual(lambda s: s.feet.impulse["ZZ"]).weighted(1.0, at="phase_end", name="misspelt"),
            "'misspelt' .*: applies nowhere - got quantity 'feet.impulse' of model 'solo12' has no component 'ZZ'",
        ),
    ],
    ids=["running", "end", "torque", "lifting", "component"],
)  # fmt: skip
def test_a_term_that_applies_nowhere_says_why(term: ocp.Cost, expected: str) -> None:
    with pytest.raises(ProblemError, match=expected):
        compile_problem(problem(term))


def test_a_motion_that_never_lands_has_no_impulses() -> None:
    every = stance("FL FR HL HR")
    lifting = ocp.Motion(ocp.Phase("stand", every, 0.04), ocp.Phase("lift", stance("FL HR"), 0.04))
    with pytest.raises(ProblemError, match=r"'impulses' .*: applies nowhere .* no such phase among 'stand', 'lift'"):
        compile_problem(problem(KEPT_SMALL, motion=lifting))


def test_a_value_that_is_not_finite_is_named_only_where_feet_land() -> None:
    # the guess of 'half' ends at rest, where the impulse is zero
    inverse = ocp.residual(lambda s: 1 / s.feet.impulse[2]).weighted(1.0, at="phase_end", name="inverse")
    with pytest.raises(ProblemError, match=r"term 'inverse' \(test_impulses.py:\d+\), phase 'half', node 2: value"):
        compile_problem(problem(inverse))
    every = stance("FL FR HL HR")
    lifting = (ocp.Phase("stand", every, 0.04), ocp.Phase("two", stance("FR HL"), 0.04, {"joints": "crouch"}))
    landing = ocp.Motion(*lifting, ocp.Phase("land", every, 0.04))
    moving = problem(inverse, motion=landing)
    assert compile_problem(moving).phases[1].lands  # where the feet only lift, 1/0 has no effect


def test_a_mask_must_not_depend_on_impulses() -> None:
    term = replace(KEPT_SMALL, mask=lambda s: s.feet.impulse)
    with pytest.raises(ProblemError, match="mask depends on state or control"):
        compile_problem(problem(term))


# ---- soft landing


def test_soft_landing_is_a_cost_on_the_vertical_speed_of_landing_feet() -> None:
    compiled = compile_problem(problem(models.soft_landing(3.0)))
    x, flight, half = state_at(compiled, 1), *compiled.phases[1:3]
    residual = np.asarray(flight.mode.functions["terminal"](x, flight.p_end)[0]).ravel()
    speeds = (body().contact_jacobian(x) @ x[body().nq :]).reshape(4, 3)[:, 2]
    np.testing.assert_allclose(residual, speeds, atol=1e-10)
    np.testing.assert_array_equal(flight.end_weight, [3, 0, 0, 3])
    np.testing.assert_array_equal(half.end_weight, [0, 3, 3, 0])
    assert not compiled.phases[0].end_weight.any()
    assert [row.unit for row in flight.mode.rows["terminal_residual"]] == ["m/s"] * 4
