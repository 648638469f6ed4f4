"""``piaffe export``: what it writes and refuses."""

import json
from pathlib import Path

import pytest

from piaffe.cli.app import main

TROT = Path(__file__).parents[2] / "examples" / "trot_mpc.py"


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of ``piaffe export``."""
    capsys.readouterr()
    code = main(["export", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, " ".join(said.err.split())


def test_a_folder_with_a_record_is_written(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ("--seconds", "0.1", "--max-age", "0.2", "--command", "vx=0.6@0", "--gains", "3:0.5", "--json")
    code, out, err = run(capsys, TROT, "-o", tmp_path / "c", *words)
    assert code == 0, err
    told = json.loads(out)
    assert (told["name"], told["plans"], told["ticks"]) == ("trot_mpc", 5, 50)
    assert (tmp_path / "c" / "check.bin").stat().st_size > 100_000
    assert "max_age = 0.2" in (tmp_path / "c" / "src" / "controller.c").read_text()
    assert json.loads((tmp_path / "c" / "manifest.json").read_text())["name"] == "trot_mpc"


@pytest.mark.slow
def test_check_builds_and_writes_what_it_finds(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = run(capsys, TROT, "-o", tmp_path, "--seconds", "0.1", "--check", "--json")
    assert code == 0, err
    told = json.loads(out)["check"]
    assert told["bitwise"]
    assert json.loads((tmp_path / "manifest.json").read_text())["measured"] == told


def test_a_name_and_a_latency_are_options(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, out, err = run(
        capsys, TROT, "-o", tmp_path, "--name", "walker", "--latency", "0.01", "--seconds", "0.06", "--no-spread"
    )
    assert code == 0, err
    assert "'walker', 3 plans and 25 ticks" in " ".join(out.split())
    assert (tmp_path / "include" / "walker.h").exists()
    assert "LATENCY = 0.01;" in (tmp_path / "src" / "controller.c").read_text()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--name", "My trot"), "the name is unusable - got 'My trot'"),
        (("--gains", "3"), "gains are unusable - got '3'"),
        (("--max-age", "-1"), "max_age is out of range - got -1"),
        (("--seconds", "0"), "seconds is out of range - got 0 s"),
    ],
)
def test_what_is_unusable_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...], says: str
) -> None:
    code, _, err = run(capsys, TROT, "-o", tmp_path / "c", *words)
    assert code == 2
    assert says in err
    assert not (tmp_path / "c").exists()


def test_a_folder_that_cannot_be_written_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "c").write_text("a file")
    code, _, err = run(capsys, TROT, "-o", tmp_path / "c", "--seconds", "0.1")
    assert code == 2
    assert "cannot be written" in err
