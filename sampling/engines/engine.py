"""What a rollout engine is given and returns, whatever simulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ShapeError

Array = NDArray[np.float64]

MAX_SPEED = 1e3  # [m/s], [rad/s]: no robot moves like this, and a simulation that does has lost all digits


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


class Engine(Protocol):
    """Simulates many control sequences from one state, or from one state each."""

    def rollout(self, x0: Array, controls: Array) -> Rollouts:
        """Simulate control sequences of shape (n, S, nu) from a state, (nx,), or from one each, (n, nx)."""
        ...

    def close(self) -> None:
        """Release threads and device memory; the engine cannot be used afterwards."""
        ...


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


def hold_last_good(states: Array, nq: int, samples: Sequence[int] | NDArray[np.intp], stopped: Any = None) -> None:
    """Let samples stand still from their first bad state on; x₀ itself is replaced by zeros where it is not finite.

    Args:
        states: (n, S + 1, nx), changed in place.
        nq: number of positions; what follows are speeds.
        samples: those to look at.
        stopped: per looked-at sample and state, whether the simulator had stopped there, (len(samples), S + 1).
    """
    for row, i in enumerate(samples):
        path = states[i]
        with np.errstate(all="ignore"):
            bad = ~(np.isfinite(path).all(axis=1) & (np.abs(path[:, nq:]).max(axis=1) <= MAX_SPEED))
        if stopped is not None:
            bad |= stopped[row]
        if not bad.any():
            continue
        first = int(np.argmax(bad))
        if first == 0:
            path[0] = np.where(np.isfinite(path[0]), path[0], 0.0)
        path[max(first, 1) :] = path[max(first, 1) - 1]


def suspicious(states: Array, nq: int) -> NDArray[np.bool_]:
    """Return which samples may hold a bad state: cheap, finds every non-finite number and every speed beyond bounds."""
    with np.errstate(all="ignore"):
        speeds = states[:, :, nq:]
        energy = np.einsum("nsi,nsi->n", speeds, speeds)
        place = np.einsum("nsi->n", states[:, :, :nq])
        return np.asarray(~((energy <= MAX_SPEED**2) & np.isfinite(place)))
