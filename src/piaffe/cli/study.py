"""The command that runs a study: a grid of controllers, settings and seeds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from piaffe.errors import SamplingError

from .arguments import FAILED
from .reports import as_json, plain, print_cells, terminal

STALE = ("refuse", "keep", "redo")


def study(
    file: Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Controllers, settings and seeds to combine.")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the results; by default STUDY beside STUDY.toml.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Episodes at a time; one per core by default.")] = None,
    executor: Annotated[str, typer.Option(metavar="KIND", help="process, or dask:ADDRESS of a scheduler.")] = "process",
    stale: Annotated[
        str, typer.Option(help="Existing episodes of other code or another value: refuse, keep or redo.")
    ] = "refuse",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the study and its controllers, and stop.")] = False,
    tables: Annotated[
        bool, typer.Option("--tables", help="Run nothing; write tables and figures of the finished episodes.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")] = False,
) -> None:
    """Run a grid of controllers, settings and seeds, and write tables and figures.

    Every finished episode is saved; a later call runs only the missing ones. Exit code 1 if an episode fails.
    """
    from piaffe.codegen import available_cores
    from piaffe.files import check_destination
    from piaffe.sampling import (
        FileTask,
        Study,
        cells,
        executor_of,
        listed,
        read_study,
        require_executor,
        require_pyarrow,
        try_controllers,
        write_parquet,
        write_tables,
    )
    from piaffe.viz import draw_study, progress_bars

    from .study_mpc import MPC, MpcRunner

    require_pyarrow()
    if stale not in STALE:
        raise SamplingError(f"--stale: is unknown - got '{stale}', expected one of {list(STALE)}; choose one")
    require_executor(executor)
    declared = read_study(file, {MPC: MpcRunner()})
    folder = out or file.with_suffix("")
    whole = Study(declared.cases, folder)
    missing = whole.missing(stale)  # type: ignore[arg-type]  # checked above
    console = terminal(stderr=json)
    console.print(f"{len(declared.cases)} episodes, {len(missing)} of them to run; results in {folder}", soft_wrap=True)
    if dry_run:
        try_controllers(declared)
        raise typer.Exit(0)
    check_destination(folder / "episodes.parquet")
    cores = available_cores()
    count = workers or cores
    threads = max(1, cores // count)
    failures = {}
    if missing and not tables:
        with executor_of(executor, count, threads) as pool, progress_bars() as progress:
            bar = progress.add_task("episodes", total=len(missing))
            failures = whole.run(
                FileTask(declared.spec, str(file.parent), threads, declared.runners), pool, stale=stale,  # type: ignore[arg-type]  # checked above
                heard=lambda case, error: progress.advance(bar),
            )  # fmt: skip
    rows = whole.rows()
    saved = []
    if rows:
        saved = [write_parquet(folder / "episodes.parquet", rows), *write_tables(folder, rows)]
        saved += draw_study(folder, whole, declared, rows)
    for case, error in failures.items():
        terminal(stderr=True).print(
            f"[bold red]failed:[/] {case.label}, seed {case.seed}: {plain(str(error))}", soft_wrap=True
        )
    if json:
        print(as_json({
            "episodes": len(declared.cases), "done": len(rows), "failed": len(failures),
            "cells": cells(rows) if rows else [], "files": [str(path) for path in saved],
        }))  # fmt: skip
    else:
        if rows:
            print_cells(console, listed(rows))
        elif tables:
            print("no episode is done yet: there are no tables to write")
        for path in saved:
            print(f"saved {path}")
    raise typer.Exit(FAILED if failures else 0)
