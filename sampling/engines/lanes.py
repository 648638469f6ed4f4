"""Rollouts on the CPU in lanes: MuJoCo's step of a legged robot as generated C, several samples per instruction."""

from __future__ import annotations

import ctypes as ct
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.models.mujoco_look import import_mujoco
from piaffe.ocp.lanes import generate
from piaffe.solvers.native import NoCompilerError, build, load
from piaffe.solvers.native.build import SOLVER_FLAGS

from ..c_library import pointer
from ..cores import available_cores
from .engine import Array, Engine, Rollouts, Simulated, hold_last_good, may_be_bad, shapes, shared_steps
from .lanes_reader import scene_of
from .lanes_text import SceneText
from .native import NativeEngine, own_copy

_TEMPLATE = files(__package__).joinpath("template", "simulate.c").read_text(encoding="utf-8")
_ALIGNMENT = 64  # bytes: of the widest vectors
# Of nine in ten samples after a few steps. Rounding makes 1e-12, another order of the solver 1e-2. Where the solver
# goes on until little improves, rounding may decide about the last sweep: 1e-5 in one of a thousand.
_AGREEMENT = 1e-7
_TRIALS, _TRIAL_STEPS = 16, 3


class LanesEngine(Engine):
    """Simulates as many samples at once as a processor's vectors hold, on threads.

    The step is MuJoCo's for what legged robots need: a floating base with hinges and position or torque actuators,
    balls that touch planes and boxes, limits of joints, the PGS solver with elliptic cones, Euler's step. States agree
    with MuJoCo's to rounding, which a new engine looks at before it is used: MuJoCo's solver changes with its versions.
    Anything else is refused. The C is made from the compiled model's numbers, once, and kept in the cache.

    Args:
        model: what to simulate. A sample's control is held over the model's substeps.
        threads: number of threads, default one per available core.
        warm_start: whether the contact solver starts from the last step's solution, as the model has it unless given.
        width: lanes, 1, 2, 4 or 8; as this processor likes it by default.

    Raises:
        SamplingError: the model has something that is not simulated, there is no C compiler, or states differ from
            those of the installed MuJoCo.
    """

    name = "lanes"

    def __init__(
        self,
        model: Simulated,
        *,
        threads: int | None = None,
        warm_start: bool | None = None,
        width: int | None = None,
    ) -> None:
        compiled = own_copy(import_mujoco(), model.compiled(), warm_start=warm_start)
        self.nq, self.nv, self.nu, self.substeps = compiled.nq, compiled.nv, compiled.nu, model.substeps
        self.threads = max(1, available_cores() if threads is None else threads)
        text = SceneText(scene_of(compiled))
        try:
            loaded, self._width = _library(text, width)
        except NoCompilerError as error:
            raise SamplingError(
                f'lanes engine: {error}; install one, pip install "piaffe[compiler]", or choose engine="native"'
            ) from error
        self._run, size = loaded.piaffe_simulate, loaded.piaffe_simulate_memory()
        self._memory = [np.zeros(size + _ALIGNMENT, dtype=np.uint8) for _ in range(self.threads)]
        self._pool: ThreadPoolExecutor | None = ThreadPoolExecutor(max(1, self.threads - 1))
        self._states: dict[tuple[int, int], Array] = {}
        self._compare(model, warm_start)

    def rollout(self, x0: Array, controls: Array) -> Rollouts:
        """Simulate control sequences from a state, or from one state each.

        A sample fails when it leaves the finite numbers, moves faster than ``MAX_SPEED``, or is given a control that
        is not finite; see :class:`Rollouts` for what its states are then.

        Args:
            x0: initial state, (nx,), or one per sample, (n, nx).
            controls: (n, S, nu).

        Raises:
            ShapeError: an array has the wrong shape.
            SamplingError: the engine was closed.
        """
        if self._pool is None:
            raise SamplingError(
                "lanes engine: rollout after close() - got a closed engine, expected an open one; make a new one"
            )
        x0, controls = shapes("lanes engine", x0, controls, self.nq + self.nv, self.nu)
        controls = np.ascontiguousarray(controls)
        n, steps = controls.shape[:2]
        lead = shared_steps(controls) if x0.ndim == 1 else 0
        states = self._states.setdefault((n, steps), np.empty((n, steps + 1, self.nq + self.nv)))
        states[:, 0] = x0

        def run(thread: int) -> None:
            own = self._memory[thread]
            aligned = own.ctypes.data + (-own.ctypes.data % _ALIGNMENT)
            self._run(
                pointer(controls), *map(ct.c_long, (steps, self.substeps, lead, *self._part(n, thread))),
                pointer(states), ct.c_void_p(aligned),
            )  # fmt: skip

        busy = [thread for thread in range(self.threads) if self._part(n, thread)[0] < self._part(n, thread)[1]]
        others = [self._pool.submit(run, thread) for thread in busy[1:]]
        run(busy[0])
        for other in others:
            other.result()
        return Rollouts(states, self._mend(states, controls))

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()
        self._pool = None
        self._states.clear()

    def _compare(self, model: Simulated, warm_start: bool | None) -> None:
        """Raise SamplingError if MuJoCo goes elsewhere from random states about the ground, a few of them far off."""
        with NativeEngine(model, threads=0, warm_start=warm_start) as native:
            compiled = model.compiled()
            states, controls = _about_the_ground(compiled, self.nu)
            want = native.rollout(states, controls)
            got = self.rollout(states, controls)
            off = np.abs(got.states - want.states) / np.maximum(1.0, np.abs(want.states))
            apart = float(np.quantile(off[~(want.failed | got.failed)].max(axis=(1, 2), initial=0.0), 0.9))
        if not (apart < _AGREEMENT and np.array_equal(want.failed, got.failed)):
            self.close()
            raise SamplingError(
                f"lanes engine: states differ from those of MuJoCo {import_mujoco().__version__} - got {apart:.1e} of "
                f'their size, expected less than {_AGREEMENT:g}; choose engine="native", and tell us'
            )

    def _part(self, n: int, thread: int) -> tuple[int, int]:
        """Return first and last sample of a thread's share: whole blocks of lanes but for the last."""
        blocks = -(-n // self._width)
        first, last = (self._width * round(blocks * k / self.threads) for k in (thread, thread + 1))
        return min(first, n), min(last, n)

    def _mend(self, states: Array, controls: Array) -> NDArray[np.bool_]:
        """Let failed samples stand still, and return which failed."""
        suspects = may_be_bad(states, self.nq) | ~np.isfinite(np.einsum("nsi->n", controls))
        failed = np.zeros(len(controls), dtype=bool)
        if samples := np.flatnonzero(suspects).tolist():
            stopped = np.logical_not(np.isfinite(controls[samples]).all(axis=2))
            failed[samples] = hold_last_good(states, self.nq, samples, stopped)
        return failed


def _library(text: SceneText, width: int | None) -> tuple[ct.CDLL, int]:
    """Return the library of a scene, and how many lanes it has."""
    made = generate({"smooth": text.smooth})
    built = build(
        [*((unit.name, unit.text) for unit in made.units), ("simulate", _TEMPLATE)],
        headers={**made.headers, "scene.h": text.header},
        flags_per_unit={"simulate": SOLVER_FLAGS},
        width=width,
        label="rollouts in lanes",
    )
    loaded = load(built)
    loaded.piaffe_simulate.restype, loaded.piaffe_simulate_memory.restype = None, ct.c_long
    return loaded, built.width


def _about_the_ground(model: Any, nu: int) -> tuple[Array, Array]:
    """Return random states whose lowest foot is up to 2 cm below the origin's ground, (n, nx), and controls."""
    mujoco, random = import_mujoco(), np.random.default_rng(0)
    data = mujoco.MjData(model)
    states = np.zeros((_TRIALS, model.nq + model.nv))
    for state in states:
        mujoco.mj_resetData(model, data)
        low, high = np.where(model.jnt_limited[1:, None], model.jnt_range[1:], [-1.0, 1.0]).T
        data.qpos[7:] = np.clip(0.7 * random.standard_normal(model.njnt - 1), low, high + 1e-3)
        data.qpos[4:7] = 0.1 * random.standard_normal(3)
        mujoco.mj_kinematics(model, data)
        moving = model.geom_bodyid > 0
        lowest = np.min(data.geom_xpos[moving, 2] - model.geom_size[moving, 0], initial=np.inf)
        data.qpos[2] -= lowest + 0.02 * random.uniform() if np.isfinite(lowest) else 0.0
        state[: model.nq], state[model.nq :] = data.qpos, random.standard_normal(model.nv)
    targets = states[:, None, 7 : model.nq] + 0.3 * random.standard_normal((_TRIALS, _TRIAL_STEPS, nu))
    return states, targets
