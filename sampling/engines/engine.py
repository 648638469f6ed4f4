"""What a rollout engine is given and returns, whatever simulates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from types import TracebackType
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError, ShapeError
from piaffe.simulation import MAX_SPEED as MAX_SPEED

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rollouts:
    """States that follow from one state under many control sequences.

    Attributes:
        states: x₀ … x_S of every sample, (n, S + 1, nx). Read it before the engine's next rollout, which writes over
            it, or keep a copy. A failed sample stands still from the first bad step on, so that every number is finite.
        failed: samples whose simulation diverged or stopped, (n,).
    """

    states: Array
    failed: NDArray[np.bool_]

    @property
    def failures(self) -> int:
        """Number of failed samples."""
        return int(np.count_nonzero(self.failed))


class Simulated(Protocol):
    """A model that an engine can simulate, as ``models.Mujoco`` is.

    The compiled model's ``qpos`` and ``qvel`` are the state, and its ``ctrl`` is the control.
    """

    @property
    def substeps(self) -> int:
        """Steps of the simulator per control."""
        ...

    def compiled(self) -> Any:
        """Return the ``mujoco.MjModel``."""
        ...


class Engine(ABC):
    """Simulates many control sequences from one state, or from one state each; a context that closes it.

    An engine may simulate steps that all samples share once for all of them. It is for one thread at a time: its memory
    is kept from rollout to rollout.

    Attributes:
        name: what it is asked for by.
        nq: number of positions.
        nv: number of speeds.
        nu: number of controls.
        closed: whether it was closed.
    """

    name: ClassVar[str]

    def __init__(self, nq: int, nv: int, nu: int) -> None:
        self.nq, self.nv, self.nu = nq, nv, nu
        self.closed = False
        self._turn = Lock()

    def rollout(self, x0: Array, controls: Array) -> Rollouts:
        """Simulate control sequences from a state, or from one state each.

        A sample fails when it leaves the finite numbers, moves faster than ``MAX_SPEED``, is given a control that is
        not finite, or makes the simulator stop; see :class:`Rollouts` for what its states are then.

        Args:
            x0: initial state, (nx,), or one per sample, (n, nx).
            controls: (n, S, nu).

        Raises:
            ShapeError: an array has the wrong shape.
            SamplingError: the engine was closed, or another thread's rollout is under way.
        """
        if self.closed:
            raise SamplingError(
                f"{self.name} engine: rollout after close() - got a closed engine, expected an open one; make a new one"
            )
        x0, controls = shapes(f"{self.name} engine", x0, controls, self.nq + self.nv, self.nu)
        if not self._turn.acquire(blocking=False):
            raise SamplingError(
                f"{self.name} engine: rollout - got a second one while another thread's is under way, expected one at "
                "a time; make an engine for each thread"
            )
        try:
            return self._simulate(x0, controls)
        finally:
            self._turn.release()

    def close(self) -> None:
        """Release threads and memory; the engine cannot be used afterwards."""
        if not self.closed:
            self.closed = True
            self._release()

    @abstractmethod
    def _simulate(self, x0: Array, controls: Array) -> Rollouts:
        """Simulate what :meth:`rollout` has looked at."""

    @abstractmethod
    def _release(self) -> None:
        """Let go of threads and memory; called once."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def shapes(name: str, x0: Any, controls: Any, nx: int, nu: int) -> tuple[Array, Array]:
    """Return initial states and controls as arrays, or raise ShapeError naming the engine."""
    x0, controls = np.asarray(x0, dtype=float), np.asarray(controls, dtype=float)
    if controls.ndim != 3 or controls.shape[2] != nu or 0 in controls.shape:
        raise ShapeError(
            f"{name}: controls - got shape {controls.shape}, expected (samples, steps, {nu}); one control per step"
        )
    n = len(controls)
    if x0.shape not in ((nx,), (n, nx)):
        raise ShapeError(
            f"{name}: initial state - got shape {x0.shape}, expected ({nx},), or ({n}, {nx}) for one per sample"
        )
    return x0, controls


def shared_steps(controls: Array) -> int:
    """Return how many of the first controls (n, S, nu) all samples share: less than S, and none if n is 1."""
    n, steps = controls.shape[:2]
    count = 0
    while n > 1 and count < steps - 1:
        first, second = controls[:2, count]
        if not (np.array_equal(first, second) and np.all(controls[:, count] == first)):  # two tell most often
            break
        count += 1
    return count


def may_be_bad(states: Array, nq: int) -> NDArray[np.bool_]:
    """Return the samples to look at more closely, (n,): all with a bad state and perhaps others.

    One pass over the numbers and no copy: the speeds of all steps and joints together are compared with the limit of
    one.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        speeds = states[:, :, nq:]
        energy = np.einsum("nsi,nsi->n", speeds, speeds)
        place = np.einsum("nsi->n", states[:, :, :nq])
    return np.asarray(~((energy <= MAX_SPEED**2) & np.isfinite(place)), dtype=bool)


def hold_last_good(states: Array, nq: int, samples: Sequence[int], stopped: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Let samples stand still from their first bad state on, and return which had one, (m,).

    A state is bad if a number of it is not finite, a speed is beyond ``MAX_SPEED``, or the simulator had stopped.
    Numbers of x₀ that are not finite become zeros.

    Args:
        states: (n, S + 1, nx), changed in place.
        nq: number of positions; what follows are speeds.
        samples: those to look at, (m,).
        stopped: whether the simulator had stopped by then, (m, S).
    """
    paths = states[samples]
    with np.errstate(invalid="ignore"):
        bad = ~(np.isfinite(paths).all(axis=2) & (np.abs(paths[:, :, nq:]).max(axis=2) <= MAX_SPEED))
    bad[:, 1:] |= stopped
    for i in np.flatnonzero(bad.any(axis=1)):
        path, first = states[samples[int(i)]], max(int(np.argmax(bad[i])), 1)
        path[0, ~np.isfinite(path[0])] = 0.0
        path[first:] = path[first - 1]
    return np.asarray(bad.any(axis=1))
