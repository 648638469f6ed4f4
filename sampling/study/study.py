"""Studies: episodes over a grid of settings. Each episode is saved when it ends, so a study can be continued."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from dataclasses import dataclass, field
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any, Literal

from piaffe.errors import SamplingError
from piaffe.files import write_whole
from piaffe.html import html_table
from piaffe.interrupts import deferred
from piaffe.simulation import Episode

from .records import load_episodes, save_episodes

Stale = Literal["refuse", "keep", "redo"]

_ONLY = "episode"


@dataclass(frozen=True, eq=False)
class Case:
    """One episode of a study.

    Args:
        label: its name in tables and figures; it has no effect on the episode.
        settings: settings of the episode, in values that JSON can hold.
        seed: seed of the episode.
        made_from: digests of the files that the settings refer to, by name.
    """

    label: str
    settings: Mapping[str, Any]
    seed: int
    made_from: Mapping[str, str] = field(default_factory=dict)

    @property
    def cell(self) -> str:
        """Name of the settings, the same for all seeds."""
        return hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).hexdigest()[:16]


Result = Episode | Mapping[str, Any]
"""An episode, or only the figures of one that a :class:`Runner` ran, in values that JSON can hold."""

Task = Callable[[Case], tuple[Result, Mapping[str, Any]]]
"""Runs an episode, and returns it and more results in values that JSON can hold. It must be possible to pickle it."""

Heard = Callable[[Case, BaseException | None], None]
"""Called with each case when it ends, and with its error or None."""


def grid(blocks: Iterable[Mapping[str, Any]], defaults: Mapping[str, Any] | None = None) -> list[dict[str, Any]]:
    """Return the settings of every combination: each block gives all combinations of the entries of its lists.

    Args:
        blocks: values, or lists of values, by name; repeated combinations are left out.
        defaults: values for all blocks; the values of a block replace them.
    """
    found: dict[str, dict[str, Any]] = {}
    for block in blocks:
        own = {**{name: value for name, value in (defaults or {}).items() if name not in block}, **block}
        for values in product(*(value if isinstance(value, list) else [value] for value in own.values())):
            settings = dict(zip(own, values, strict=True))
            found.setdefault(json.dumps(settings, sort_keys=True), settings)
    return list(found.values())


class Study:
    """Episodes in a folder: ``episodes/CELL/seed-N.npz``.

    Args:
        cases: the episodes.
        folder: folder where they are saved.
    """

    def __init__(self, cases: Sequence[Case], folder: str | Path) -> None:
        self.cases, self.folder = tuple(cases), Path(folder)

    def __repr__(self) -> str:
        done = sum(self.path(case).exists() for case in self.cases)
        cells = len(dict.fromkeys(case.cell for case in self.cases))
        return f"Study({cells} cells, {len(self.cases)} episodes, {done} of them finished; '{self.folder}')"

    def _repr_html_(self) -> str:
        found = {cell: [c for c in self.cases if c.cell == cell] for cell in dict.fromkeys(c.cell for c in self.cases)}
        rows = [(cell, len(cases), sum(self.path(case).exists() for case in cases)) for cell, cases in found.items()]
        return html_table(repr(self), ("cell", "episodes", "finished"), rows)

    def path(self, case: Case) -> Path:
        """Return the path of an episode's file."""
        return self.folder / "episodes" / case.cell / f"seed-{case.seed}.npz"

    def missing(self, stale: Stale = "refuse") -> list[Case]:
        """Return the cases to run.

        Args:
            stale: what to do with saved episodes whose files (``made_from``) have changed since: ``"keep"`` the
                episodes, ``"redo"`` them, or ``"refuse"``, which raises an error.

        Raises:
            SamplingError: there are such episodes, and ``stale`` is ``"refuse"``.
            FileFormatError: a file in the folder is of another kind.
        """
        found, old = [], []
        for case in self.cases:
            if not self.path(case).is_file():
                found.append(case)
            elif load_episodes(self.path(case))[1].get("made_from") != dict(case.made_from):
                old.append(case)
        if old and stale == "refuse":
            raise SamplingError(
                f"study '{self.folder}': files of its episodes have changed - got {len(old)} of "
                f"{len(self.cases)} from other contents of {' or '.join(old[0].made_from)}, expected those of now; "
                "keep them (--stale keep) if the change does not matter, or redo them (--stale redo)"
            )
        return [case for case in self.cases if case in found or case in old] if stale == "redo" else found

    def run(
        self, task: Task, executor: Executor, *, stale: Stale = "refuse", heard: Heard | None = None
    ) -> dict[Case, BaseException]:
        """Run the missing episodes, and return the failed cases and their errors. Each episode is saved when it ends.

        On ``KeyboardInterrupt``, the episodes that are running are completed and saved before it is raised again.

        Args:
            task: function that runs one episode.
            executor: an executor of ``concurrent.futures``, or one with the same methods.
            stale: as for :meth:`missing`.
            heard: called after each episode.

        Raises:
            SamplingError: a worker died.
        """
        failures: dict[Case, BaseException] = {}
        waiting: dict[Future[Any], Case] = {}
        left: set[Future[Any]] = set()
        missing = self.missing(stale)

        def collect(futures: Iterable[Future[Any]]) -> None:
            for future in as_completed(futures):
                left.discard(future)
                if future.cancelled():
                    continue
                error = future.exception()
                if isinstance(error, BrokenExecutor):
                    raise SamplingError(
                        f"study '{self.folder}': a worker died - got {error}, expected it to run; check whether "
                        "memory was full, and run the study again with fewer workers: completed episodes are saved"
                    ) from error
                if error is None:
                    self._save(waiting[future], *future.result())
                else:
                    failures[waiting[future]] = error
                if heard is not None:
                    heard(waiting[future], error)

        try:
            with deferred():  # a worker that starts must be known to the executor, which waits for it at the end
                waiting |= {executor.submit(task, case): case for case in missing}
                left |= set(waiting)
            collect(waiting)
        except KeyboardInterrupt:
            for future in left:
                future.cancel()
            collect(set(left))
            raise
        return failures

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per completed episode: label, seed, settings and results."""
        return [self._row(case) for case in self.cases if self.path(case).is_file()]

    def episode(self, case: Case) -> Episode:
        """Return a completed episode; KeyError if only its figures were kept, see :meth:`kept`."""
        return load_episodes(self.path(case))[0][_ONLY]

    def kept(self, case: Case) -> bool:
        """Return whether there is a completed episode with its states, and not only with its figures."""
        return self.path(case).is_file() and _ONLY in load_episodes(self.path(case))[0]

    def _save(self, case: Case, result: Result, known: Mapping[str, Any]) -> None:
        about = {
            "label": case.label, "settings": dict(case.settings), "seed": case.seed,
            "made_from": dict(case.made_from), "known": dict(known),
        }  # fmt: skip
        if isinstance(result, Episode):
            save_episodes(self.path(case), {_ONLY: result}, about)
        else:
            save_episodes(self.path(case), {}, {**about, "figures": dict(result)})

    def _row(self, case: Case) -> dict[str, Any]:
        episodes, about = load_episodes(self.path(case))
        row = {"label": case.label, "cell": case.cell, "seed": case.seed, **case.settings, **about["known"]}
        if _ONLY in episodes:
            figures = episodes[_ONLY].summary()
            figures["steps_done"] = figures.pop("steps")
        else:
            figures = about["figures"]
        for key, value in figures.items():
            if isinstance(value, dict):
                row |= {f"{key}.{name}": entry for name, entry in value.items()}
            else:
                row[key] = value
        return row | {f"{name}_digest": digest for name, digest in about["made_from"].items()}


def write_parquet(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Write rows as a Parquet file, in one atomic step; columns of mixed types become JSON.

    Args:
        path: the file.
        rows: one per episode; missing values become null.

    Raises:
        SamplingError: pyarrow is not installed.
    """
    pyarrow, parquet = require_pyarrow()
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    text = pyarrow.string()
    table = pyarrow.table({
        name: pyarrow.array(column, None if any(value is not None for value in column) else text)
        for name, column in columns.items()
    })  # fmt: skip
    content = BytesIO()
    parquet.write_table(table, content)
    write_whole(Path(path), content.getvalue())
    return Path(path)


def require_pyarrow() -> tuple[Any, Any]:
    """Return pyarrow and its module for Parquet.

    Raises:
        SamplingError: it is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise SamplingError(
            f"study: a table of episodes is a Parquet file - got {error}, expected pyarrow; pip install "
            "'piaffe[sampling]'"
        ) from error
    return pyarrow, parquet


def _column(values: Sequence[Any]) -> list[Any]:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and len(kinds) > 1:
        return [None if value is None else float(value) for value in values]
    plain = len(kinds) <= 1 and kinds <= {bool, int, float, str}
    return list(values) if plain else [None if value is None else json.dumps(value) for value in values]
