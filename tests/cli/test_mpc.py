"""``piaffe mpc``: what it reads from a file, what it runs, prints and draws."""

import json
from pathlib import Path

import pytest
from matplotlib.image import imread
from matplotlib.text import Annotation

from piaffe.cli.app import main
from piaffe.viz import online_figure

EXAMPLES = Path(__file__).parents[2] / "examples"
CASCADE, GO2, OTHER, NAMES = (
    EXAMPLES / name for name in ("cascade.py", "go2_mpc.py", "other_go2.xml", "other_go2.toml")
)
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


def test_seeds_in_processes_are_those_of_one_process(capsys: pytest.CaptureFixture[str]) -> None:
    one, two = (values(capsys, "--seeds", 2, "--workers", count) for count in (1, 2))
    assert [exact(row) for row in one["episodes"]] == [exact(row) for row in two["episodes"]]


DRAWN = ("mass_spread", "friction", "perturbation", "noise")


@pytest.mark.parametrize("kept", DRAWN)
def test_each_thing_that_seeds_draw_changes_the_motion_by_itself(capsys: pytest.CaptureFixture[str], kept: str) -> None:
    alone = {"mass_spread": "0.05", "friction": "0.2:0.9", "perturbation": "1", "noise": "1"}[kept]
    made = values(capsys, "--no-spread", f"--{kept.replace('_', '-')}", alone, "--seeds", 2, "--workers", 1)
    first, second = (exact(row) for row in made["episodes"])
    assert {**first, "seed": 1} != second
    off = {name: made["settings"][name] for name in DRAWN if name != kept}
    assert off == {name: value for name, value in OFF.items() if name != kept}


OFF = {"mass_spread": 0.0, "friction": 0.6, "perturbation": 0.0, "noise": 0.0}


def test_without_spread_seeds_are_equal_and_the_friction_is_the_problems(
    capsys: pytest.CaptureFixture[str], file: Path
) -> None:
    file.write_text(file.read_text().replace("mu=0.6", "mu=0.55"))
    code, out, err = run(capsys, file, *SHORT, "--no-spread", "--seeds", 2, "--workers", 1, "--json")
    assert code == 0, err
    made = json.loads(out)
    assert made["settings"]["friction"] == 0.55
    first, second = (exact(row) for row in made["episodes"])
    assert {**first, "seed": 1} == second


@pytest.mark.parametrize("low", ["riccati", "pd"])
def test_other_low_levels(capsys: pytest.CaptureFixture[str], low: str) -> None:
    made = values(capsys, "--low", low)
    assert made["settings"]["low"] == low
    assert made["settings"]["qp"] is None
    assert exact(made["episodes"][0]) != exact(values(capsys)["episodes"][0])


@pytest.mark.parametrize("low", ["vwbc", "riccati", "pd"])
def test_gains_of_joints_change_every_low_level(capsys: pytest.CaptureFixture[str], low: str) -> None:
    plain, made = (values(capsys, "--low", low, *given)["episodes"][0] for given in ((), ("--gains", "5:0.2")))
    assert exact(made) != exact(plain)
    if low == "pd":
        assert exact(values(capsys, "--low", low, "--gains", "20:0.5")["episodes"][0]) == exact(plain)


def test_quadratic_programs_of_the_low_level_agree(capsys: pytest.CaptureFixture[str]) -> None:
    own, other = values(capsys)["episodes"][0], values(capsys, "--qp", "numpy")["episodes"][0]
    assert other["speed_m_per_s"] == pytest.approx(own["speed_m_per_s"], abs=1e-3)


@pytest.mark.parametrize("method", ["daqp", "osqp"])
def test_programs_that_are_installed_run(capsys: pytest.CaptureFixture[str], method: str) -> None:
    pytest.importorskip(method)
    own, other = values(capsys, "--qp", "own"), values(capsys, "--qp", method)
    assert other["settings"]["qp"] == method
    assert other["fallbacks"] == 0
    got, expected = other["episodes"][0], own["episodes"][0]
    assert got["rms_velocity_error_m_per_s"] == pytest.approx(expected["rms_velocity_error_m_per_s"], abs=1e-3)


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
    assert (
        "no episode without a fall is long enough to judge its speed" in out
    )  # the speed of a fallen robot is not judged


def test_success_needs_the_commanded_speed(capsys: pytest.CaptureFixture[str]) -> None:
    about = ("--seconds", 1.2, "--settle", 0.5, "--no-spread")  # within the ramp: the robot is slower than its command
    code, out, err = run(capsys, CASCADE, *about, "--json")
    assert code == 1, err
    made = json.loads(out)
    row = made["episodes"][0]
    assert (made["successes"], made["stayed_upright"], made["followed"], made["falls"]) == (0, 1, 0, 0)
    assert (row["success"], row["stayed_upright"], row["upright"], row["followed"]) == (False, True, True, False)
    (stretch,) = row["stretches"]
    expected = abs(stretch["speed_m_per_s"] / stretch["commanded_m_per_s"] - 1)
    assert row["speed_error"] == pytest.approx(expected)
    assert made["median"]["speed_error"] == made["worst"]["speed_error"] == row["speed_error"] > 0.05
    code, out, err = run(capsys, CASCADE, *about, "--speed-bound", 0.9)
    assert code == 0, err
    assert "success in 1 of 1" in out
    code, out, _ = run(capsys, CASCADE, *about)
    assert code == 1
    assert "upright, wrong speed" in out
    assert "upright at the end: 1 of 1; speed within 5 % of the command from 0.5 s after its changes on: 0 of 1" in out


def test_an_episode_that_is_too_short_is_judged_without_its_speed(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, CASCADE, *SHORT)
    assert code == 0
    assert "no episode without a fall is long enough to judge its speed, 2 s after a change" in out


def test_summary_has_medians_and_worst_cases(capsys: pytest.CaptureFixture[str]) -> None:
    made = values(capsys, "--seeds", 3, "--workers", 1)
    found = sorted(row["rms_velocity_error_m_per_s"] for row in made["episodes"])
    assert made["median"]["rms_velocity_error_m_per_s"] == found[1]
    assert made["worst"]["rms_velocity_error_m_per_s"] == found[2]
    assert made["median"]["speed_error"] is None  # no seed is judged


# ---- the plant of a file


def test_names_of_another_authors_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = NAMES.read_text()
    line = 'FL = "front_left_toe"'
    assert line in text
    fewer = tmp_path / "fewer.toml"
    fewer.write_text(text.replace(line, "").replace('FL_hip_joint = "front_left_abduction"', ""))
    short = (GO2, *SHORT, "--plant", OTHER, "--json")
    more = ("--names", fewer, "--joint", "FL_hip_joint=front_left_abduction", "--foot", "FL=front_left_toe")
    made = []
    for names in (("--names", NAMES), more):
        code, out, err = run(capsys, *short, *names)
        assert code == 0, err
        made.append(json.loads(out))
    first, second = made
    assert exact(first["episodes"][0]) == exact(second["episodes"][0])
    assert first["settings"]["friction"] is None
    assert first["settings"]["mass_spread"] == 0
    code, _, err = run(capsys, *short, "--names", fewer)
    assert code == 2
    assert "joints of robot 'go2' are missing - got front_left_abduction, expected FL_hip_joint" in err
    assert "--joint FL_hip_joint=..." in err
    code, _, err = run(capsys, *short, *more[:-2])
    assert code == 2
    assert "foot 'FL': no geom, site or body 'FL or FL_foot'" in err


# ---- pictures


def test_figure_of_an_episode(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    picture = tmp_path / "new" / "episode.png"
    code, out, err = run(capsys, CASCADE, *SHORT, "--plot", picture)
    assert code == 0, err
    assert f"saved {picture}" in out
    pixels = imread(picture)
    assert pixels.shape[1] > 1000
    assert pixels.std() > 0.05


def test_several_seeds_have_a_figure_each(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = run(capsys, CASCADE, *SHORT, "--seeds", 2, "--workers", 1, "--plot", tmp_path / "all.png")
    assert code == 0, err
    for seed in (0, 1):
        assert f"saved {tmp_path}/all-seed-{seed}.png" in out
        assert imread(tmp_path / f"all-seed-{seed}.png").std() > 0.05


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
        (("--gains", "3"), "gains are unusable - got '3', expected stiffness and damping"),
        (("--gains", "3:-1"), "gains are unusable - got '3:-1'"),
        (("--payload", -1), "payload: mass is out of range"),
        (("--friction", -1), "plant: friction is out of range"),
        (("--friction", "0.8:0.5"), "variation: friction is out of range - got 0.8 to 0.5"),
        (("--friction", "ice"), "friction is unusable - got 'ice', expected a number, or two as 0.5:0.8"),
        (("--friction", "0.1:0.2:0.3"), "friction is unusable - got '0.1:0.2:0.3'"),
        (("--mass-spread", 1.5), "variation: mass is out of range - got 1.5"),
        (("--noise", -1), "noise is out of range - got -1.0, expected a number ≥ 0"),
        (("--perturbation", -1), "perturbation is out of range - got -1.0"),
        (("--settle", -1), "settle is out of range - got -1.0"),
        (("--speed-bound", "nan"), "speed_bound is out of range - got nan"),
        (("--joint", "a=b"), "names are given without a file that has them"),
        (
            ("--plant", "a.xml", "--foot", "FL"),
            "--foot is unusable - got 'FL', expected the robot's name and the file's",
        ),
        (("--plant", "a.xml", "--names", "absent.toml"), "names 'absent.toml': cannot be read"),
        (("--plant", "absent.xml"), "absent.xml"),
        (("--plot", "picture.doc"), "unknown kind of picture"),
        (("--video", "film.doc"), "unknown kind of film"),
    ],
)
def test_bad_options_are_named(capsys: pytest.CaptureFixture[str], arguments: tuple, message: str) -> None:
    code, out, err = run(capsys, CASCADE, *arguments)
    assert (code, out) == (2, "")
    assert message in err


SEVERAL = "problem = {'first': problem, 'again': problem}\n"


def test_a_file_may_have_several_motions(
    capsys: pytest.CaptureFixture[str], file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []
    monkeypatch.setattr(online_figure, "save_figure", lambda figure, path: drawn.append(figure) or path)
    file.write_text(f"{file.read_text()}\n{SEVERAL}mpc = dict(start='again', preparations=1)\n")
    picture = file.parent / "motions.png"
    words = ("--seconds", "0.6", "--command", "vx=0.4 motion=first@0.02", "--plot", picture, "--json")
    code, out, err = run(capsys, file, *words)
    assert code == 0, err
    motions = json.loads(out)["episodes"][0]["motions"]
    (figure,) = drawn
    names = {text.get_text(): text.xy[0] for ax in figure.axes for text in ax.texts if isinstance(text, Annotation)}
    assert names.items() >= {(name, time) for time, name in motions}
    assert [name for _, name in motions] == ["again", "first"]
    assert 0.02 < motions[1][0] < 0.6
    code, out, _ = run(capsys, file, *SHORT)
    assert code == 0
    assert "mpc of first, again" in " ".join(out.split())


@pytest.mark.parametrize(
    ("arguments", "text", "message"),
    [
        (("--command", "motion=third@1"), "", "motions, command: no motion 'third'"),
        (("--command", "motion=3@1"), "", "text is unusable - got 'motion=3@1'"),
        ((), "mpc = dict(start='third')", "motions, start: no motion 'third'"),
        ((), "mpc = dict(begin='again')", "no argument of Motions 'begin'"),
        ((), "problem = {'first': 3}", "name 'problem': is not a problem - got dict"),
        ((), "problem = {}", "name 'problem': is not a problem - got dict"),
    ],
)
def test_bad_motions_are_named(
    capsys: pytest.CaptureFixture[str], file: Path, arguments: tuple, text: str, message: str
) -> None:
    file.write_text(f"{file.read_text()}\n{SEVERAL}{text}\n")
    code, _, err = run(capsys, file, *arguments)
    assert code == 2
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
    assert "the first model cannot be simulated - got 'ball' without a robot, expected a models.WholeBody" in err
    assert "models of your own run in a program of your own, as examples/own_model_mpc.py does" in err


def test_names_of_a_file_are_checked(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "names.toml"
    for text, message in (
        ("[legs]\nFL = 'a'", "no table 'legs' is known - got it, expected [joints] and [feet]"),
        ("[joints]\nFL_hip_joint = 3", "table 'joints': is no mapping of names - got {'FL_hip_joint': 3}"),
        ("joints", "is no TOML file - got"),
        ("[joints]\nFL_hop_joint = 'a'", "no joint of the robot 'FL_hop_joint'"),
        ("[feet]\nLF = 'a'", "no foot of the robot 'LF'"),
    ):
        path.write_text(text)
        given = text if "LF" not in text else text + NAMES.read_text().partition("[feet]")[0]
        path.write_text(given)
        code, _, err = run(capsys, GO2, "--plant", OTHER, "--names", path)
        assert code == 2
        assert message in err


def test_a_file_says_what_a_fall_is(capsys: pytest.CaptureFixture[str], file: Path) -> None:
    with file.open("a") as more:
        more.write("\nfall = models.Fall(tilt=0.0, height=0.0)\n")
    code, out, _ = run(capsys, file, *SHORT, "--json")
    assert code == 1
    assert json.loads(out)["falls"] == 1


def test_a_fall_that_is_none_is_named(capsys: pytest.CaptureFixture[str], file: Path) -> None:
    with file.open("a") as more:
        more.write("\nfall = 0.5\n")
    code, _, err = run(capsys, file, *SHORT)
    assert code == 2
    assert "name 'fall': is not the definition of a fall - got float, expected models.Fall" in err
