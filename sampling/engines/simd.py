"""Roll-outs on the CPU with SIMD: MuJoCo's step of a legged robot as generated C, several samples per instruction."""

from __future__ import annotations

import ctypes as ct
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import (
    SOLVER_FLAGS,
    LazySources,
    NoCompilerError,
    Sources,
    aligned_zeros,
    available_cores,
    build,
    generate,
    load,
    pointer,
    run_in_parallel,
    shares,
)
from piaffe.codegen import simd as simd_code
from piaffe.errors import SamplingError
from piaffe.models import import_mujoco, recursions, tree
from piaffe.ocp import rotation

from . import simd_text
from .engine import Array, Engine, Rollouts, Simulated, hold_last_good, may_be_bad, shared_steps
from .native import NativeEngine, own_copy
from .simd_reader import scene_of
from .simd_scene import Scene
from .simd_text import SceneText

# Largest relative difference of states after a few steps. Rounding gives 1e-12, another order of the solver's updates
# gives 1e-2. If the solver stops at a small improvement, rounding can decide whether there is one more sweep, which
# gives 1e-5 in one of a thousand samples. Then only the best nine of ten samples are compared.
_AGREEMENT = 1e-7
_FEW = 4  # iterations up to which all samples are compared
_TRIALS, _TRIAL_STEPS = 32, 3
_TEMPLATES = ("simulate.c", "simulate.h", "contacts.inc", "constraints.inc", "gauss_seidel.inc", "step.inc")
_MAKERS = (simd_text, recursions, tree, rotation, simd_code)  # modules that generate the C code of the smooth dynamics


class DifferentError(SamplingError):
    """The SIMD engine's states differ from those of the installed MuJoCo."""


class SimdEngine(Engine):
    """Simulates several samples per instruction, as many as fit in a vector of the processor, on threads.

    The engine computes MuJoCo's step for the parts that legged robots need: a floating base with hinges, position or
    torque actuators, balls in contact with planes and boxes, limits of joints, the PGS solver with elliptic cones, and
    Euler's integrator. A model with other parts raises an error. States agree with MuJoCo's up to rounding. Each new
    engine checks this, because MuJoCo's solver differs between versions. The C code is generated once from the numbers
    of the compiled model, and its library is kept in the cache.

    Args:
        model: model to simulate. A sample's control is constant over the model's substeps.
        threads: number of threads, by default one per available core.
        warm_start: whether the contact solver starts from the last step's solution; as in the model by default.
        width: samples per instruction, 1, 2, 4 or 8; by default the number that suits this processor.

    Raises:
        SamplingError: the model has a part that the engine does not support, or there is no C compiler.
        DifferentError: states differ from those of the installed MuJoCo.
    """

    name = "simd"

    def __init__(
        self,
        model: Simulated,
        *,
        threads: int | None = None,
        warm_start: bool | None = None,
        width: int | None = None,
    ) -> None:
        compiled = own_copy(import_mujoco(), model.compiled(), warm_start=warm_start)
        super().__init__(compiled.nq, compiled.nv, compiled.nu)
        self.substeps = model.substeps
        self.threads = max(1, available_cores() if threads is None else threads)
        scene = scene_of(compiled)
        try:
            loaded, self._width = _library(SceneText(scene), width)
        except NoCompilerError as error:
            raise SamplingError(
                f'simd engine: {error}; install one, pip install "piaffe[compiler]", or choose engine="native"'
            ) from error
        self._run, size = loaded.piaffe_simulate, loaded.piaffe_simulate_memory()
        self._memory = [aligned_zeros(size, np.uint8) for _ in range(self.threads)]
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1))
        self._states: dict[tuple[int, int], Array] = {}
        self._compare(model, scene, warm_start)

    def _simulate(self, x0: Array, controls: Array) -> Rollouts:
        controls = np.ascontiguousarray(controls)
        n, steps = controls.shape[:2]
        lead = shared_steps(controls) if x0.ndim == 1 else 0
        if (n, steps) not in self._states:
            self._states[n, steps] = np.empty((n, steps + 1, self.nq + self.nv))
        states = self._states[n, steps]
        states[:, 0] = x0

        def run(part: tuple[int, int, int]) -> None:
            thread, first, last = part
            self._run(
                pointer(controls), *map(ct.c_long, (steps, self.substeps, lead, first, last)), pointer(states),
                pointer(self._memory[thread]),
            )  # fmt: skip

        parts = enumerate(shares(n, self._width, self.threads))
        run_in_parallel(run, [(thread, *part) for thread, part in parts if part[0] < part[1]], self._pool)
        return Rollouts(states, self._replace_failed(states, controls))

    def _release(self) -> None:
        self._pool.shutdown()
        self._states.clear()

    def _compare(self, model: Simulated, scene: Scene, warm_start: bool | None) -> None:
        """Raise DifferentError if MuJoCo's states differ in roll-outs from random states near the grounds."""
        with NativeEngine(model, threads=0, warm_start=warm_start) as native:
            states, controls = _states_in_contact(model.compiled(), scene)
            want = native.rollout(states, controls)
            got = self.rollout(states, controls)
            both = ~(want.failed | got.failed)
            off = np.abs(got.states - want.states) / np.maximum(1.0, np.abs(want.states))
            apart = off[both].max(axis=(1, 2))
        few = scene.iterations <= _FEW
        worst = float(np.max(apart, initial=0.0) if few or not len(apart) else np.quantile(apart, 0.9))
        if not (worst < _AGREEMENT and np.array_equal(want.failed, got.failed) and np.any(both)):
            self.close()
            raise DifferentError(
                f"simd engine: states differ from those of MuJoCo {import_mujoco().__version__} - got {worst:.1e} of "
                f"their size with {int(np.sum(both))} of {_TRIALS} trials finite, expected less than {_AGREEMENT:g}; "
                'choose engine="native", and report this to the developers'
            )

    def _replace_failed(self, states: Array, controls: Array) -> NDArray[np.bool_]:
        """Replace the states of failed samples with the last good ones, and return which failed."""
        suspects = may_be_bad(states, self.nq) | ~np.isfinite(np.einsum("nsi->n", controls))
        failed = np.zeros(len(controls), dtype=bool)
        if samples := np.flatnonzero(suspects).tolist():
            stopped = np.logical_not(np.isfinite(controls[samples]).all(axis=2))
            failed[samples] = hold_last_good(states, self.nq, samples, stopped)
        return failed


def _library(text: SceneText, width: int | None) -> tuple[ct.CDLL, int]:
    """Return the compiled library of a scene, and the number of samples per instruction."""
    folder = files(__package__).joinpath("template")
    templates = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in _TEMPLATES}

    def sources() -> Sources:
        made = generate({"smooth": text.smooth})
        units = [*((unit.name, unit.text) for unit in made.units), ("simulate", templates["simulate.c"])]
        includes = {name: template for name, template in templates.items() if name != "simulate.c"}
        return Sources(units, {**made.headers, **includes, "scene.h": text.header}, {"simulate": SOLVER_FLAGS})

    # The cache key uses the short sources, and the modules and numbers that determine the long source. If a module is
    # missing here, the comparison with MuJoCo finds a library that is older than a change of this module.
    makers = [Path(module.__file__ or "").read_text(encoding="utf-8") for module in _MAKERS]
    parts = [part for entry in templates.items() for part in entry]
    parts += [text.header, text.numbers, *SOLVER_FLAGS, cs.CasadiMeta.version(), simd_code.SIMD_H, *makers]
    built = build(LazySources(parts, sources), width=width, label="SIMD roll-outs")
    loaded = load(built)
    loaded.piaffe_simulate.restype, loaded.piaffe_simulate_memory.restype = None, ct.c_long
    return loaded, built.width


def _states_in_contact(model: Any, scene: Scene) -> tuple[Array, Array]:
    """Return random states (n, nx), each with a random ball up to 2 cm deep in a random ground, and controls."""
    mujoco, random = import_mujoco(), np.random.default_rng(0)
    data = mujoco.MjData(model)
    states = np.zeros((_TRIALS, model.nq + model.nv))
    low, high = np.where(model.jnt_limited[1:, None], model.jnt_range[1:], [-1.0, 1.0]).T
    for state in states:
        mujoco.mj_resetData(model, data)
        data.qpos[7:] = np.clip(0.7 * random.standard_normal(model.njnt - 1), low - 1e-3, high + 1e-3)
        data.qpos[3:7] = np.r_[1.0, 0.1 * random.standard_normal(3)]
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        mujoco.mj_kinematics(model, data)
        if scene.contacts:
            contact = scene.contacts[random.integers(len(scene.contacts))]
            ground, ball = scene.grounds[contact.ground], scene.balls[contact.ball]
            centre = data.xpos[ball.link + 1] + data.xmat[ball.link + 1].reshape(3, 3) @ ball.offset
            half = np.array([0.5, 0.5, 0.0]) if ground.half is None else ground.half
            deep = scene.radii[contact.ball] - 0.02 * random.uniform()
            spot = half * np.r_[random.uniform(-1, 1, 2), 1.0] + [0.0, 0.0, deep]  # on its upper side
            data.qpos[:3] += ground.place + ground.axes @ spot - centre
        state[: model.nq], state[model.nq :] = data.qpos, random.standard_normal(model.nv)
    targets = states[:, None, 7 : model.nq] + 0.3 * random.standard_normal((_TRIALS, _TRIAL_STEPS, model.nu))
    return states, targets
