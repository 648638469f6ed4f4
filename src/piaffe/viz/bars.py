"""Progress bars on standard error, for work that takes minutes: episodes, studies, and learning."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

StageProgress = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of its finished steps, and the number of all its steps."""


@contextmanager
def progress_bars(console: Console | None = None) -> Iterator[Progress]:
    """Show progress bars if standard error is a terminal; they are removed at the end.

    Args:
        console: where to show them; standard error by default.
    """
    console = console or Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        yield progress


@contextmanager
def stage_bars(console: Console | None = None) -> Iterator[StageProgress]:
    """Show a bar for each stage; yield the function to pass as ``progress``, for example to ``sampling.train_value``.

    Args:
        console: where to show them; standard error by default.
    """
    with progress_bars(console) as progress:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = progress.add_task(stage, total=total)
            progress.update(tasks[stage], completed=done, total=total)

        yield show
