"""Episodes of ``piaffe mpc`` in processes: a task that can be pickled, and the seeds that run at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, as_completed
from dataclasses import dataclass

from piaffe.errors import SolverError
from piaffe.simulation import OnlineEpisode

from .online import OnlineSetup
from .online_settings import OnlineSettings


@dataclass(frozen=True)
class OnlineTask:
    """Runs episodes of a file in a process; it can be pickled.

    Args:
        file: the file, and the problem's name.
        settings: the settings.
    """

    file: str
    settings: OnlineSettings

    def __call__(self, seed: int) -> OnlineEpisode:
        """Return the episode of a seed; the setup of a process is kept."""
        return self.setup().run(seed)

    def setup(self) -> OnlineSetup:
        """Return the setup of this process."""
        key = repr(self)
        if key not in _last:
            _last.clear()
            made = OnlineSetup.of_file(self.file, self.settings, quiet=True)
            made.build()
            _last[key] = made
        return _last[key]


_last: dict[str, OnlineSetup] = {}


def episodes_in_processes(task: OnlineTask, seeds: Sequence[int], workers: int) -> Iterator[tuple[int, OnlineEpisode]]:
    """Yield seeds and their episodes as they end.

    Args:
        task: what runs.
        seeds: the seeds.
        workers: number of processes.

    Raises:
        SolverError: a process died.
    """
    from piaffe.codegen import available_cores
    from piaffe.sampling import executor_of

    with executor_of("process", workers, max(1, available_cores() // workers)) as pool:
        waiting = {pool.submit(task, seed): seed for seed in seeds}
        try:
            for future in as_completed(list(waiting)):
                yield waiting.pop(future), future.result()
        except BrokenExecutor as error:
            raise SolverError(
                f"command line: a worker died - got {error}, expected it to run; check whether memory was full, and "
                "use fewer --workers"
            ) from error
        finally:
            for future in waiting:
                future.cancel()
