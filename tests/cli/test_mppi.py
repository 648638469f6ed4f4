"""``piaffe mppi``: what it reads from a file, what it runs, prints, draws and keeps."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piaffe.cli.app import main
from piaffe.cli.episodes import summary
from piaffe.errors import FileFormatError, PiaffeError, ProblemError, SamplingError, UnknownNameError
from piaffe.sampling import CONTROLLERS
from piaffe.sampling.study.declared import load_declared
from piaffe.sampling.study.records import load_episodes
from piaffe.sampling.study.trials import complete, options_of, prepare

QUICK = ("--controller", "dial", "--steps", "3")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of ``piaffe mppi``."""
    capsys.readouterr()
    code = main(["mppi", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, " ".join(said.err.split())


def settings(file: Path, **given: object) -> dict[str, object]:
    return complete(load_declared(str(file)), given, "command line")


# ---- what a file declares


def test_the_problem_to_sample_goes_before_the_one_to_solve(sampled_file: Path) -> None:
    declared = load_declared(str(sampled_file))
    assert declared.name == "sampled_problem"
    assert declared.settings == {"slope": 0.0, "ground": "flat"}
    assert declared.reward.scale == 0.5


def test_a_file_that_has_none_samples_its_problem(sampled_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "one.py"
    file.write_text(sampled_file.read_text() + "\nproblem = sampled_problem()\ndel sampled_problem, options\n")
    declared = load_declared(str(file))
    assert (declared.name, declared.settings, declared.options) == ("problem", {}, {})
    assert declared.problem().schedule.segments[0].duration == pytest.approx(0.08)


def test_a_horizon_replaces_the_declared_one(sampled_file: Path) -> None:
    assert load_declared(str(sampled_file)).problem(horizon=7).schedule.segments[0].duration == pytest.approx(0.14)


def use(file: Path, name: str) -> None:
    """Read a problem, its settings, and make it."""
    declared = load_declared(f"{file}:{name}")
    complete(declared, {}, "command line")
    declared.problem()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("problem", "is not a problem to sample - got 'solo12', expected one models.Mujoco"),
        ("trot", "name 'trot': is not a problem - got"),
        ("needs", "cannot be called without arguments - got 'height: float', expected a default"),
        ("clashes", "argument 'steps' has the name of a setting of Piaffe"),
        ("absent", "no problem 'absent' - got 'absent', expected one of ['problem'"),
    ],
)
def test_what_cannot_be_sampled_is_refused(sampled_file: Path, name: str, message: str) -> None:
    with pytest.raises(PiaffeError) as error:
        use(sampled_file, name)
    assert message in str(error.value)


def test_a_file_without_any_problem_is_told_what_to_declare(tmp_path: Path) -> None:
    file = tmp_path / "empty.py"
    file.write_text("print(1)\n")
    with pytest.raises(ProblemError, match="has no problem - got no ocp.Problem.*, expected 'sampled_problem'"):
        load_declared(str(file))


def test_a_reward_that_is_none_is_refused(sampled_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "odd.py"
    file.write_text(sampled_file.read_text() + "\nreward = 0.5\n")
    with pytest.raises(ProblemError, match="name 'reward': is not what controllers take - got float, expected Reward"):
        load_declared(str(file))


OWN = """

class Best(sampling.MPPI):
    title = "best of all"
    defaults = sampling.Options(samples=7, first_stages=1)

    def update(self, xp, samples, returns, memory):
        best = xp.argmax(returns)
        return samples[best], xp.where(xp.arange(len(returns)) == best, 1.0, 0.0), memory

controllers = {"best": Best}
"""


def test_a_controller_of_the_file_is_run_by_its_name(
    capsys: pytest.CaptureFixture[str], sampled_file: Path, tmp_path: Path
) -> None:
    file = tmp_path / "own.py"
    file.write_text(sampled_file.read_text() + OWN)
    _, out, _ = run(capsys, file, "--controller", "best", "--steps", 3)
    assert "best of all, H = 4 (0.08 s), 7 samples" in out
    file.write_text(sampled_file.read_text() + OWN + "options = {'best': {'samples': 9}}\n")
    found = json.loads(run(capsys, file, "--controller", "best", "--steps", 3, "--json")[1])
    assert (found["controller"], found["settings"]["samples"]) == ("best", 9)
    assert found["episodes"][0]["effective_samples_median"] == 1.0
    assert "no controller 'worst' - got 'worst', expected one of ['td-cd', 'dial', 'mppi', 'best']" in run(
        capsys, file, "--controller", "worst"
    )[2]  # fmt: skip


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ("[1]", "name 'controllers': is not what controllers take - got list, expected Mapping"),
        ("{'best': 3}", "controllers: 'best' is no controller - got 3, expected a subclass of sampling.Sampler"),
        ("{'best': Best(sampled_problem())}", "controllers: 'best' is no controller - got <"),
        ("{'dial': Best}", "controllers: 'dial' has the name of a controller of Piaffe - got Best, expected another"),
    ],
)
def test_what_is_no_controller_of_the_file_is_refused(
    sampled_file: Path, tmp_path: Path, own: str, message: str
) -> None:
    file = tmp_path / "odd.py"
    file.write_text(sampled_file.read_text() + OWN + f"controllers = {own}\n")
    with pytest.raises(ProblemError) as error:
        load_declared(str(file))
    assert message in str(error.value)


def test_help_names_every_controller(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "--help")
    assert [name for name in CONTROLLERS if name not in out] == []


# ---- settings


def test_options_come_from_the_class_then_the_file_then_the_command(sampled_file: Path) -> None:
    declared = load_declared(str(sampled_file))
    trial = prepare(declared, settings(sampled_file, controller="dial", temperature=0.5, horizon=3), threads=1)
    assert (trial.controller.options.samples, trial.controller.options.temperature) == (12, 0.5)
    assert trial.controller.options.node_factor == type(trial.controller).defaults.node_factor
    assert (trial.controller.steps, trial.plant.timestep) == (3, 0.002)
    trial.close()


def test_options_for_all_leave_the_rest_to_each_controller(sampled_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "all.py"
    file.write_text(sampled_file.read_text() + "\noptions = sampling.Options(samples=9, p_max={'hip': 0.5})\n")
    found = options_of(load_declared(str(file)), settings(file, controller="mppi", temperature=0.1))
    assert found == replace(CONTROLLERS["mppi"].defaults, samples=9, p_max={"hip": 0.5}, temperature=0.1)
    file.write_text(sampled_file.read_text() + "\noptions = {'dial': {'sample': 9}}\n")
    with pytest.raises(SamplingError, match="options of 'dial': cannot be used - got .*'sample'"):
        settings(file, controller="dial")
    file.write_text(sampled_file.read_text() + "\noptions = {'tdcd': {'samples': 9}}\n")
    with pytest.raises(UnknownNameError, match="options: no controller 'tdcd' - got"):
        settings(file, controller="td-cd")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"controller": "tdcd"}, "no controller 'tdcd' - got 'tdcd', expected one of ['td-cd', 'dial', 'mppi']"),
        ({"terain": "flat"}, "command line: no setting 'terain'"),
        ({"steps": 0}, "steps is out of range - got 0, expected a whole number, at least 1"),
        ({"payload": -1.0}, "payload is out of range - got -1.0, expected a number, at least 0"),
        ({"spread": {"joint": 0.1}}, "no deviation of initial states 'joint'"),
        ({"spread": 3}, "spread is unusable - got 3, expected true, false or deviations by name"),
        ({"samples": 0}, "samples is out of range - got 0"),
        ({"temperature": "hot"}, "temperature is out of range - got 'hot'"),
        ({"seed": 3}, "'seed' is no setting - got 3, expected --seed, --seeds, or a study's seeds"),
        ({"controller": "dial", "value": "v.value"}, "controller 'dial' uses no value - got 'v.value'"),
    ],
)
def test_a_setting_out_of_range_is_refused(sampled_file: Path, given: dict[str, object], message: str) -> None:
    with pytest.raises(PiaffeError) as error:
        prepare(load_declared(str(sampled_file)), settings(sampled_file, **given))
    assert message in str(error.value)


def test_a_value_is_found_beside_what_names_it(sampled_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "valued.py"
    file.write_text(sampled_file.read_text() + '\nvalue = "trot.value"\n')
    with pytest.raises(FileFormatError, match=r"trot.value' is not there - got no file"):
        settings(file)
    (tmp_path / "trot.value").write_text("")
    assert settings(file)["value"] == str(tmp_path / "trot.value")
    assert settings(file, value="none")["value"] is None
    assert settings(file, controller="dial")["value"] is None


def test_what_a_file_refuses_names_its_line(capsys: pytest.CaptureFixture[str], sampled_file: Path) -> None:
    line = sampled_file.read_text().splitlines().index("        raise ValueError(f\"no ground '{ground}'\")") + 1
    code, _, err = run(capsys, sampled_file, *QUICK, "--set", "ground=icy")
    assert code == 2
    assert f"sampled.py:{line}: the file does not run - got ValueError: no ground 'icy'" in err


# ---- the command


def test_one_json_object_has_every_seed_and_their_means(capsys: pytest.CaptureFixture[str], sampled_file: Path) -> None:
    code, out, err = run(capsys, sampled_file, *QUICK, "--seeds", 2, "--json", "--threads", 1)
    assert err == ""
    assert out.count("\n") == 1
    values = json.loads(out)
    assert (values["seeds"], len(values["episodes"]), values["controller"]) == (2, 2, "dial")
    assert values["settings"] | {"horizon": 4, "samples": 12, "steps": 3, "ground": "flat"} == values["settings"]
    assert values["mean_reward"] == pytest.approx(np.mean([each["mean_reward"] for each in values["episodes"]]))
    assert values["missed_percent"]["ceiling"] > 10
    assert values["missed_percent"]["hip"] == 0
    assert values["episodes"][0]["mean_reward"] != values["episodes"][1]["mean_reward"]
    assert code == (0 if values["successes"] == 2 else 1)


def test_a_seed_gives_the_same_episode_again(capsys: pytest.CaptureFixture[str], sampled_file: Path) -> None:
    both = [json.loads(run(capsys, sampled_file, *QUICK, "--seed", 5, "--json")[1])["episodes"][0] for _ in range(2)]
    for each in both:
        for timed in ("plan_ms_median", "plan_ms_p95"):
            del each[timed]
    assert both[0] == both[1]
    assert both[0]["seed"] == 5


def test_mismatch_changes_the_plant_alone(capsys: pytest.CaptureFixture[str], sampled_file: Path) -> None:
    declared = load_declared(str(sampled_file))
    own = settings(sampled_file, controller="dial", payload=0.5, friction=0.3, plant_timestep=0.005)
    trial = prepare(declared, own, threads=1)
    mass = [sum(model.compiled().body_mass) for model in (trial.plant, trial.controller.model)]
    assert mass[0] - mass[1] == pytest.approx(0.5)
    assert (trial.plant.friction, trial.controller.model.friction) == (0.3, 1.0)
    assert (trial.plant.timestep, trial.plant.substeps) == (0.005, 4)
    trial.close()


def test_a_setting_given_twice_is_refused(capsys: pytest.CaptureFixture[str], sampled_file: Path) -> None:
    assert main(["mppi", str(sampled_file), "--samples", "8", "--set", "samples=9"]) == 2
    assert "'samples' is given twice - got --samples 8 and --set samples=9" in " ".join(capsys.readouterr().err.split())


def test_a_latency_beyond_a_step_is_refused(capsys: pytest.CaptureFixture[str], sampled_file: Path) -> None:
    code, _, err = run(capsys, sampled_file, *QUICK, "--latency", 0.03)
    assert code == 2
    assert "latency is out of range - got 0.03 s, expected 0 to 0.02 s" in err


def test_people_get_a_table_a_figure_and_the_episodes(
    capsys: pytest.CaptureFixture[str], sampled_file: Path, tmp_path: Path
) -> None:
    figure, saved = tmp_path / "new" / "p.png", tmp_path / "new" / "r.npz"
    _, out, _ = run(capsys, sampled_file, *QUICK, "--seeds", 2, "--plot", figure, "--save", saved)
    assert "DIAL-MPC, H = 4 (0.08 s), 12 samples" in out
    assert "ceiling" in out
    assert "of 2 (0.06 s without a fall" in out
    assert figure.stat().st_size > 10_000
    episodes, about = load_episodes(saved)
    assert list(episodes) == ["seed 0", "seed 1"]
    assert about["settings"]["controller"] == "dial"
    assert episodes["seed 0"].states.shape == (4, 37)
    assert episodes["seed 0"].summary()["mean_reward"] != episodes["seed 1"].summary()["mean_reward"]


@pytest.mark.parametrize(
    ("option", "file", "message"),
    [
        ("--plot", "p.txt", "unknown kind of picture - got '.txt'"),
        ("--video", "v.gif", "unknown kind of film - got '.gif', expected '.mp4'"),
        ("--set", "ground", "--set: is no setting - got 'ground', expected NAME=VALUE"),
    ],
)
def test_what_cannot_be_written_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str], sampled_file: Path, option: str, file: str, message: str
) -> None:
    code, out, err = run(capsys, sampled_file, *QUICK, option, file)
    assert (code, out) == (2, "")
    assert message in err


def test_an_episode_is_filmed_or_the_missing_package_named(sampled_file: Path, tmp_path: Path) -> None:
    """In a process of its own: how MuJoCo renders is settled when it is imported."""
    target = tmp_path / "v.mp4"
    line = ["mppi", sampled_file, *QUICK, "--video", target, "--size", "192x108"]
    done = subprocess.run(
        [sys.executable, "-m", "piaffe", *map(str, line)], env=os.environ, capture_output=True, text=True
    )
    if done.returncode == 2:
        assert "libosmesa6" in done.stderr
        return
    assert f"saved {target}" in done.stdout
    assert target.stat().st_size > 1000


# ---- many seeds as one


def test_a_summary_counts_means_and_keeps_the_worst() -> None:
    row = {
        "success": True, "fell": False, "mean_reward": 0.8, "missed_percent": {"a": 1.0, "b": 0.0},
        "speed_error_m_per_s": 0.02, "plan_ms_median": 10.0, "plan_ms_p95": 12.0, "effective_samples_median": 9.0,
        "failed_rollouts": 3,
    }  # fmt: skip
    other = row | {"success": False, "fell": True, "mean_reward": 0.4, "missed_percent": {"a": 0.0, "b": 3.0}}
    found = summary([row, other | {"speed_error_m_per_s": 0.06}])
    assert (found["seeds"], found["successes"], found["falls"], found["failed_rollouts"]) == (2, 1, 1, 6)
    assert found["mean_reward"] == pytest.approx(0.6)
    assert found["missed_percent"] == {"a": 0.5, "b": 1.5}
    assert found["missed_percent_worst"] == 1.5
    assert (found["speed_error_m_per_s"], found["speed_error_m_per_s_worst"]) == (pytest.approx(0.04), 0.06)
