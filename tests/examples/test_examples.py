"""Every example runs as it stands, and returns the number that it promises."""

import importlib.util
import inspect
import json
import subprocess
import sys
from math import pi
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from piaffe import models, ocp, sampling, simulation, solvers
from piaffe.models import measures
from piaffe.simulation import Perturbation, execute
from piaffe.viz.curves import panels

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FILES = sorted(EXAMPLES.glob("*.py"))
NOTEBOOK = EXAMPLES / "own_robot.ipynb"


@pytest.fixture(scope="module")
def load():
    """Import an example once per session of this file."""
    loaded = {}
    sys.path.insert(0, str(EXAMPLES))  # as when one of them is run: some build on another

    def module(name):
        if name not in loaded:
            spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
            loaded[name] = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(loaded[name])
        return loaded[name]

    yield module
    sys.path.remove(str(EXAMPLES))


def checked(problem, solution):
    """Return the verification of a solution; everything within its bounds."""
    found = ocp.verify(ocp.compile_problem(problem), solution.trajectory)
    assert found.max_defect <= 1e-4
    assert found.max_equality <= 1e-3
    assert found.max_inequality <= 1e-3
    assert found.holds  # slip and height of standing feet, and flights, too
    return found


def check_drawn_turns(solution, declared):
    """Assert that roll, pitch, yaw of the figure have no jumps, and end as declared, as their targets do."""
    drawn = next(panel for panel in panels(solution) if panel.title == "Base orientation").curves
    assert [curve.values[-1] for curve in drawn] == pytest.approx(declared, abs=0.1)
    assert [curve.target[-1] for curve in drawn] == pytest.approx(declared, abs=1e-9)
    assert max(np.abs(np.diff(curve.values)).max() for curve in drawn) < 0.15  # [rad], in a step of 10 ms
    assert max(np.abs(np.diff(curve.target)).max() for curve in drawn) < 0.15


# ---- all of them


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_an_example_is_one_page_with_a_sentence_and_a_problem(file, load):
    lines = file.read_text().splitlines()
    assert len(lines) <= 120
    assert lines[0].startswith('"""')
    assert lines[0].endswith('"""')
    module = load(file.stem)
    assert any(isinstance(each, ocp.Problem) for each in vars(module).values()) or callable(module.problem)
    if hasattr(module, "main"):
        signature = inspect.signature(module.main)
        assert signature.return_annotation is float
        assert all(given.default is not inspect.Parameter.empty for given in signature.parameters.values())


def test_an_example_runs_as_a_script(tmp_path):
    ran = subprocess.run(
        [sys.executable, str(EXAMPLES / "own_dynamics.py"), "--bounciness", "0.7"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines()[-1].endswith(" m")


# ---- each of them


def test_the_ball_comes_as_high_as_it_should(load):
    assert load("own_dynamics").main() == pytest.approx(0.6, abs=0.005)


def test_a_duller_ball_needs_more_thrust_and_nothing_is_built(load):
    module = load("own_dynamics")
    ocp.compile_problem(module.problem)
    dull = module.problem.with_parameters(restitution=0.6)
    assert ocp.compile_problem(dull).lowered == 0
    bright, dull = (solvers.MSiLQR(p).solve().raise_if_failed() for p in (module.problem, dull))
    before, after = (dull.trajectory.phases[i].states[k] for i, k in ((0, -1), (1, 0)))
    assert before[0] == pytest.approx(0.0, abs=1e-3)
    assert after[1] == pytest.approx(-0.6 * before[1], abs=1e-4)
    assert dull.term_costs["regularize thrust"] > 2 * bright.term_costs["regularize thrust"]


def test_the_rocket_stops_at_its_height(load):
    module = load("own_dynamics")
    assert module.main("launch") == pytest.approx(10.0, abs=0.01)
    compiled = ocp.compile_problem(module.launch)
    assert [(phase.mode.state.nx, phase.mode.nu) for phase in compiled.phases] == [(3, 1), (2, 0)]


def test_the_squat_passes_under_the_bar(load):
    assert load("own_terms").main(bar=0.15) <= 0.15 + 1e-4


def test_own_terms_hold_at_every_node(load):
    module = load("own_terms")
    solution = solvers.MSiLQR(module.problem).solve().raise_if_failed()
    checked(module.problem, solution)
    names = {violation.name.split()[0] for violation in solution.violations}
    assert {"knee_clearance", "under_the_bar", "at_rest"} <= names
    assert "hip_symmetry" in solution.term_costs


def test_the_biped_lands_where_it_should(load):
    assert load("biped").main() == pytest.approx(0.10, abs=1e-3)


def test_the_arm_reaches_around_the_box_and_its_policy_follows(load):
    module = load("reach")
    assert module.main() < 1.6
    solution = solvers.MSiLQR(module.problem).solve().raise_if_failed()
    checked(module.problem, solution)
    robot, centre, half = module.robot, np.array(module.CENTRE), np.array(module.HALF)
    first, *_, last = places = [module.hand(x) for part in solution.trajectory.phases for x in part.states]
    assert last == pytest.approx(module.GOAL, abs=1e-3)
    assert min(np.abs((place - centre) / half).max() for place in places) > 1.0
    straight = [np.abs((first + s * (last - first) - (0, 0, 0.1) - centre) / half).max() for s in np.linspace(0, 1, 50)]
    assert min(straight) < 1.0, "the box is in the way of the fingers"
    for part in solution.trajectory.phases:
        assert np.all(np.abs(part.controls) <= robot.torque_limit + 1e-3)
        assert np.all(part.states[:, :7] >= robot.joint_lower)
        assert np.all(part.states[:, :7] <= robot.joint_upper)
    run = execute(solution, module.problem, seeds=3)
    assert run.holds, str(run)
    assert "last error of a joint" in str(run)


def test_the_corners_of_a_sole_are_refused_by_name(load):
    told = load("biped").soles()
    assert "redundant contact points - got L_TOE_OUT, L_HEEL_IN" in told
    assert "expected points that can be held independently" in told


def test_the_notebook_goes_from_a_urdf_to_a_hop(capsys):
    matplotlib.use("Agg")
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    names = {"__name__": "__main__"}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), f"{NOTEBOOK.name}, {cell['id']}", "exec"), names)
    matplotlib.pyplot.close("all")
    assert names["solution"].converged
    assert names["apex"] > 1.2 * names["height"]
    assert "note: robot: my_robot: 12 joints" in capsys.readouterr().out


def test_the_notebook_is_kept_without_outputs():
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_the_roll_rolls_once_within_every_limit(load):
    problem = load("barrel_roll").problem
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    checked(problem, solution)
    assert measures.turns(solution.trajectory) == pytest.approx([2 * pi, 0, 0], abs=0.05)
    check_drawn_turns(solution, [2 * pi, 0, 0])
    assert 0.38 < measures.apex(solution.trajectory) < 0.60
    assert np.abs(solution.controls).max() <= 17 + 1e-3
    impacts = measures.impacts(solution.trajectory)
    assert [impact.phase for impact in impacts] == ["flight", "hop"]
    for impact in impacts:
        assert impact.normal.min() > 0
        assert impact.ratio <= 0.6 + 1e-3
    assert solution.iterations <= 60


def test_the_flip_turns_once_backwards_and_keeps_its_knees_off_the_ground(load):
    problem = load("backflip").problem
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    checked(problem, solution)
    assert measures.turns(solution.trajectory) == pytest.approx([0, -2 * pi, 0], abs=0.1)
    check_drawn_turns(solution, [0, -2 * pi, 0])
    assert measures.apex(solution.trajectory) > 0.45
    for leg in load("backflip").robot.foot_names:
        knee = models.frames[f"{leg}_KFE"].position
        heights = ocp.quantity_values(ocp.compile_problem(problem), solution.trajectory, knee)
        assert min(values[:, 2].min() for values in heights) > 0.03 - 1e-3


def test_sideways_hop_turns_by_a_quarter_and_lands_where_it_should(load):
    problem = load("sideways_hop").problem
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    checked(problem, solution)
    assert measures.turns(solution.trajectory) == pytest.approx([0, 0, pi / 2], abs=0.1)
    end = solution.trajectory.sample(solution.trajectory.duration)[models.base.position]
    assert end[:2] == pytest.approx((0, 0.3), abs=0.05)
    assert measures.apex(solution.trajectory) > load("sideways_hop").high + 0.1
    assert execute(solution, problem, seeds=2).followed == 2


@pytest.mark.parametrize(("file", "name"), [("barrel_roll", "problem"), ("gaits", "bound")])
def test_the_policy_follows_the_plan_in_simulation(file, name, load):
    problem = getattr(load(file), name)
    made = execute(solvers.MSiLQR(problem).solve().raise_if_failed(), problem, seeds=3)
    assert made.friction == 0.6
    assert made.followed == 3, "\n".join(map(str, made.trials))
    assert made.median_error <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("file", "name", "size"), [("barrel_roll", "problem", 2), ("gaits", "bound", 3)])
def test_vwbc_follows_plans_from_starts_that_are_too_far_for_the_policy(file, name, size, load):
    problem = getattr(load(file), name)
    solution = solvers.MSiLQR(problem).solve().raise_if_failed()
    options = {"seeds": 20, "perturbation": Perturbation().scaled(size)}
    controller = solvers.Vwbc(solvers.SolvedPlan(solution, problem))
    policy = execute(solution, problem, **options)
    made = execute(solution, problem, control=controller.control, **options)
    assert policy.followed < 20
    assert made.followed == 20, "\n".join(map(str, made.trials))
    assert controller.fallbacks < 0.001 * controller.ticks
    assert controller.damped == 0


@pytest.mark.parametrize("name", ["bound", "pronk", "pace", "flying_trot", "trot", "walk"])
def test_gaits_go_forward(name, load):
    assert 0.2 < load("gaits").main(name) < 0.7


def test_the_cascade_holds_its_height(load):
    module = load("cascade")
    assert module.main() == pytest.approx(0.30, abs=0.05)


def test_the_cascade_begun_at_its_solution_is_there(load):
    solver = solvers.MSiLQR(load("cascade").problem)
    solution = solver.solve()
    lowest = min(phase.states[:, 2].min() for phase in solution.trajectory.phases)
    assert lowest > 0.2  # another optimum, of higher cost, falls to 0.136 m
    again = solver.solve(solution)
    assert again.converged
    assert again.iterations == 0
    assert again.cost == pytest.approx(solution.cost, rel=1e-12)


def test_the_trot_keeps_its_speed_online(load):
    episode = load("trot_mpc").run(seconds=3.0)
    assert episode.success
    assert episode.tracking(2.0, 3.0).velocity[0] == pytest.approx(0.5, rel=0.05)
    assert episode.summary()["fallbacks"] == 0


def test_all_gaits_keep_their_speed_with_one_objective(load):
    assert load("gaits_mpc").main(seconds=4.0) < 0.05


@pytest.mark.parametrize("ground", ["stairs", "slope"])
def test_the_trot_climbs_online_from_where_it_is(ground, load):
    """Its first state is not the declared one, so steps are not where a motion that moves with the robot has them."""
    module = load("stairs_mpc")
    start = module.problem.initial.copy()
    start[:2] += 0.07, -0.05
    episode = module.run(ground, seconds=4.0, initial=start)
    assert episode.success
    assert episode.summary()["fallbacks"] == 0
    assert episode.tracking(2.0, 4.0).velocity[0] == pytest.approx(0.5, rel=0.05)
    x, terrain = episode.last, module.grounds[ground]
    assert float(terrain.height(x[0], x[1])) > 0.11  # above the third step
    assert x[2] - float(terrain.height(x[0], x[1])) == pytest.approx(module.robot.base_height("stand"), abs=0.03)
    loaded = episode.forces[:, :, 2] > episode.least_force
    assert np.mean(loaded == (episode.planned > 0.5)) > 0.95  # feet land when they are planned to


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.3, -0.3])
def test_the_trot_turns_as_it_is_told_despite_losses_of_joints(rate, load):
    """Without a heading that is kept, it turns by 54 degrees a minute less than its command of 0.3 rad/s."""
    module = load("gaits_mpc")
    mpc = solvers.RecedingHorizon(module.trot)
    low = solvers.Vwbc(mpc.plan(mpc.initial, 0.0), leave_out=("base.position x", "base.position y"))
    episode = simulation.run_online(
        mpc, low, simulation.Plant(module.robot, friction=0.7), seconds=15.0, every=10,
        commands=simulation.parse_commands(f"yaw={rate}@1"),
    )  # fmt: skip
    assert episode.success
    found = episode.tracking(5.0, 15.0)  # whole cycles of the gait
    assert 60 * np.degrees(found.yaw_rate_error) < 2.0
    assert found.velocity[0] == pytest.approx(0.5, rel=0.05)


def test_the_bound_goes_on_after_a_push(load):
    episode = load("bound_mpc").run("1.5@1.2:y", seconds=4.0)
    assert episode.success
    assert episode.tracking(3.0, 4.0).velocity[0] == pytest.approx(0.5, rel=0.1)


def test_the_robot_rolls_lands_and_paces(load, capsys):
    assert load("roll_then_pace").main(seeds=1, first=2000) == 1.0
    assert "upright after 4.00 s" in capsys.readouterr().out


def test_the_robot_trots_paces_rolls_and_trots_on_command(load, capsys):
    assert load("trot_pace_roll").main(seeds=1, first=1000) == 1.0
    assert "trot at 0.00 s, pace at 2.30 s, trot at 5.10 s, roll at 8.65 s, trot at 9.9" in capsys.readouterr().out


def test_the_quadrotor_reaches_its_point_from_every_start(load):
    assert load("own_model_mpc").main(seeds=20) < 0.05


def test_go2_trots_on_its_own_plant_and_on_that_of_another_author(load, capsys):
    assert load("go2_mpc").main(seconds=4.0) == pytest.approx(0.5, rel=0.1)
    assert capsys.readouterr().out.count("upright after 4.00 s") == 2


def test_a_heavier_robot_needs_more_torque(load):
    assert 1.05 < load("randomised_mass").main(count=12) < 2.0


def test_the_composition_goes_on_after_the_roll(load, tmp_path):
    module = load("run_roll_run")
    assert module.main(tmp_path) > 0.05
    assert sorted(file.name for file in tmp_path.iterdir()) == ["pace.npz", "roll.npz"]


def test_the_trot_is_optimised_and_sampled(load):
    trot = load("trot_mppi")
    checked(trot.problem, solvers.MSiLQR(trot.problem).solve().raise_if_failed())
    assert trot.main(steps=15) >= 0.0


def test_a_value_learned_on_flat_ground_serves_on_stairs(load, tmp_path):
    file = str(tmp_path / "some.value")
    assert load("train_value").main(file, shards=1, updates=50, episodes=2) > 0.0
    assert abs(load("stairs_mppi").main(steps=15, file=file)) < 0.1  # it has only begun


def test_the_value_of_the_short_horizon_is_learnt_and_used(load, tmp_path):
    module = load("short_horizon")
    assert module.main(str(tmp_path / "some.value"), shards=1, episodes=2, updates=50) > 0.0
    shipped = EXAMPLES / module.value
    controller = sampling.TDCDMPPI(module.sampled_problem(4), module.options, reward=module.reward, value=shipped)
    episode = sampling.run_episode(controller, steps=25)
    assert not episode.fell
    assert max(episode.missed.values()) < 0.01


def test_processes_of_their_own_collect_for_a_value(tmp_path):
    out = tmp_path / "some.value"
    learn = f"import short_horizon; short_horizon.main({str(out)!r}, shards=2, episodes=1, updates=50, workers=2)"
    ran = subprocess.run([sys.executable, "-c", learn], cwd=EXAMPLES, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert out.is_file()
    assert len(list((tmp_path / "some.work").glob("*/data/shard-*"))) == 2


# ---- on terrain


@pytest.mark.parametrize(
    ("example", "name"),
    [
        ("stairs_trot", "problem"),
        ("stairs_trot", "slope"),
        ("box_jump", "problem"),
        pytest.param("box_jump", "go2", marks=pytest.mark.slow),
        pytest.param("box_jump", "anymal_c", marks=pytest.mark.slow),
    ],
)
@pytest.mark.filterwarnings("ignore::piaffe.PiaffeWarning")  # the hind legs of ANYmal cannot hold the kick at rest
def test_a_motion_on_terrain_is_solved_and_followed(example, name, load):
    found = getattr(load(example), name)
    problem = found() if callable(found) else found
    solution = solvers.MSiLQR(problem, solvers.Options(max_iterations=200)).solve().raise_if_failed()
    checked(problem, solution)
    execution = execute(solution, problem, seeds=2)
    assert execution.holds, execution
