"""``piaffe study``: what it reads, refuses, runs in processes, and writes."""

import csv
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from piaffe.cli.app import main
from piaffe.cli.study_mpc import MpcRunner
from piaffe.errors import PiaffeError
from piaffe.sampling.study.file import content_digest, read_study, source_digest
from piaffe.sampling.study.tables import cells, varied, write_table
from piaffe.viz.study_figures import curves
from piaffe.viz.study_outcomes import outcomes

pytest.importorskip("pyarrow")

STUDY = """
file = "sampled.py"
seeds = 2
steps = 2
samples = 8
series = {HAA = 0.2, height = 0.1}

[[grid]]
label = "annealed"
controller = "dial"
first_stages = 1
horizon = [3, 4]

[[grid]]
controller = "mppi"
horizon = [3, 4]
"""


@pytest.fixture
def study_file(sampled_file: Path, tmp_path: Path) -> Path:
    (tmp_path / "sampled.py").write_text(sampled_file.read_text())
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return path


# ---- reading


def test_blocks_become_cases_with_all_settings(study_file: Path) -> None:
    study = read_study(study_file)
    told = [(case.label, case.settings["horizon"], case.seed) for case in study.cases]
    assert told == [(label, h, seed) for label in ("annealed", "MPPI") for h in (3, 4) for seed in (0, 1)]
    assert {case.settings["samples"] for case in study.cases} == {8}
    assert study.cases[0].settings["ground"] == "flat"
    assert study.series == {"HAA": 0.2, "height": 0.1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("file = ", "is no TOML file - got"),
        ("seeds = 3", "has no problem - got file = None, expected the path of a Python file"),
        ('file = "nowhere.py"', "nowhere.py': does not exist - got no file"),
        ('file = "sampled.py"\ncontroler = "dial"', "no setting 'controler'"),
        ('file = "sampled.py"\ncontroller = ["dial", "dail"]', "no controller 'dail'"),
        ('file = "sampled.py"\nseeds = 0', "seeds are unusable - got 0"),
        ('file = "sampled.py"\nseeds = [1, -1]', "seeds are unusable - got [1, -1]"),
        ('file = "sampled.py"\nvalue = "v.value"', "v.value' is not there - got no file"),
        ('file = "sampled.py"\nground = ["flat", "icy"]', "got ValueError: no ground 'icy'"),
        ('file = "sampled.py"\nplant_timestep = 0.003', "timestep does not divide the schedule's step - got 0.003 s"),
        ('file = "sampled.py"\nknots = 1', "knots is out of range - got 1"),
        ('file = "sampled.py"\nseries = 3', "series is unusable - got 3"),
        ('file = "sampled.py"\nseries = {knee = 1.0}', "series: no joint 'knee' - got 'knee', expected one of ['he"),
        ('file = "sampled.py"\nhorizon = []', "has no episodes - got an empty list"),
        ('file = "sampled.py"\ngrid = 3', "grid is unusable - got 3, expected tables"),
    ],
)
def test_what_is_wrong_is_found_before_anything_runs(study_file: Path, text: str, message: str) -> None:
    study_file.write_text(text)
    with pytest.raises(PiaffeError) as error:
        read_study(study_file)
    assert message in str(error.value)


def test_a_dry_run_makes_every_controller(capsys: pytest.CaptureFixture[str], study_file: Path) -> None:
    study_file.write_text('file = "sampled.py"\ncontroller = "td-cd"\np_max = { hips = 0.1 }\nhorizon = 3')
    assert main(["study", str(study_file), "--dry-run"]) == 2
    assert "sampling options, p_max: no constraint 'hips'" in " ".join(capsys.readouterr().err.split())
    assert main(["study", str(study_file), "--workers", "1", "--executor", "process"]) == 1  # the pool lives on
    assert "seed 0: sampling options, p_max: no constraint 'hips'" in " ".join(capsys.readouterr().err.split())
    assert main(["study", str(study_file), "--tables"]) == 0
    assert "no episode is done yet" in capsys.readouterr().out
    assert main(["study", str(study_file.with_name("none.toml"))]) == 2
    assert "cannot be read - got No such file" in " ".join(capsys.readouterr().err.split())


def test_comments_and_layout_are_no_other_code(study_file: Path) -> None:
    file = study_file.with_name("sampled.py")
    before = source_digest(file)
    file.write_text("# said before\n" + file.read_text().replace("trot(0.3)", "trot( 0.3 )"))
    assert source_digest(file) == before
    file.write_text(file.read_text().replace("trot( 0.3 )", "trot(0.31)"))
    assert source_digest(file) != before


def test_a_value_is_its_content(study_file: Path) -> None:
    folder = study_file.with_name("v.value")
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "weights").write_text("1")
    first = content_digest(folder)
    study_file.write_text('file = "sampled.py"\nvalue = "v.value"')
    case = read_study(study_file).cases[0]
    assert (case.settings["value"], case.made_from["value"]) == ("v.value", first)
    (folder / "deep" / "weights").write_text("2")
    assert content_digest(folder) != first
    assert read_study(study_file).cases[0].cell == case.cell


# ---- running


@pytest.mark.slow
def test_a_study_runs_in_processes_and_continues(
    capsys: pytest.CaptureFixture[str], study_file: Path, tmp_path: Path
) -> None:
    assert main(["study", str(study_file), "--workers", "2", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["episodes"], values["done"], values["failed"]) == (8, 8, 0)
    assert [(cell["label"], cell["horizon"], cell["seeds"]) for cell in values["cells"]] == [
        ("annealed", 3, 2), ("annealed", 4, 2), ("MPPI", 3, 2), ("MPPI", 4, 2),
    ]  # fmt: skip
    folder = tmp_path / "small"
    written = {path.name for path in folder.iterdir()}
    assert written == {
        "cells.csv", "cells.md", "episodes", "episodes.parquet", "series.png", "success.csv", "success.md", "sweep.png",
        "violation.csv", "violation.md",
    }  # fmt: skip
    with (folder / "success.csv").open() as file:
        assert next(csv.reader(file)) == ["method", "H = 3", "H = 4"]
    gone = next((folder / "episodes").rglob("seed-1.npz"))
    gone.unlink()
    assert main(["study", str(study_file), "--dry-run"]) == 0
    assert "8 episodes, 1 of them to run" in " ".join(capsys.readouterr().out.split())
    (folder / "cells.md").unlink()
    assert main(["study", str(study_file), "--tables", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["done"] == 7
    assert (folder / "cells.md").exists()
    assert not gone.exists()


def test_an_unknown_executor_or_rule_is_refused(capsys: pytest.CaptureFixture[str], study_file: Path) -> None:
    assert main(["study", str(study_file), "--executor", "threads"]) == 2
    assert "executor is unknown - got 'threads', expected 'process' or" in " ".join(capsys.readouterr().err.split())
    assert main(["study", str(study_file), "--stale", "drop"]) == 2
    assert "--stale: is unknown - got 'drop'" in capsys.readouterr().err


def test_dask_workers_of_several_threads_are_refused(
    capsys: pytest.CaptureFixture[str], study_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Client:
        def __init__(self, address: str) -> None:
            if address != "tcp://here:1":
                raise ValueError(f"no scheme in {address}")

        def nthreads(self) -> dict[str, int]:
            return {"tcp://here:2": 1, "tcp://here:3": 4}

        def close(self) -> None:
            pass

    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client=Client))
    for address, message in (
        ("tcp://here:1", "Dask's workers have several threads - got 4 in one, expected processes with one thread"),
        ("there", "Dask's scheduler cannot be reached - got no scheme in there, expected one at 'there'"),
    ):
        assert main(["study", str(study_file), "--executor", f"dask:{address}"]) == 2
        assert message in " ".join(capsys.readouterr().err.split())


# ---- a receding horizon

ONLINE = """
cone = ocp.Constraints(models.friction_cone(0.6))
problem = ocp.Problem(models.gaits.trot(0.3), body.over(0.1, dt=0.01), objective, cone, initial=start)
"""

MIXED = """
file = "sampled.py"
seeds = 2

[[grid]]
controller = "mpc"
seconds = 0.1
low = ["vwbc", "pd"]

[[grid]]
controller = "mppi"
steps = 2
samples = 8
horizon = 3
"""


@pytest.fixture
def mixed_file(study_file: Path) -> Path:
    file = study_file.with_name("sampled.py")
    file.write_text(file.read_text() + ONLINE)
    study_file.write_text(MIXED)
    return study_file


def test_cells_of_a_receding_horizon_run_beside_sampling_controllers(
    capsys: pytest.CaptureFixture[str], mixed_file: Path
) -> None:
    assert main(["study", str(mixed_file), "--workers", "1", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert (values["episodes"], values["done"], values["failed"]) == (6, 6, 0)
    assert [(cell["label"], cell.get("low"), cell["seeds"]) for cell in values["cells"]] == [
        ("MPC", "vwbc", 2), ("MPC", "pd", 2), ("MPPI", None, 2)
    ]  # fmt: skip
    first, _, last = values["cells"]
    assert first["mean_reward"] is None
    assert first["missed_percent_worst"] is None
    assert first["plan_ms_median"] > 0
    assert first["tick_us_median"] > 0
    assert last["mean_reward"] > 0
    assert last["tick_us_median"] is None
    folder = mixed_file.with_suffix("")
    with (folder / "cells.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["mean step reward"] == "" for line in lines] == [True, True, False]
    assert (
        main(["mpc", f"{mixed_file.with_name('sampled.py')}:problem", "--seconds", "0.1", "--seed", "1", "--json"]) == 0
    )
    alone = json.loads(capsys.readouterr().out)["episodes"][0]
    from pyarrow import parquet

    rows = parquet.read_table(folder / "episodes.parquet").to_pylist()
    row = next(row for row in rows if row["low"] == "vwbc" and row["seed"] == 1)
    for name in ("success", "fell", "end_s", "rms_velocity_error_m_per_s", "qp_iterations_mean", "iterations_mean"):
        assert row[name] == alone[name], name
    assert main(["study", str(mixed_file), "--dry-run"]) == 0
    assert "6 episodes, 0 of them to run" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lows = 'pd'", "no setting of 'mpc' 'lows'"),
        ("samples = 8", "no setting of 'mpc' 'samples'"),
        ("low = 'lqr'", "no low level 'lqr'"),
        ("spread = 3", "spread is unusable - got 3, expected a bool"),
        ("seconds = 'ten'", "seconds is unusable - got 'ten', expected a number"),
        ("friction = '0.8:0.5'", "variation: friction is out of range"),
        ("plant = 'absent.xml'", "there is no file of plant - got 'absent.xml', expected a path relative to the study"),
        ("series = { height = 0.1 }", "series is unusable - got {'height': 0.1} and only controllers whose states"),
        ("push = '1@y'", "push: text is unusable - got '1@y'"),
        ("command = 'hop=1'", "no command 'hop'"),
    ],
)
def test_bad_settings_of_a_receding_horizon_are_found_by_a_dry_run(
    capsys: pytest.CaptureFixture[str], mixed_file: Path, text: str, message: str
) -> None:
    mixed_file.write_text(f'file = "sampled.py"\ncontroller = "mpc"\n{text}\n')
    assert main(["study", str(mixed_file), "--dry-run"]) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_a_study_notices_that_the_plants_file_changed(mixed_file: Path) -> None:
    plant = mixed_file.with_name("plant.xml")
    plant.write_text("<mujoco/>")
    mixed_file.write_text('file = "sampled.py"\ncontroller = "mpc"\nplant = "plant.xml"\nfriction = "0.4:0.6"\n')
    before = read_study(mixed_file, {"mpc": MpcRunner()}).cases[0]
    assert before.settings["plant"] == "plant.xml"
    assert before.settings["friction"] == "0.4:0.6"
    plant.write_text("<mujoco> </mujoco>")
    after = read_study(mixed_file, {"mpc": MpcRunner()}).cases[0]
    assert after.cell == before.cell
    assert after.made_from["file"] == before.made_from["file"]
    assert after.made_from["plant"] != before.made_from["plant"]


# ---- tables and curves


def row(label: str, seed: int, **given: object) -> dict[str, object]:
    return {
        "label": label, "cell": f"{label}{given}", "seed": seed, "controller": label, "horizon": 8, "samples": 512,
        "terrain": "flat", **given, "dt_s": 0.02, "threads": 1, "success": seed < 3, "fell": seed >= 3,
        "mean_reward": 0.5 + 0.1 * seed, "speed_error_m_per_s": 0.1, "plan_ms_median": 9.0,
        "effective_samples_median": 5.0, "missed_percent.hip": float(seed), "missed_percent.height": 0.5,
    }  # fmt: skip


def test_a_cell_is_the_mean_of_its_seeds() -> None:
    found = cells([row("a", seed) for seed in range(4)])
    assert len(found) == 1
    assert found[0] | {"success_percent": 75.0, "falls": 1, "seeds": 4, "missed_percent.hip": 1.5} == found[0]
    assert found[0]["mean_reward"] == pytest.approx(0.65)
    assert found[0]["reward_error"] == pytest.approx(0.1290994 / 2, rel=1e-6)
    assert found[0]["missed_percent_worst"] == 1.5


def test_settings_that_the_label_tells_are_not_said_twice() -> None:
    rows = [row("a", 0), row("b", 0), row("b", 0, samples=1024)]
    assert varied(rows) == ["samples"]


def test_curves_join_what_differs_in_one_setting() -> None:
    rows = [row("a", 0, horizon=h) for h in (8, 4)] + [row("a", 0, samples=64), row("b", 0, horizon=16)]
    found = cells(rows)
    assert {name: [cell["horizon"] for cell in group] for name, group in curves(found, "horizon").items()} == {
        "a, N = 512": [4, 8]
    }
    assert {name: [cell["samples"] for cell in group] for name, group in curves(found, "samples").items()} == {
        "a, H = 8": [64, 512]
    }


def test_the_figure_of_outcomes_has_a_bar_for_each_cell() -> None:
    rows = [
        {"label": label, "cell": f"{label}{push}", "seed": seed, "controller": "mpc", "low": label, "push": push,
         "dt_s": 0.01, "success": seed < 3 or not push, "fell": seed == 3, "tick_us_median": 20.0,
         "speed_error": 0.01 * (1 + seed)}
        for label in ("a", "b") for push in ("", "1@3:y") for seed in range(4)
    ]  # fmt: skip
    found = cells(rows)
    assert [cell["speed_error_percent"] for cell in found] == [pytest.approx(2.0)] * 4  # a fall does not count
    assert [cell["speed_error_percent_worst"] for cell in found] == [pytest.approx(3.0)] * 4
    figure = outcomes(found)
    assert figure is not None
    success, speed = figure.axes
    assert sorted(round(bar.get_height()) for bar in success.patches) == [75, 75, 100, 100]
    assert [round(bar.get_height(), 3) for bar in speed.patches] == [2.0] * 4
    assert [tick.get_text() for tick in speed.get_xticklabels()] == ["push none", "push 1@3:y"]
    assert outcomes([row("a", 0)]) is None


def test_a_table_is_written_for_people_and_for_programs(tmp_path: Path) -> None:
    paths = write_table(tmp_path / "t", [{"method": "a", "x": "1"}, {"method": "b", "y": "2, 3"}])
    assert paths[0].read_text() == "| method | x | y |\n| --- | --- | --- |\n| a | 1 |  |\n| b |  | 2, 3 |\n"
    assert paths[1].read_text() == 'method,x,y\na,1,\nb,,"2, 3"\n'
