"""Files that cannot be written: told before work begins; later, the content is kept. What kills leave is removed."""

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import piaffe
from piaffe.cli.app import main
from piaffe.errors import FileWriteError
from piaffe.files import check_destination, whole_file, write_whole
from piaffe.viz.figure import save_figure

OUTPUTS = {
    "solve": ["solve", "{file}", "--save", "{to}.npz"],
    "plot": ["plot", "{file}", "-o", "{to}.png"],
    "video": ["video", "{file}", "-o", "{to}.mp4"],
    "mppi": ["mppi", "{file}", "--save", "{to}.npz"],
    "mppi film": ["mppi", "{file}", "--video", "{to}.mp4"],
    "mpc": ["mpc", "{file}", "--plot", "{to}.png"],
    "export": ["export", "{file}", "-o", "{to}"],
}


DISK = "256k"  # size of `mounted`


def refused(command: str, to: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return what a command says of a destination; its input is no problem, so it has not begun its work."""
    file = tmp_path / "input.npz"
    file.write_bytes(b"")
    words = [word.format(file=file, to=to) for word in OUTPUTS[command]]
    assert main(words) == 2
    shown = capsys.readouterr()
    assert not shown.out
    return shown.err


@pytest.mark.parametrize("command", OUTPUTS)
def test_a_destination_below_a_file_is_refused_before_work_begins(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "taken").write_text("a file")
    told = refused(command, tmp_path / "taken" / "result", tmp_path, capsys)
    assert re.search(r"error: file '.*taken/result.*': cannot be written - got (File exists|Not a directory)", told)
    assert (tmp_path / "taken").read_text() == "a file"


@pytest.mark.parametrize("command", OUTPUTS)
def test_a_full_or_read_only_disk_is_told_before_work_begins(
    command: str, mounted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (mounted / "ballast").write_bytes(bytes(240_000))
    told = refused(command, mounted / "result", tmp_path, capsys)
    assert re.search(r"error: file '.*mounted/result.*': cannot be written - got No space left on device", told)
    assert [path.name for path in mounted.iterdir() if path.is_file()] == ["ballast"]
    subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
    told = refused(command, mounted / "result2", tmp_path, capsys)
    assert re.search(r"error: file '.*mounted/result2.*': cannot be written - got Read-only file system", told)


def test_a_folder_is_no_destination_and_a_missing_one_is_made_by_who_writes(tmp_path: Path) -> None:
    with pytest.raises(FileWriteError, match=r"cannot be written - got a folder, expected a file"):
        check_destination(tmp_path)
    (tmp_path / "there").mkdir()
    for path in (tmp_path / "a" / "b" / "c.npz", tmp_path / "there" / "b.npz"):
        check_destination(path)
        assert list(tmp_path.iterdir()) == [tmp_path / "there"]
        write_whole(path, b"content")
        assert path.read_bytes() == b"content"
        shutil.rmtree(tmp_path / "a", ignore_errors=True)


def test_what_a_full_disk_refuses_is_kept_elsewhere(mounted: Path, tmp_path: Path) -> None:
    path = mounted / "result.npz"
    write_whole(path, b"old")
    check_destination(path)
    content = os.urandom(300_000)
    with pytest.raises(FileWriteError, match=r"result.npz': cannot be written - got No space left on device") as caught:
        write_whole(path, content)
    kept = Path(str(caught.value).split("move '")[1].split("'")[0])
    try:
        assert kept.suffix == ".npz"
        assert kept.read_bytes() == content
        assert kept.stat().st_mode & 0o077 == 0
    finally:
        kept.unlink()
    assert path.read_bytes() == b"old"
    assert [each.name for each in mounted.iterdir()] == ["result.npz"]


def test_a_figure_that_a_full_disk_refuses_is_kept_elsewhere(mounted: Path) -> None:
    (mounted / "ballast").write_bytes(bytes(250_000))
    figure = Figure()
    figure.subplots().imshow([[1.0, 2.0]])
    with pytest.raises(
        FileWriteError, match=r"figure.png': cannot be written - got No space.*holds the content"
    ) as caught:
        save_figure(figure, mounted / "figure.png")
    kept = Path(str(caught.value).split("move '")[1].split("'")[0])
    assert kept.read_bytes().startswith(b"\x89PNG")
    kept.unlink()


def test_an_error_within_a_film_names_the_file(mounted: Path) -> None:
    with (
        pytest.raises(FileWriteError, match=r"file '.*film.mp4': cannot be written - got No space left on device"),
        whole_file(mounted / "film.mp4") as temporary,
    ):
        temporary.write_bytes(bytes(400_000))
    assert list(mounted.iterdir()) == []


def test_no_place_at_all_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "taken").write_text("a file")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(FileWriteError, match="the content is lost: nothing else can be written"):
        write_whole(tmp_path / "taken" / "a.npz", b"content")


# ---- kills

KILLED = """
import json, os, signal, sys, time
from pathlib import Path
import random
from piaffe.files import write_whole
path, found, left = Path(sys.argv[1]), [], []
random.seed(0)
began = time.monotonic()
for k in range(3):
    write_whole(path, bytes(2_000_000))
usual = (time.monotonic() - began) / 3  # [s]
for k in range(40):
    child = os.fork()
    if child == 0:
        while True:
            write_whole(path, bytes([k]) * 2_000_000)
    time.sleep(random.uniform(0.5, 3.0) * usual)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if path.exists():
        content = path.read_bytes()
        found.append([len(content), len(set(content))])
    left.append(len(list(path.parent.iterdir())))
print(json.dumps([found, left]))
"""


def test_a_killed_writer_leaves_a_whole_file_and_its_rest_goes_with_the_next(tmp_path: Path) -> None:
    path = tmp_path / "results" / "big.npz"
    environment = {**os.environ, "PYTHONPATH": str(Path(piaffe.__file__).parent.parent)}
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(path)], capture_output=True, text=True, check=True, env=environment
    )
    found, left = json.loads(done.stdout)
    assert len(found) > 20
    assert all(each == [2_000_000, 1] for each in found)
    assert 1 < max(left) <= 3  # some kills left a file; it was gone after the next write
    write_whole(path, b"last")
    assert list(path.parent.iterdir()) == [path]


def test_files_of_others_stay_for_a_day(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    running = tmp_path / f".a.{'0' * 8}-1-{'0' * 16}.tmp.npz"  # of another host
    alike = tmp_path / ".b.tmp.npz"
    old = tmp_path / f".a.{'0' * 8}-1-{'1' * 16}.tmp.npz"
    for each in (running, alike, old):
        each.write_bytes(b"")
    os.utime(old, (time.time() - 90_000,) * 2)
    write_whole(path, b"content")
    assert set(tmp_path.iterdir()) == {path, running, alike}
