"""The commands: what they print, how they end, and what they say when they cannot do what is asked."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import piaffe.cli
from piaffe import __version__
from piaffe.cli.app import main
from piaffe.solvers import Solution

COMMANDS = (
    "new", "describe", "solve", "plot", "verify", "video", "view", "pose", "check", "doctor", "cache", "mpc", "mppi",
    "study", "export",
)  # fmt: skip


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of a command."""
    capsys.readouterr()
    code = main([str(argument) for argument in arguments])
    said = capsys.readouterr()
    return code, said.out, " ".join(said.err.split())


# ---- help


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(capsys, "--version") == (0, f"piaffe {__version__}\n", "")


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--help")
    assert code == 0
    assert [command for command in COMMANDS if command not in out] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(capsys: pytest.CaptureFixture[str], command: str) -> None:
    code, out, _ = run(capsys, command, "--help")
    assert code == 0
    assert "Usage: piaffe" in out


@pytest.mark.parametrize(
    ("command", "words"),
    [("pose", "of the base [rad]"), ("video", "the vertical [degree]"), ("solve", "Time limit [s]")],
)
def test_help_shows_units(capsys: pytest.CaptureFixture[str], command: str, words: str) -> None:
    _, out, _ = run(capsys, command, "--help")
    assert words in " ".join(out.replace("│", " ").split())


def test_no_help_loses_its_brackets() -> None:
    lost = [
        f"{file.name}: {line.strip()}"
        for file in Path(piaffe.cli.__file__).parent.glob("*.py")
        for line in file.read_text().splitlines()
        if re.search(r'help="[^"]*(?<!\\)\[[a-z]', line)
    ]
    assert lost == []  # Rich reads [s] as a mark and removes it


def test_it_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "piaffe", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"piaffe {__version__}\n"


def test_an_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "gallop")
    assert code == 2
    assert "No such command 'gallop'" in err


# ---- FILE[:name]


@pytest.mark.parametrize("name", ["", ":problem", ":made"])
def test_describe_takes_a_problem_or_a_function_by_name(
    capsys: pytest.CaptureFixture[str], ball_file: Path, name: str
) -> None:
    code, out, _ = run(capsys, "describe", f"{ball_file}{name}")
    assert code == 0
    assert "85 stages over 0.850 s" in out
    assert "thrust limit" in out


def test_a_missing_file_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "describe", "/nowhere/ball.py")
    assert (code, out) == (2, "")
    assert err == (
        "error: file '/nowhere/ball.py': does not exist - got no file, expected a Python file with a problem; check "
        "the path"
    )


def test_an_unknown_name_lists_those_that_exist(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, _, err = run(capsys, "solve", f"{ball_file}:mad")
    assert code == 2
    assert (
        "no problem 'mad' - got 'mad', expected one of ['problem', 'kink', 'singular', 'impossible', 'made', 'broken']"
        in err
    )
    assert err.endswith("did you mean 'made'?")


def test_what_is_no_problem_is_refused(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, _, err = run(capsys, "solve", f"{ball_file}:bounce")
    assert code == 2
    assert "name 'bounce': is not a problem - got Motion, expected an ocp.Problem or a function that returns one" in err


def test_an_error_in_the_file_names_its_line(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    line = ball_file.read_text().splitlines().index("    return 1 / 0") + 1
    code, _, err = run(capsys, "solve", f"{ball_file}:broken")
    assert code == 2
    assert f"ball.py:{line}: the file does not run - got ZeroDivisionError: division by zero" in err
    with pytest.raises(ValueError, match="division by zero"):
        main(["--traceback", "solve", f"{ball_file}:broken"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = (", "the file does not run - got SyntaxError: '(' was never closed"),
        ("import sys; sys.exit(3)", "exits when imported - got sys.exit(3)"),
        ("import numppy", "broken.py:1: the file does not run - got ModuleNotFoundError: No module named 'numppy'"),
        ("from piaffe import models\nmodels.terrain.Box(centre=(1, 0))", "the arguments place, size, height, yaw;"),
        ("from piaffe import ocp\nocp.track('x', weights=1)", "expected the arguments quantity, weight, at, when, to,"),
        ("from piaffe import ocp\nocp.Phase('push', 'on')", "until, reset, constraints, objective (duration: length"),
        ("float(base=3)", "got TypeError: float() takes no keyword arguments, expected a declaration"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_run_says_why(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, text: str, message: str
) -> None:
    file = tmp_path / "broken.py"
    file.write_text(text)
    code, _, err = run(capsys, "describe", file)
    assert code == 2
    assert message in err


def test_files_beside_the_problem_can_be_imported(
    capsys: pytest.CaptureFixture[str], ball_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "shared_ball.py").write_text(ball_file.read_text())
    (tmp_path / "mine.py").write_text("from shared_ball import problem")
    assert run(capsys, "describe", tmp_path / "mine.py")[0] == 0


# ---- solve


def test_solve_prints_one_json_object(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, out, err = run(capsys, "solve", ball_file, "--json")
    assert (code, err) == (0, "")
    assert out.count("\n") == 1
    values = json.loads(out)
    assert (values["status"], values["converged"]) == ("CONVERGED", True)
    assert values["iterations"] > 0
    assert values["max_defect"] <= 1e-5
    assert values["max_equality"] <= 1e-4
    assert values["max_inequality"] <= 1e-4
    assert values["wall_s"] >= values["compile_s"] > 0
    assert values["cost"] == pytest.approx(sum(values["term_costs"].values()))


def test_what_a_file_prints_stays_out_of_the_json(
    capsys: pytest.CaptureFixture[str], ball_file: Path, ball: Path, tmp_path: Path
) -> None:
    chatty = tmp_path / "chatty.py"
    chatty.write_text(ball_file.read_text() + '\nprint("hello")\n')
    for arguments in (("solve", chatty), ("verify", ball, chatty)):
        code, out, err = run(capsys, *arguments, "--json")
        assert (code, err) == (0, "hello")
        assert isinstance(json.loads(out), dict)


def test_solve_shows_iterations_and_a_summary(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, out, _ = run(capsys, "solve", ball_file)
    assert code == 0
    assert out.split()[:3] == ["iteration", "cost", "expected"]
    assert "CONVERGED" in out
    assert "regularize thrust" in out
    assert "thrust limit" in out


def test_solve_ends_with_1_if_it_does_not_converge(
    capsys: pytest.CaptureFixture[str], ball_file: Path, tmp_path: Path
) -> None:
    saved = tmp_path / "half.npz"
    code, out, _ = run(capsys, "solve", f"{ball_file}:impossible", "--max-iterations", 3, "--json", "--save", saved)
    assert code == 1
    values = json.loads(out)
    assert (values["status"], values["iterations"]) == ("ITERATION_LIMIT", 3)
    assert "max_iterations" in values["advice"]
    assert saved.is_file()
    code, out, _ = run(capsys, "solve", f"{ball_file}:impossible", "--max-iterations", 3)
    assert code == 1
    assert "'ceiling lower'" in out


def test_solve_begins_from_a_saved_solution(capsys: pytest.CaptureFixture[str], ball_file: Path, ball: Path) -> None:
    code, out, _ = run(capsys, "solve", ball_file, "--warm-start", ball, "--json")
    assert code == 0
    assert json.loads(out)["iterations"] <= 2


def test_solve_saves_under_the_name_of_the_file(
    capsys: pytest.CaptureFixture[str], ball_file: Path, folder: Path
) -> None:
    code, out, _ = run(capsys, "solve", ball_file)
    assert (code, out.splitlines()[-1]) == (0, "saved results/ball.npz")
    run(capsys, "solve", f"{ball_file}:made", "--json")
    assert sorted(path.name for path in folder.glob("results/*")) == ["ball-made.npz", "ball.npz"]
    assert Solution.load(folder / "results" / "ball.npz").converged
    run(capsys, "solve", f"{ball_file}:kink", "--no-save", "--max-iterations", 1)
    assert len(list(folder.glob("results/*"))) == 2


def test_solve_warns_if_the_default_is_no_place_and_solves(
    capsys: pytest.CaptureFixture[str], ball_file: Path, folder: Path
) -> None:
    (folder / "results").write_text("a file where the folder would be")
    code, out, err = run(capsys, "solve", ball_file)
    assert code == 0
    assert "CONVERGED" in out
    assert err.startswith("warning: the solution is not saved: ")
    assert "results" in err
    code, out, err = run(capsys, "solve", ball_file, "--save", folder / "results" / "ball.npz")
    assert code == 2  # a place that was asked for is an error, before the solve
    assert "iteration" not in out


def test_solve_draws_what_it_solved(capsys: pytest.CaptureFixture[str], ball_file: Path, folder: Path) -> None:
    code, out, _ = run(capsys, "solve", ball_file, "--plot", folder / "ball.png", "--save", folder / "ball.npz")
    assert code == 0
    assert out.splitlines()[-2:] == [f"saved {folder / 'ball.npz'}", f"saved {folder / 'ball.png'}"]
    assert (folder / "ball.png").read_bytes().startswith(b"\x89PNG")
    code, out, err = run(capsys, "solve", ball_file, "--plot", folder / "ball.xyz")
    assert code == 2
    assert "unknown kind of picture - got '.xyz'" in err
    assert "iteration" not in out
    code, _, err = run(capsys, "solve", ball_file, "--video", folder / "ball.avi")
    assert code == 2
    assert "unknown kind of film - got '.avi'" in err


# ---- verify


def test_verify_prints_one_json_object(capsys: pytest.CaptureFixture[str], ball_file: Path, ball: Path) -> None:
    code, out, _ = run(capsys, "verify", ball, ball_file, "--json")
    assert code == 0
    values = json.loads(out)
    assert values["verified"]
    assert values["max_defect"] <= 1e-4
    assert (values["turns_rad"], values["apex_m"], values["min_foot_z_m"]) == (None, None, None)
    assert set(values["worst"]) == {"kind", "name", "phase", "node", "amount", "unit", "source"}


def test_verify_measures_a_robots_motion(capsys: pytest.CaptureFixture[str], hop_file: Path, hop: Path) -> None:
    code, out, _ = run(capsys, "verify", hop, hop_file, "--json")
    assert code == 0
    values = json.loads(out)
    assert 0.24 < values["apex_m"] < 0.35
    assert len(values["turns_rad"]) == 3
    assert values["turns_x_rad"] == values["turns_rad"][0]
    assert values["min_foot_z_m"] > -0.01
    assert values["max_inequality"] <= 1e-3


def test_verify_ends_with_1_beyond_the_bounds(capsys: pytest.CaptureFixture[str], ball_file: Path, ball: Path) -> None:
    """The solution from one height is none from another: the initial state is off by 0.1 m."""
    code, out, _ = run(capsys, "verify", ball, f"{ball_file}:made", "--json")
    assert code == 1
    worst = json.loads(out)["worst"]
    assert (worst["kind"], worst["phase"], worst["node"]) == ("defect", "drop", 0)
    assert worst["amount"] == pytest.approx(0.1)
    code, out, _ = run(capsys, "verify", ball, f"{ball_file}:made")
    assert code == 1
    assert "not within the bounds: defect, 1e+03 times its bound; solve again with this file" in out


def test_verify_notes_a_joint_that_is_too_fast(
    capsys: pytest.CaptureFixture[str], hop_file: Path, hop: Path, tmp_path: Path
) -> None:
    solution = Solution.load(hop)
    values = json.loads(run(capsys, "verify", hop, hop_file, "--json")[1])
    speeds = np.abs(np.concatenate([phase.states[:, 25:] for phase in solution.trajectory.phases]))
    assert values["fastest_joint"]["speed"] == pytest.approx(speeds.max())
    assert values["fastest_joint"]["ratio"] < 1.01
    assert "note:" not in run(capsys, "verify", hop, hop_file)[1]
    slow = tmp_path / "slow.py"
    lines = (
        'cheetah = models.load("mini_cheetah")\n'
        "cheetah = dataclasses.replace(cheetah, joint_speed_limit=cheetah.joint_speed_limit / 40)\n"
        "body = models.WholeBody(cheetah)"
    )
    text = hop_file.read_text().replace('body = models.WholeBody(models.load("mini_cheetah"))', lines)
    slow.write_text(f"import dataclasses\n{text}")
    code, out, _ = run(capsys, "verify", hop, slow)
    assert code == 0
    assert re.search(
        r"note: joint \S+ reaches [\d.]+, [\d.]+ times the robot's limit of [\d.]+; models.joint_speed", out
    )


def test_verify_reports_slip_height_and_flight(capsys: pytest.CaptureFixture[str], hop_file: Path, hop: Path) -> None:
    _, out, _ = run(capsys, "verify", hop, hop_file, "--json")
    values = json.loads(out)
    for kind, point in (("slip", "slip"), ("height", "height"), ("flight", "centre of mass off its parabola")):
        worst = values[f"worst_{kind}"]
        assert worst["amount"] == values[f"max_{kind}_m"]
        assert worst["name"].endswith(point)
        assert worst["unit"] == "m"
    _, out, _ = run(capsys, "verify", hop, hop_file)
    assert all(kind in out for kind in ("slip", "height", "flight"))


def test_verify_plays_the_policy(capsys: pytest.CaptureFixture[str], hop_file: Path, hop: Path) -> None:
    arguments = ("verify", hop, hop_file, "--simulate", "--seeds", 2, "--first-seed", 5, "--perturbation", 0.5)
    code, out, _ = run(capsys, *arguments, "--json")
    values = json.loads(out)
    played = values["simulation"]
    assert code == (0 if values["verified"] else 1)
    assert (played["seeds"], played["followed"], played["friction"]) == (2, 2, 0.6)
    assert played["duration_s"] == pytest.approx(0.4)
    assert played["perturbation"]["joints"] == pytest.approx(0.005)
    assert [trial["seed"] for trial in played["trials"]] == [5, 6]
    assert 0 < played["error_median_m"] <= played["error_worst_m"] < 0.06
    assert all({"what", "name", "time_s", "phase", "amount", "text"} == set(each) for each in trial_deviations(played))
    _, out, _ = run(capsys, *arguments)
    assert "2 of 2 starts followed to the end, 0.40 s, at friction 0.6" in out


def trial_deviations(played: dict[str, Any]) -> list[dict[str, Any]]:
    return [each for trial in played["trials"] for each in trial["deviations"]]


def test_verify_says_why_a_start_is_lost(capsys: pytest.CaptureFixture[str], hop_file: Path, hop: Path) -> None:
    code, out, _ = run(capsys, "verify", hop, hop_file, "--simulate", "--seeds", 1, "--perturbation", 40)
    assert code == 1
    assert "0 of 1 starts followed to the end" in out
    assert "seed 0: lost at 0." in out


def test_a_ball_cannot_be_played(capsys: pytest.CaptureFixture[str], ball_file: Path, ball: Path) -> None:
    code, _, err = run(capsys, "verify", ball, ball_file, "--simulate")
    assert code == 2
    assert "execution: the problem does not begin with a whole body - got model 'ball'" in err


def test_verify_refuses_another_problem(capsys: pytest.CaptureFixture[str], hop_file: Path, ball: Path) -> None:
    code, _, err = run(capsys, "verify", ball, hop_file)
    assert code == 2
    assert (
        "is not of this problem - got (name, stages, nx, nu) = ('drop', 45, 2, 1), expected ('push', 8, 37, 12)" in err
    )


def test_a_file_that_is_no_solution_is_refused(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, _, err = run(capsys, "verify", ball_file, ball_file)
    assert code == 2
    assert "error: file 'ball.py': truncated or not an archive - got no archive, expected a .npz saved by Piaffe" in err


# ---- check


def test_check_compares_every_derivative(capsys: pytest.CaptureFixture[str], hop_file: Path) -> None:
    code, out, _ = run(capsys, "check", hop_file)
    assert code == 0
    assert "model 'mini_cheetah', mode 'contact'" in out
    assert "reset 'flight' → 'land'" in out
    assert "1/((m/s)^2 s)" in out
    counts = out.splitlines()[-1].split()
    assert counts[0] == counts[2]


def test_check_names_what_is_not_smooth(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, out, _ = run(capsys, "check", f"{ball_file}:kink")
    assert code == 1
    assert "kink (ball.py:" in out
    assert "is not smooth here" in out


def test_check_names_what_is_not_finite(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, out, _ = run(capsys, "check", f"{ball_file}:singular")
    assert code == 1
    assert "error: term 'root' (ball.py:" in out
    assert "is not finite here" in out


# ---- doctor, view


def test_doctor_examines_a_robot(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "doctor", "mini_cheetah")
    assert code == 0
    assert "0 errors" in out


def test_doctor_takes_feet_as_words(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "doctor", "mini_cheetah", "--feet", "FL_FOOT FR_FOTO")
    assert code == 1
    assert "FR_FOTO" in out


def test_view_says_that_there_is_no_display(
    capsys: pytest.CaptureFixture[str], hop: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    code, _, err = run(capsys, "view", hop)
    assert code == 2
    assert "view: there is no display - got neither DISPLAY nor WAYLAND_DISPLAY" in err


def test_help_does_not_wait_for_what_commands_import() -> None:
    code = "import sys, piaffe.cli.app; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "piaffe.cli.app" in loaded
    assert {"casadi", "numpy", "mujoco", "matplotlib", "piaffe.ocp"} & set(loaded) == set()


# ---- new


@pytest.mark.parametrize("robot", ["mini_cheetah", "solo12", "go2", "anymal_c"])
def test_a_new_motion_is_ready_to_solve_and_executes(
    capsys: pytest.CaptureFixture[str], folder: Path, robot: str
) -> None:
    code, out, _ = run(capsys, "new", folder / "hop", "--robot", robot)
    assert (code, out.splitlines()) == (0, [f"saved {folder / 'hop' / name}" for name in ("README.md", "motion.py")])
    code, _, err = run(capsys, "solve", folder / "hop" / "motion.py")
    assert (code, err) == (0, "")  # no warning
    code, out, _ = run(capsys, "verify", "results/motion.npz", folder / "hop" / "motion.py", "--simulate", "--seeds", 2)
    assert code == 0
    assert "2 of 2 starts followed to the end" in out


def test_new_overwrites_nothing(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "motion.py").write_text("mine")
    code, out, err = run(capsys, "new", folder)
    assert (code, out) == (2, "")
    assert "motion.py' exists - got a folder with this file" in err
    assert (folder / "motion.py").read_text() == "mine"
    code, _, err = run(capsys, "new", folder / "other", "--robot", "solo13")
    assert code == 2
    assert "did you mean 'solo12'?" in err
    assert not (folder / "other").exists()
