"""How long a plan takes, by part, beside MuJoCo's roll-outs alone on the same states and controls in the same run.

The robot walks meanwhile: each turn is one step of a closed loop, in which a plan is made and then its roll-outs are
made once more by ``mujoco.rollout`` alone, all H + 1 steps of each, with the same threads and chunks, the same memory
kept and nothing checked: as MuJoCo comes, and once more while its clock rests, as it does in a plan. Without a value
file, or with ``--random``, a network of the published size with random weights takes its place, which walks worse.

Besides the time that passes, the processors' time is told, summed over threads: what a busy machine lengthens less.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import numpy as np
from common import arguments, surroundings, tell
from mujoco.rollout import Rollout

from piaffe.sampling import CONTROLLERS, Sampler
from piaffe.sampling.engines.native import CHUNKS_PER_THREAD, NativeEngine, own_copy, quiet
from piaffe.sampling.study.declared import Declared, load_declared
from piaffe.sampling.study.trials import NO_VALUE, options_of
from piaffe.sampling.value.fingerprint import fingerprint
from piaffe.sampling.value.inputs import ValueInputs
from piaffe.sampling.value.network import HIDDEN, Layer, Network
from piaffe.sampling.value.store import Value, load_value

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "trot_mppi.py"
ALONE, ALONE_BUSY = "mujoco.rollout alone", "mujoco.rollout alone, processors"
RESTING = "mujoco.rollout alone, its clock at rest"
WARM_UP = 25  # steps of the closed loop before anything is timed


@dataclass(frozen=True)
class Setting:
    """What a plan is made with; ``threads`` of None is one per core."""

    samples: int = 512
    horizon: int = 8
    controller: str = "td-cd"
    value: bool = True
    engine: str = "simd"
    threads: int | None = None

    def __str__(self) -> str:
        what = self.controller + (" with value" if self.value else "")
        where = self.engine if self.engine == "mjx" else f"{self.engine}, {self.threads or cores()} threads"
        return f"N = {self.samples}, H = {self.horizon}, {what}, {where}"


def cores() -> int:
    """Return the number of cores that may be used."""
    return len(os.sched_getaffinity(0))


SETTINGS = (
    Setting(),
    Setting(value=False),
    Setting(threads=1),
    Setting(horizon=16),
    Setting(samples=1024, horizon=16, controller="dial", value=False),
    Setting(samples=2048, horizon=16, controller="dial", value=False),
)
ON_JAX = (Setting(engine="mjx"), Setting(samples=2048, horizon=16, engine="mjx"))


class Alone:
    """``mujoco.rollout`` with what a controller's engine simulates, and nothing else."""

    def __init__(self, controller: Sampler, threads: int) -> None:
        self.model = own_copy(mujoco, controller.model.compiled(), warm_start=None)
        n, steps = controller.options.samples + 1, controller.steps + 1
        self.models, self.steps, self.chunk = [self.model] * n, steps, max(1, n // (CHUNKS_PER_THREAD * threads))
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.pool = Rollout(nthread=threads)
        self.initial = np.zeros((n, 1 + self.model.nq + self.model.nv))
        self.states = np.empty((n, steps, self.initial.shape[1]))
        self.sensors = np.empty((n, steps, self.model.nsensordata))

    def roll(self, x: np.ndarray, controls: np.ndarray) -> None:
        """Make the roll-outs."""
        self.initial[:, 1:] = x
        self.pool.rollout(
            self.models, self.data, self.initial, controls, skip_checks=True, nstep=self.steps, state=self.states,
            sensordata=self.sensors, chunk_size=self.chunk,
        )  # fmt: skip


class Recorder:
    """An engine that keeps what it was last given."""

    def __init__(self, engine: Any) -> None:
        self.engine, self.controls = engine, np.zeros(0)

    def rollout(self, x0: np.ndarray, controls: np.ndarray) -> Any:
        """Roll out."""
        self.controls = controls
        return self.engine.rollout(x0, controls)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.engine, name)


def random_value(controller: Sampler) -> Value:
    """Return a value function with random weights, of the published size."""
    inputs = ValueInputs.standard(controller.nodes)
    sizes = (sum(inputs.spec(controller.nodes.mode).values()), *HIDDEN)
    random = np.random.default_rng(0)

    def drawn(*shape: int) -> Any:
        return (random.normal(size=shape) / np.sqrt(shape[0])).astype(np.float32)

    def alike(n: int, value: float) -> Any:
        return np.full(n, value, dtype=np.float32)

    layers = tuple(Layer(drawn(m, n), alike(n, 0.0), alike(n, 1.0), alike(n, 0.0)) for m, n in pairwise(sizes))
    network = Network(alike(sizes[0], 0.0), alike(sizes[0], 1.0), layers, drawn(sizes[-1]), 0.0)
    made_for = fingerprint(controller.nodes, controller.reward, controller.options, inputs)
    return Value(network, inputs, made_for, fall={"tilt": 0.5, "height": 0.15})


def accelerator() -> dict[str, Any]:
    """Return what JAX computes on."""
    import jax  # imported where it is asked for: it takes the device

    device = jax.devices()[0]
    return {"jax": jax.__version__, "device": device.device_kind, "platform": device.platform}


def controller_of(declared: Declared, setting: Setting, file: Path | None) -> Sampler:
    """Return the controller of a setting."""
    given = {"controller": setting.controller, "samples": setting.samples, "engine": setting.engine, "value": NO_VALUE}
    options = options_of(declared, given, setting.threads)
    problem = declared.problem(horizon=setting.horizon)
    controller: Any = CONTROLLERS[setting.controller](problem, options, reward=declared.reward)
    if setting.value:
        controller.value = random_value(controller) if file is None else load_value(file, controller)
    return controller


def measure(controller: Sampler, setting: Setting, repeats: int) -> dict[str, Any]:
    """Return what a plan and its parts take over the turns, and its roll-outs alone."""
    alone = Alone(controller, setting.threads or cores()) if setting.engine != "mjx" else None
    recorder = Recorder(controller.engine)
    if alone is not None:
        controller.engine = recorder
    turns: list[dict[str, float]] = []
    x = controller.problem.initial
    controller.reset(0)
    with NativeEngine(controller.model, threads=0) as plant:
        for k in range(WARM_UP + repeats):
            wall, busy = time.perf_counter(), time.process_time()
            plan = controller.plan(x, k * controller.dt)
            turn = {"plan": time.perf_counter() - wall, "plan, processors": time.process_time() - busy, **plan.seconds}
            turn["rest"] = turn["plan"] - sum(plan.seconds.values())
            if alone is not None:
                wall, busy = time.perf_counter(), time.process_time()
                alone.roll(x, recorder.controls)
                turn[ALONE], turn[ALONE_BUSY] = time.perf_counter() - wall, time.process_time() - busy
                with quiet(mujoco):
                    wall = time.perf_counter()
                    alone.roll(x, recorder.controls)
                    turn[RESTING] = time.perf_counter() - wall
            if k >= WARM_UP:
                turns.append(turn)
            x = plant.rollout(x, plan.action[None, None]).states[0, -1].copy()
            if controller.model.fallen(x):
                x = controller.problem.initial
    result = {
        "ms": {
            name: {"median": round(1e3 * median(turn[name] for turn in turns), 3),
                   "least": round(1e3 * min(turn[name] for turn in turns), 3)}
            for name in turns[0]
        },
        "evaluate_percent": round(100 * median(turn["evaluate"] / turn["plan"] for turn in turns), 2),
    }  # fmt: skip
    if alone is not None:
        for name, over in (
            ("plan_over_rollout", ("plan", ALONE)),
            ("plan_over_rollout_at_rest", ("plan", RESTING)),
            ("in_processor_time", ("plan, processors", ALONE_BUSY)),
        ):
            result[name] = round(median(turn[over[0]] / turn[over[1]] for turn in turns), 3)
        count = (setting.samples + 1) * (setting.horizon + 1)
        result["steps_per_s"] = round(count / median(turn["roll_out"] for turn in turns))
    return result


def main() -> None:
    """Print the table."""
    parser = arguments(__doc__ or "", repeats=100)
    parser.add_argument("--file", default=str(EXAMPLE), help="the problem")
    parser.add_argument("--value", type=Path, default=None, help="value file; random weights without one")
    parser.add_argument(
        "--random", action="store_true", help="random weights of the published size, not the file's value"
    )
    parser.add_argument(
        "--engines", nargs="+", choices=("simd", "native", "mjx"), default=["simd", "native"],
        help="mjx is on the processor that JAX has, and compiles for a minute per size",
    )  # fmt: skip
    parser.add_argument("--only", default="", help="settings whose line in the table contains this text")
    given = parser.parse_args()
    declared = load_declared(given.file)
    file = given.value
    if given.random:
        file = None
    elif file is None and declared.value is not None and (declared.path.parent / declared.value).exists():
        file = declared.path.parent / declared.value
    made = [replace(setting, engine=engine) for engine in ("simd", "native") for setting in SETTINGS]
    settings = [s for s in (*made, *ON_JAX) if s.engine in given.engines and given.only in str(s)]
    if not settings:
        parser.error(f"--only {given.only!r} leaves no setting of the engines {given.engines}")
    results: dict[str, Any] = {
        "benchmark": "plan_time", "example": Path(given.file).name, "repeats": given.repeats,
        "value": "random weights" if file is None else file.name, "where": surroundings(), "mujoco": mujoco.__version__,
        **(accelerator() if "mjx" in given.engines else {}),
        "settings": {},
    }  # fmt: skip
    for setting in settings:
        controller = controller_of(declared, setting, file)
        results["settings"][str(setting)] = measure(controller, setting, given.repeats)
        controller.engine.close()
    tell(results, lines(results), json=given.json, save=given.save)


def lines(results: Mapping[str, Any]) -> Sequence[str]:
    """Return the table: medians in ms."""
    heads = {"plan": "plan", ALONE: "alone", RESTING: "no clock"}
    heads |= {"plan, processors": "plan, cpu", ALONE_BUSY: "alone, cpu"}
    heads |= {part: part for part in ("sample", "roll_out", "evaluate", "value", "weigh", "rest")}
    ratios = {"plan_over_rollout": "ratio", "plan_over_rollout_at_rest": "no clock", "in_processor_time": "ratio, cpu"}
    found = [
        f"value: {results['value']}; medians of {results['repeats']} turns in ms; alone: mujoco.rollout",
        " " * 54 + "".join(f"{head:>11}" for head in (*heads.values(), *ratios.values(), "evaluate")),
    ]
    for name, result in results["settings"].items():
        cells = [f"{result['ms'][part]['median']:.2f}" if part in result["ms"] else "" for part in heads]
        cells += [f"{result[ratio]:.3f}" if ratio in result else "" for ratio in ratios]
        found.append(f"{name:54}" + "".join(f"{cell:>11}" for cell in (*cells, f"{result['evaluate_percent']:.1f} %")))
    return found


if __name__ == "__main__":
    main()
