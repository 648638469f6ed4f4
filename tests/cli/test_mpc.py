"""``piaffe mpc``: what it reads from a file, what it runs, prints and draws."""

import json
from pathlib import Path

import pytest
from matplotlib.image import imread

from piaffe.cli.app import main

CASCADE = Path(__file__).parents[2] / "examples" / "cascade.py"
SHORT = ("--seconds", "0.3")


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of ``piaffe mpc``."""
    capsys.readouterr()
    code = main(["mpc", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, " ".join(said.err.split())


def values(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    """Return the object that ``piaffe mpc --json`` prints; the command must succeed."""
    code, out, err = run(capsys, CASCADE, *SHORT, *arguments, "--json")
    assert code == 0, err
    return json.loads(out)


def exact(row: dict) -> dict:
    """Return the figures of an episode without those of the computer's clock."""
    return {key: value for key, value in row.items() if "plan_ms" not in key and "tick_us" not in key}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A file with the problem of the example, to which a test appends."""
    path = tmp_path / "walk.py"
    path.write_text(CASCADE.read_text())
    return path


# ---- what runs


def test_seeds_differ_and_can_be_repeated_alone(capsys: pytest.CaptureFixture[str]) -> None:
    both = values(capsys, "--seed", 3, "--seeds", 2)
    assert [row["seed"] for row in both["episodes"]] == [3, 4]
    assert (both["successes"], both["falls"], both["seeds"]) == (2, 0, 2)
    assert [row["plans"] for row in both["episodes"]] == [15, 15]
    first, second = (exact(row) for row in both["episodes"])
    assert first["rms_velocity_error_m_per_s"] != second["rms_velocity_error_m_per_s"]
    assert exact(values(capsys, "--seed", 4)["episodes"][0]) == second


@pytest.mark.parametrize("low", ["riccati", "pd"])
def test_other_low_levels(capsys: pytest.CaptureFixture[str], low: str) -> None:
    made = values(capsys, "--low", low)
    assert made["settings"]["low"] == low
    assert made["settings"]["qp"] is None
    assert exact(made["episodes"][0]) != exact(values(capsys)["episodes"][0])


def test_quadratic_programs_of_the_low_level_agree(capsys: pytest.CaptureFixture[str]) -> None:
    own, other = values(capsys)["episodes"][0], values(capsys, "--qp", "numpy")["episodes"][0]
    assert other["speed_m_per_s"] == pytest.approx(own["speed_m_per_s"], abs=1e-3)


@pytest.mark.parametrize(
    "changed", [("--command", "vx=1@0.1"), ("--push", "0.5@0.1:y"), ("--payload", 1), ("--friction", 0.1)]
)
def test_commands_pushes_and_the_plant_change_the_motion(
    capsys: pytest.CaptureFixture[str], changed: tuple[object, ...]
) -> None:
    plain, made = (values(capsys, *given)["episodes"][0] for given in ((), changed))
    assert made["rms_velocity_error_m_per_s"] != plain["rms_velocity_error_m_per_s"]


def test_a_plan_acts_after_the_latency(capsys: pytest.CaptureFixture[str]) -> None:
    assert values(capsys, "--latency", 0.01)["episodes"][0]["plan_age_ms_max"] == pytest.approx(28)


def test_a_file_may_set_arguments_of_the_planner(capsys: pytest.CaptureFixture[str], file: Path) -> None:
    file.write_text(file.read_text() + "\nmpc = dict(period=0.03, iterations=2, latency=0.02)\n")
    code, out, err = run(capsys, file, *SHORT, "--json")
    assert code == 0, err
    made = json.loads(out)
    assert (made["period_s"], made["iterations"], made["settings"]["latency"]) == (0.03, 2, 0.02)
    assert made["episodes"][0]["plans"] == 10
    code, out, err = run(capsys, file, *SHORT, "--latency", 0, "--json")
    assert json.loads(out)["settings"]["latency"] == 0


def test_a_fall_is_no_success(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, CASCADE, "--seconds", 1, "--push", "4@0.05:y")
    assert code == 1
    assert "success in 0 of 1" in out
    assert "seed 0: the base is" in out


# ---- pictures


def test_figure_of_an_episode(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    picture = tmp_path / "new" / "episode.png"
    code, out, err = run(capsys, CASCADE, *SHORT, "--plot", picture)
    assert code == 0, err
    assert f"saved {picture}" in out
    pixels = imread(picture)
    assert pixels.shape[1] > 1000
    assert pixels.std() > 0.05


# ---- what is refused


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--command", "vx:0.5"), "command: text is unusable - got 'vx:0.5'"),
        (("--command", "hop=1"), "no command 'hop'"),
        (("--push", "1.5@y"), "push: text is unusable - got '1.5@y'"),
        (("--push", "1@0.0005:x"), "push: time after the start at 0 s is out of range"),
        (("--latency", 0.0105), "command line: latency is out of range - got 0.0105 s, expected a multiple"),
        (("--latency", 0.04), "expected 0 to the period, 0.02 s"),
        (("--latency", -0.01), "command line: latency is out of range"),
        (("--seconds", 0), "command line: seconds is out of range"),
        (("--low", "lqr"), "no low level 'lqr'"),
        (("--qp", "best"), "no quadratic program 'best'"),
        (("--qp", "daqp", "--low", "pd"), "low level 'pd' has no quadratic program"),
        (("--payload", -1), "payload: mass is out of range"),
        (("--friction", -1), "plant: friction is out of range"),
        (("--plant", "absent.xml"), "absent.xml"),
        (("--plot", "picture.doc"), "unknown kind of picture"),
        (("--video", "film.doc"), "unknown kind of film"),
    ],
)
def test_bad_options_are_named(capsys: pytest.CaptureFixture[str], arguments: tuple, message: str) -> None:
    code, out, err = run(capsys, CASCADE, *arguments)
    assert (code, out) == (2, "")
    assert message in err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mpc = dict(perid=0.03)", "no argument of RecedingHorizon 'perid'"),
        ("mpc = 3", "name 'mpc': is not a dict - got int"),
        ("mpc = dict(period=0.015)", "receding horizon: period is out of range"),
    ],
)
def test_bad_settings_of_a_file_are_named(
    capsys: pytest.CaptureFixture[str], file: Path, text: str, message: str
) -> None:
    file.write_text(f"{file.read_text()}\n{text}\n")
    code, _, err = run(capsys, file)
    assert code == 2
    assert message in err


def test_a_model_without_a_robot_is_refused(capsys: pytest.CaptureFixture[str], ball_file: Path) -> None:
    code, _, err = run(capsys, ball_file)
    assert code == 2
    assert "the first model cannot be simulated - got 'ball'" in err
