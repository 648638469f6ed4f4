"""The live table and bars: redrawn on a terminal; in a log, every tenth line of the table and no bar."""

from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from piaffe.solvers import MSiLQR, Options
from piaffe.viz.bars import progress_bars, stage_bars
from piaffe.viz.films import Cut, write
from piaffe.viz.playback import Snapshot
from piaffe.viz.progress import LiveTable

from ..problems import swing_up


def test_log_gets_the_first_every_tenth_and_the_last_iteration() -> None:
    console = Console(file=StringIO(), width=80)
    with LiveTable(console=console) as table:
        MSiLQR(swing_up(), Options(max_iterations=23)).solve(progress=table)
    head, *lines = console.file.getvalue().splitlines()
    assert head.split()[:4] == ["iteration", "cost", "expected", "defect"]
    assert [line.split()[0] for line in lines] == ["1", "10", "20", "23"]
    assert "[green]" not in "".join(lines)


def test_terminal_shows_the_last_iterations() -> None:
    console = Console(file=StringIO(), width=160, force_terminal=True)
    with LiveTable(console=console) as table:
        MSiLQR(swing_up(), Options(max_iterations=30)).solve(progress=table)
    assert table.table().row_count == 16
    assert "regularization" in console.file.getvalue()


def test_table_is_left_when_the_solve_is_interrupted() -> None:
    console = Console(file=StringIO(), width=80)
    with pytest.raises(KeyboardInterrupt), LiveTable(console=console):
        raise KeyboardInterrupt
    assert console.file.getvalue() == ""


def test_what_is_within_tolerance_is_green() -> None:
    solution = MSiLQR(swing_up(), Options(max_iterations=1)).solve()
    defect, equality = LiveTable().cells(solution.history[-1])[3:5]
    assert not defect.startswith("[green]")
    assert equality.startswith("[green]")


def test_each_stage_has_a_bar_on_a_terminal_and_none_in_a_log() -> None:
    terminal, log = Console(file=StringIO(), width=100, force_terminal=True), Console(file=StringIO(), width=100)
    for console in (terminal, log):
        with stage_bars(console) as show:
            for stage, total in (("collecting", 2), ("learning", 30)):
                for done in range(total + 1):
                    show(stage, done, total)
    shown = terminal.file.getvalue()
    assert "collecting" in shown
    assert "2/2" in shown
    assert "30/30" in shown
    assert log.file.getvalue().strip() == ""


class FakeStudio:
    """A camera without a renderer."""

    size = (64, 48)
    fixed = np.zeros(3)

    def __enter__(self):
        return self

    def __exit__(self, *of: object) -> None:
        pass

    def picture(self, snapshot: object, look_at: object) -> np.ndarray:
        return np.zeros((48, 64, 3), np.uint8)


def test_a_film_shows_its_pictures_on_a_terminal(tmp_path, monkeypatch) -> None:
    console = Console(file=StringIO(), width=80, force_terminal=True)
    monkeypatch.setattr("piaffe.viz.films.progress_bars", lambda: progress_bars(console))
    snapshot = Snapshot(0.0, np.zeros(7), np.zeros((0, 3)), "robot", ())
    path = write(tmp_path / "film.mp4", FakeStudio(), [Cut(lambda t: snapshot, 0.0, 0.5)], [])
    assert path.stat().st_size > 0
    assert "film, pictures" in console.file.getvalue()
    assert "46/46" in console.file.getvalue()
