"""Who runs the episodes of a study: processes here by default, or a Dask cluster."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from pathlib import Path
from typing import Any

from piaffe.errors import SamplingError
from piaffe.simulation import Episode

from .declared import load_declared
from .study import Case
from .trials import Trial, located, prepare

DASK = "dask:"
_last: dict[
    tuple[object, ...], Trial
] = {}  # the last controller of this process: the seeds of a cell follow each other


@dataclass(frozen=True)
class FileTask:
    """Runs episodes of a problem's file.

    Args:
        spec: the file, and the problem's name.
        folder: what paths in settings are relative to.
        threads: of roll-outs.
    """

    spec: str
    folder: str
    threads: int

    def __call__(self, case: Case) -> tuple[Episode, Mapping[str, Any]]:
        """Return an episode and the controller's settings in numbers."""
        trial = self._trial(case)
        controller = trial.controller
        known = {
            "horizon": controller.steps, "samples": controller.options.samples, "dt_s": controller.dt,
            "temperature": controller.options.temperature, "threads": self.threads,
        }  # fmt: skip
        return trial.run(case.seed), known

    def _trial(self, case: Case) -> Trial:
        key = (self.spec, self.threads, case.cell)
        if key not in _last:
            while _last:
                _last.popitem()[1].close()
            settings = located(case.settings, Path(self.folder))
            _last[key] = prepare(load_declared(self.spec, quiet=True), settings, self.threads)
        return _last[key]


@contextmanager
def executor_of(kind: str, workers: int, threads: int) -> Iterator[Executor]:
    """Give an executor.

    Args:
        kind: ``"process"``, or ``"dask:ADDRESS"`` of a scheduler, whose workers must be processes of one thread: CasADi
            cannot build expressions in two threads at once.
        workers: how many, but for Dask, where the cluster decides.
        threads: of each worker's arithmetic.

    Raises:
        SamplingError: the kind is unknown, Dask is not installed or not reached, or its workers have several threads.
    """
    if kind == "process":
        with _environment(threads):
            pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_follow_parent)
            with pool:
                yield pool
    elif kind.startswith(DASK):
        with _dask(kind.removeprefix(DASK)) as client:
            yield client.get_executor()
    else:
        require_executor(kind)


def require_executor(kind: str) -> None:
    """Raise SamplingError unless a kind of executor is known."""
    if not (kind == "process" or kind.startswith(DASK)):
        raise SamplingError(
            f"study: executor is unknown - got '{kind}', expected 'process' or 'dask:ADDRESS'; choose one"
        )


def _dask(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise SamplingError(
            f"study: Dask is not here - got {error}, expected dask.distributed; pip install distributed, or use "
            "--executor process"
        ) from error
    try:
        client = Client(address)
    except (OSError, ValueError) as error:
        raise SamplingError(
            f"study: Dask's scheduler is not reached - got {error}, expected one at '{address}'; check the address"
        ) from error
    most = max(client.nthreads().values(), default=1)
    if most > 1:
        client.close()
        raise SamplingError(
            f"study: Dask's workers - got {most} threads in one, expected processes of one thread: CasADi cannot build "
            "expressions in two at once; start them by 'dask worker ADDRESS --nworkers auto --nthreads 1'"
        )
    return client


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    """Let processes that start meanwhile do their linear algebra on so many threads."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _follow_parent() -> None:
    """In a worker: leave Ctrl-C to the parent, and end when it is gone, however it ended."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
