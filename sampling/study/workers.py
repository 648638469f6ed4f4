"""The executors that run the episodes of a study: processes on this machine by default, or a Dask cluster."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import connection, parent_process, resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any

from piaffe.errors import SamplingError

from .declared import load_declared
from .runner import Runner
from .study import Case, Result
from .trials import Trial, located, prepare

DASK = "dask:"
_last: dict[
    tuple[object, ...], Trial
] = {}  # the last controller of this process, which is used for all seeds of a cell


@dataclass(frozen=True)
class FileTask:
    """Runs episodes of a problem's file.

    Args:
        spec: the file, and the problem's name.
        folder: folder that paths in settings are relative to.
        threads: number of threads of roll-outs.
        runners: controllers that sampling does not know, by name.
    """

    spec: str
    folder: str
    threads: int
    runners: Mapping[str, Runner] = field(default_factory=dict)

    def __call__(self, case: Case) -> tuple[Result, Mapping[str, Any]]:
        """Return an episode, or its figures, and the numbers of the controller's settings."""
        runner = self.runners.get(case.settings["controller"])
        if runner is not None:
            return runner.run(self.spec, case.settings, case.seed, Path(self.folder))
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
    """Return a context that yields an executor.

    Args:
        kind: ``"process"``, or ``"dask:ADDRESS"`` with the address of a scheduler. Workers of Dask must be processes
            with one thread: CasADi cannot build expressions in two threads at once.
        workers: number of processes; not used for Dask.
        threads: number of threads of linear algebra in each worker.

    Raises:
        SamplingError: the kind is unknown, Dask is not installed or cannot be reached, or its workers have several
            threads.
    """
    if kind == "process":
        with _environment(threads):
            resource_tracker.ensure_running()  # it unblocks Ctrl-C when it starts
            pool = ProcessPoolExecutor(workers, mp_context=_Context(), initializer=_follow_parent)
            with pool:
                yield pool
    elif kind.startswith(DASK):
        with _dask(kind.removeprefix(DASK)) as client:
            yield client.get_executor()
    else:
        require_executor(kind)


def require_executor(kind: str) -> None:
    """Raise SamplingError if a kind of executor is unknown."""
    if not (kind == "process" or kind.startswith(DASK)):
        raise SamplingError(
            f"study: executor is unknown - got '{kind}', expected 'process' or 'dask:ADDRESS'; choose one"
        )


def _dask(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise SamplingError(
            f"study: Dask cannot be imported - got {error}, expected dask.distributed; pip install distributed, or use "
            "--executor process"
        ) from error
    try:
        client = Client(address)
    except (OSError, ValueError) as error:
        raise SamplingError(
            f"study: Dask's scheduler cannot be reached - got {error}, expected one at '{address}'; check the address"
        ) from error
    most = max(client.nthreads().values(), default=1)
    if most > 1:
        client.close()
        raise SamplingError(
            f"study: Dask's workers have several threads - got {most} in one, expected processes with one thread: "
            "CasADi cannot build expressions in two threads at once; start them with "
            "'dask worker ADDRESS --nworkers auto --nthreads 1'"
        )
    return client


@contextmanager
def _environment(threads: int) -> Iterator[None]:
    """Set the number of threads of linear algebra for processes that start within the context."""
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


class _Worker(SpawnProcess):
    """A process that Ctrl-C does not end while it starts; it inherits what this process blocks."""

    def start(self) -> None:
        """Start the process."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    """Makes workers."""

    Process = _Worker


def _follow_parent() -> None:
    """In a worker: ignore Ctrl-C, which the parent handles, and exit when the parent has ended for any reason."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
