"""Roll-outs on the CPU: MuJoCo's own loop in C, on a permanent pool of threads."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import available_cores
from piaffe.errors import ModelError
from piaffe.models import import_mujoco

from .engine import Array, Engine, Rollouts, Simulated, hold_last_good, may_be_bad, shared_steps
from .take import no_time, take

CHUNKS_PER_THREAD = 16  # so that 513 or 1025 samples are divided evenly between two threads


@dataclass(frozen=True, slots=True)
class _Buffers:
    """Memory for roll-outs of one size, in which the first L of S steps are simulated once for all samples.

    `simulated` contains (time, x) after every step of the simulator.
    """

    models: list[Any]
    initial: Array  # (n, 1 + nx)
    warm: Array  # (n, nv)
    held: Array | None  # controls of all substeps, (n, (S - L) · substeps, nu); None if `controls` can be used directly
    simulated: Array  # (n, (S - L) · substeps, 1 + nx)
    sensors: Array
    states: Array  # (n, S + 1, nx)


@dataclass(frozen=True, slots=True)
class _Lead:
    """The L first steps, which are the same for all samples (L may be 0), and the start of the next step."""

    states: Array  # x₁ … x_L, (L, nx)
    end: Array  # time and state, (1 + nx,), or (n, 1 + nx) if samples have different initial states
    warm: Array  # accelerations that the contact solver starts from, (nv,)


class NativeEngine(Engine):
    """Simulates samples in parallel on threads, by ``mujoco.rollout``.

    Memory is kept for each size of roll-out: a second call of the same size allocates no memory. The GIL is released
    during the simulation. The result depends only on the arguments, not on earlier calls or the number of threads.

    If all samples have the same initial state and the same first controls, the steps with these controls are simulated
    once. The states are the same, bit by bit, as with a separate simulation for each sample.

    Args:
        model: model to simulate. A sample's control is constant over the model's substeps.
        threads: number of threads, by default one per available core; 0 uses the calling thread.
        warm_start: whether MuJoCo's contact solver starts from the last step's solution; as in the model by default.
            The first step of a roll-out never does.
        chunk: number of samples that a thread simulates at a time; by default a sixteenth of its share.
    """

    name = "native"

    def __init__(
        self, model: Simulated, *, threads: int | None = None, warm_start: bool | None = None, chunk: int | None = None
    ) -> None:
        mujoco = import_mujoco()
        from mujoco.rollout import Rollout

        self.threads = available_cores() if threads is None else threads
        self.substeps = model.substeps
        self._chunk = chunk
        self._mujoco = mujoco
        self._model = own_copy(mujoco, model.compiled(), warm_start=warm_start)
        super().__init__(self._model.nq, self._model.nv, self._model.nu)
        self._data = [mujoco.MjData(self._model) for _ in range(max(self.threads, 1))]
        self._pool: Any = Rollout(nthread=self.threads)
        self._alone = Rollout(nthread=0)  # uses the calling thread
        no_time()  # compiles its library now, not in the first roll-out
        self._buffers: dict[tuple[int, int, int], _Buffers] = {}

    def _simulate(self, x0: Array, controls: Array) -> Rollouts:
        n, steps = controls.shape[:2]
        with quiet(self._mujoco):
            lead = self._lead(x0, controls)
            first = len(lead.states)
            memory = self._memory(n, steps, first)
            memory.initial[:], memory.warm[:] = lead.end, lead.warm
            self._pool.rollout(
                memory.models,
                self._data,
                memory.initial,
                self._held(memory, controls, first),
                skip_checks=True,
                nstep=(steps - first) * self.substeps,
                initial_warmstart=memory.warm,
                state=memory.simulated,
                sensordata=memory.sensors,
                chunk_size=self._chunk or max(1, n // (CHUNKS_PER_THREAD * max(self.threads, 1))),
            )
        memory.states[:, 0], memory.states[:, 1 : first + 1] = x0, lead.states
        return Rollouts(memory.states, self._finish_states(memory, controls, first))

    def _release(self) -> None:
        self._pool.close()
        self._buffers.clear()

    def _lead(self, x0: Array, controls: Array) -> _Lead:
        """Return the first steps that all samples share; none if they fail: then each sample is simulated by itself."""
        nx, dt = self.nq + self.nv, self._model.opt.timestep
        start = np.zeros((*x0.shape[:-1], 1 + nx))
        start[..., 1:] = x0
        none = _Lead(np.empty((0, nx)), start, np.zeros(self.nv))
        count = shared_steps(controls) if x0.ndim == 1 else 0
        if not count:
            return none
        data, held = self._data[0], np.repeat(controls[:1, :count], self.substeps, axis=1)
        path, sensors = (np.empty((1, held.shape[1], size)) for size in (1 + nx, self._model.nsensordata))
        self._alone.rollout(
            [self._model], [data], start[None], held, skip_checks=True, nstep=held.shape[1], state=path,
            sensordata=sensors,
        )  # fmt: skip
        on_time = path[0, -1, 0] > (held.shape[1] - 0.5) * dt
        if not on_time or data.warning.number.any() or may_be_bad(path[:, :, 1:], self.nq)[0]:
            return none
        return _Lead(path[0, self.substeps - 1 :: self.substeps, 1:], path[0, -1], data.qacc_warmstart.copy())

    def _held(self, memory: _Buffers, controls: Array, first: int) -> Array:
        """Return the control of every step of the simulator after the shared first steps."""
        if memory.held is None:
            return np.ascontiguousarray(controls)
        n, steps = len(controls), controls.shape[1] - first
        memory.held.reshape(n, steps, self.substeps, self.nu)[:] = controls[:, first:, None]
        return memory.held

    def _memory(self, n: int, steps: int, first: int) -> _Buffers:
        if (n, steps, first) not in self._buffers:
            nx, total = self.nq + self.nv, (steps - first) * self.substeps
            self._buffers[n, steps, first] = _Buffers(
                models=[self._model] * n,
                initial=np.zeros((n, 1 + nx)),
                warm=np.empty((n, self.nv)),
                held=np.empty((n, total, self.nu)) if first or self.substeps > 1 else None,
                simulated=np.empty((n, total, 1 + nx)),
                sensors=np.empty((n, total, self._model.nsensordata)),
                states=np.empty((n, steps + 1, nx)),
            )
        return self._buffers[n, steps, first]

    def _finish_states(self, memory: _Buffers, controls: Array, first: int) -> NDArray[np.bool_]:
        """Copy the simulated states, hold the last good state of failed samples, and return which failed."""
        dt, times = self._model.opt.timestep, memory.simulated[:, :, 0]
        # after its first warning, MuJoCo's loop no longer advances the time of a sample
        due = (np.arange(1, times.shape[1] + 1) - 0.5 + first * self.substeps) * dt
        suspects = take(memory.simulated, self.substeps, self.nq, float(due[-1]), memory.states[:, first + 1 :])
        suspects |= may_be_bad(memory.states[:, :1], self.nq)
        suspects |= ~np.isfinite(np.einsum("nsi->n", controls))
        failed = np.zeros(len(controls), dtype=bool)
        if samples := np.flatnonzero(suspects).tolist():
            stopped = np.zeros((len(samples), controls.shape[1]), dtype=bool)
            stopped[:, first:] = ~(times[samples] > due)[:, self.substeps - 1 :: self.substeps]
            stopped |= ~np.isfinite(controls[samples]).all(axis=2)
            failed[samples] = hold_last_good(memory.states, self.nq, samples, stopped)
        return failed


def own_copy(mujoco: Any, compiled: Any, *, warm_start: bool | None) -> Any:
    """Return a copy of a compiled model that does not reset the simulation after a divergence.

    Raises:
        ModelError: the model's state is more than (qpos, qvel).
    """
    full = mujoco.mj_stateSize(compiled, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    if full != 1 + compiled.nq + compiled.nv:
        raise ModelError(
            f"engine: state of the simulated model - got {full - 1} numbers, expected {compiled.nq + compiled.nv}, "
            "positions and velocities alone; use actuators without activation and no plug-ins"
        )
    model = copy.copy(compiled)
    bits = mujoco.mjtDisableBit
    model.opt.disableflags |= int(bits.mjDSBL_AUTORESET)
    if warm_start is not None:
        cold = int(bits.mjDSBL_WARMSTART)
        model.opt.disableflags = model.opt.disableflags & ~cold if warm_start else model.opt.disableflags | cold
    return model


@contextmanager
def quiet(mujoco: Any) -> Iterator[None]:
    """Disable MuJoCo's warnings and its time measurement within the context.

    MuJoCo prints a line and writes to a log file for each diverged sample, which the engine counts itself. MuJoCo also
    reads the clock thirty times per step, for statistics that the engine does not use; this takes a tenth of the time
    of a small robot's step. At the end, the handlers from before are set again.
    """
    warn, time, idle = mujoco.get_mju_user_warning(), mujoco.get_mjcb_time(), no_time()
    mujoco.set_mju_user_warning(_ignore)
    if time is None and idle is not None:
        mujoco.set_mjcb_time(idle)
    try:
        yield
    finally:
        # with two roll-outs at a time, the later one found the functions of this context already set
        mujoco.set_mju_user_warning(None if warn is _ignore else warn)
        if time is None or time is idle:
            mujoco.set_mjcb_time(None)  # MuJoCo's default


def _ignore(message: str) -> None:
    """Ignore a message."""
