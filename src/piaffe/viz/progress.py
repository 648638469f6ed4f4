"""The live table of a solve: one line per iteration; the screen shows the last ones."""

from __future__ import annotations

from collections import deque
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.table import Table

from piaffe.solvers import Options, Record

_COLUMNS = (
    "iteration", "cost", "expected", "defect", "equality", "inequality", "step", "regularization", "barrier", "time",
)  # fmt: skip
_ON_SCREEN = 16


class LiveTable:
    """Shows each finished iteration; pass it as ``progress`` of a solve, inside a ``with`` block.

    On a terminal the table is redrawn in place; elsewhere (a log) every tenth iteration becomes a line.

    Args:
        options: options of the solver, for the tolerances.
        console: console for the table; by default standard output.
    """

    def __init__(self, options: Options | None = None, console: Console | None = None) -> None:
        self.options = options or Options()
        self.console = console or Console()
        self._rows: deque[Record] = deque(maxlen=_ON_SCREEN)
        self._live: Live | None = None
        self._printed = 0

    def __enter__(self) -> Self:
        if self.console.is_terminal:
            self._live = Live(self.table(), console=self.console, refresh_per_second=8)
            self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.update(self.table())
            self._live.__exit__(kind, error, traceback)
            self._live = None
        elif self._rows and self._rows[-1].iteration != self._printed:
            self.print_line(self._rows[-1])

    def __call__(self, record: Record) -> None:
        """Show one iteration."""
        self._rows.append(record)
        if self._live is not None:
            self._live.update(self.table())
        elif record.iteration == 1 or record.iteration % 10 == 0:
            self.print_line(record)

    def table(self) -> Table:
        """Return the table of the last iterations."""
        table = Table(box=None, pad_edge=False, header_style="bold")
        for name in _COLUMNS:
            table.add_column(name, justify="right", no_wrap=True)
        for record in self._rows:
            table.add_row(*self.cells(record))
        return table

    def cells(self, record: Record) -> tuple[str, ...]:
        """Return the cells of one line; values within tolerance are green."""
        o = self.options

        def met(value: float, tolerance: float) -> str:
            return f"[green]{value:.1e}[/]" if value <= tolerance else f"{value:.1e}"

        return (
            str(record.iteration), f"{record.cost:.5g}", f"{record.expected:.1e}", met(record.max_defect, o.max_defect),
            met(record.max_equality, o.max_equality), met(record.max_inequality, o.max_inequality),
            f"{record.step_size:.3g}", f"{record.regularization:.0e}", f"{record.barrier_weight:.0e}",
            f"{record.wall_s:.1f} s",
        )  # fmt: skip

    def print_line(self, record: Record) -> None:
        """Write an iteration as a line of a log."""
        if self._printed == 0:
            self.console.print("".join(f"{name:>15}" for name in _COLUMNS), style="bold", soft_wrap=True)
        plain = (cell.replace("[green]", "").replace("[/]", "") for cell in self.cells(record))
        self.console.print("".join(f"{cell:>15}" for cell in plain), soft_wrap=True, highlight=False)
        self._printed = record.iteration
