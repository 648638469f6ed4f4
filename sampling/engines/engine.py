"""The interface of all roll-out engines: arguments, results and checks."""

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
    """The states of many samples, each with its own control sequence.

    Attributes:
        states: x₀ … x_S of every sample, (n, S + 1, nx). The engine's next roll-out overwrites this array; copy it to
            keep it. The state of a failed sample is constant from the first bad step on, so every number is finite.
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
    """Simulates many control sequences from one state, or from one state each; a context manager that closes it.

    An engine may simulate the steps that are the same for all samples only once. Only one thread may use it at a time,
    because each roll-out uses the same memory.

    Attributes:
        name: name of the engine in options.
        nq: number of positions.
        nv: number of velocities.
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

        A sample fails if its state or control is not finite, if a velocity is above ``MAX_SPEED``, or if the simulator
        stops; :class:`Rollouts` describes its states.

        Args:
            x0: initial state, (nx,), or one per sample, (n, nx).
            controls: (n, S, nu).

        Raises:
            ShapeError: an array has the wrong shape.
            SamplingError: the engine was closed, or another thread is using it.
        """
        if self.closed:
            raise SamplingError(
                f"{self.name} engine: rollout after close() - got a closed engine, expected an open one; make a new one"
            )
        x0, controls = shapes(f"{self.name} engine", x0, controls, self.nq + self.nv, self.nu)
        if not self._turn.acquire(blocking=False):
            raise SamplingError(
                f"{self.name} engine: rollout - got a second one while another thread's is running, expected one at "
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
        """Simulate controls that :meth:`rollout` has checked."""

    @abstractmethod
    def _release(self) -> None:
        """Release threads and memory; called once."""

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
    """Return how many of the first controls (n, S, nu) are equal for all samples: less than S, and 0 if n is 1."""
    n, steps = controls.shape[:2]
    count = 0
    while n > 1 and count < steps - 1:
        first, second = controls[:2, count]
        if not (
            np.array_equal(first, second) and np.all(controls[:, count] == first)
        ):  # the comparison of two samples is often enough
            break
        count += 1
    return count


def may_be_bad(states: Array, nq: int) -> NDArray[np.bool_]:
    """Return the samples that need a full check, (n,): all with a bad state, and possibly others.

    This needs one pass over the numbers and no copy: the norm of the velocities of all steps and joints is compared
    with the limit of one velocity.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        speeds = states[:, :, nq:]
        energy = np.einsum("nsi,nsi->n", speeds, speeds)
        place = np.einsum("nsi->n", states[:, :, :nq])
    return np.asarray(~((energy <= MAX_SPEED**2) & np.isfinite(place)), dtype=bool)


def hold_last_good(states: Array, nq: int, samples: Sequence[int], stopped: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Replace each bad state and those after it with the last good state; return which samples had one, (m,).

    A state is bad if a number of it is not finite, a velocity is above ``MAX_SPEED``, or the simulator had stopped.
    Numbers of x₀ that are not finite become zero.

    Args:
        states: (n, S + 1, nx), changed in place.
        nq: number of positions, which are before the velocities.
        samples: samples to check, (m,).
        stopped: whether the simulator had stopped before the end of each step, (m, S).
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
