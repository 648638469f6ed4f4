"""Compare exported controllers with Python in closed loop: torques bit by bit, and times of plans and ticks.

Each example is exported and built with the compiler and flags of the libraries in Python. For each seed, ``piaffe mpc``
runs an episode; then the same episode runs with the exported library. There planner and low level of Python get the
same states, and each call of one is timed beside that of the other. Both are called from Python; times are of the
thread. An episode has the commands of the example's ``COMMANDS``, and lasts until 2 s after the last one.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time
from types import ModuleType
from typing import Any

import numpy as np
from common import arguments, surroundings, tell
from numpy.typing import NDArray

from piaffe.cli.online import OnlineSetup
from piaffe.cli.online_settings import OnlineSettings
from piaffe.ocp import load_problems_file
from piaffe.simulation import parse_commands
from piaffe.solvers import export_controller

Array = NDArray[np.float64]

EXAMPLES = ("trot_mpc", "bound_mpc", "roll_then_pace", "trot_pace_roll")
AFTER = 2.0  # [s]
FOLDER = Path(__file__).parents[1] / "examples"


class SideBySide:
    """An exported controller as planner and low level of ``run_online``; those of Python do the same beside it.

    Args:
        mpc: the planner in Python.
        low: the low level in Python.
        controller: the exported controller.
    """

    def __init__(self, mpc: Any, low: Any, controller: Any) -> None:
        self._mpc, self._low, self._controller, self._began = mpc, low, controller, False
        self.period, self.initial = mpc.period, mpc.initial
        self.plans: list[tuple[float, float]] = []
        self.ticks: list[tuple[float, float]] = []
        """Times in Python and of the export [s]."""
        self.statuses: set[int] = set()

    def reset(self) -> None:
        """Begin anew."""
        self._mpc.reset()
        self._began = False

    def command(self, **values: Any) -> None:
        """Set commands of both."""
        self._mpc.command(**values)
        self.statuses.add(self._controller.command(**values))

    def plan(self, x: Array, t: float) -> Any:
        """Return the plan of Python; the export makes its own."""
        make = self._controller.plan if self._began else self._controller.reset
        (plan, seconds), (status, own) = (_timed(call, x, t) for call in (self._mpc.plan, make))
        if self._began:  # the first plan takes longer than others
            self.plans.append((seconds, own))
        self._began = True
        self.statuses.add(status)
        return plan

    def follow(self, plan: Any) -> None:
        """Follow a plan in Python; the export does so by itself."""
        self._low.follow(plan)

    def control(self, x: Array, t: float) -> Array:
        """Return the torques of the export."""
        (_, seconds), (output, own) = (_timed(call, x, t) for call in (self._low.control, self._controller.tick))
        self.ticks.append((seconds, own))
        self.statuses.add(output.status)
        return np.array(output.torque)


def _timed(call: Any, x: Array, t: float) -> tuple[Any, float]:
    began = thread_time()
    result = call(x, t)
    return result, thread_time() - began


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"exported_{path.stem}", path)
    assert spec is not None  # the export has written it
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def compared(name: str, seeds: int, seconds: float, folder: Path) -> dict[str, Any]:
    """Export an example, and return how many of its episodes are equal, and medians of times [ms, µs]."""
    file = str(FOLDER / f"{name}.py")
    problem, module = load_problems_file(file, quiet=True)
    command = getattr(module, "COMMANDS", "")
    last = max((each.time for each in parse_commands(command)), default=-np.inf)
    settings = OnlineSettings(seconds=max(seconds, last + AFTER), command=command)
    setup = OnlineSetup(problem, module.mpc, file=file, settings=settings, fall=getattr(module, "fall", None))
    setup.build()
    told: dict[str, Any] = {"seeds": seeds, "equal": 0, "ticks": 0, "faults": [], "statuses": []}
    plans: list[tuple[float, float]] = []
    ticks: list[tuple[float, float]] = []
    exported = export_controller(
        setup.declared, folder, name=name, options={**setup.options, "latency": setup.latency}, low=setup.low_level
    )
    subprocess.run(["make", "-s", "-C", str(folder), f"build/lib{name}.so"], check=True)
    controller = _module(folder / "python" / f"{name}.py").Controller()
    for seed in range(seeds):
        of_python = setup.run(seed)
        both = SideBySide(setup.mpc, exported.low, controller)
        episode = setup.episode(both, both, seed)
        same = np.array_equal(of_python.controls, episode.controls)
        told["equal"] += int(same)
        told["ticks"] += len(episode.controls)
        told["motions"] = [motion for _, motion in of_python.motions]
        told["faults"].append(str(episode.fault or ""))
        told["statuses"] = sorted({*told["statuses"], *both.statuses})
        plans += both.plans
        ticks += both.ticks
        print(f"{name}, seed {seed}: {'equal' if same else 'DIFFERENT'}", file=sys.stderr, flush=True)
    for what, times, scale in (("plan_ms", plans, 1e3), ("tick_us", ticks, 1e6)):
        python, own = np.median(scale * np.array(times), axis=0)
        told[what] = {"python": round(python, 3), "exported": round(own, 3), "ratio": round(own / python, 3)}
    return told


def main(
    seeds: int = 10,
    seconds: float = 3.0,
    examples: tuple[str, ...] = EXAMPLES,
    folder: Path | None = None,
    json: bool = False,
    save: bool = False,
) -> dict[str, Any]:
    """Print and return the comparison of each example."""
    if folder is None:
        with TemporaryDirectory() as made:
            return main(seeds, seconds, examples, Path(made), json, save)
    results: dict[str, Any] = {"benchmark": "exported", "seconds": seconds, "examples": {}}
    lines = [
        "torques of the exported library, and times of the thread: Python, export, ratio",
        f"{'':16}{'equal':>9}{'plan [ms]':>22}{'tick [us]':>22}",
    ]
    for name in examples:
        one = results["examples"][name] = compared(name, seeds, seconds, folder / name)
        times = "".join(
            f"{one[key]['python']:9.2f}{one[key]['exported']:7.2f}{one[key]['ratio']:6.2f}"
            for key in ("plan_ms", "tick_us")
        )
        lines.append(f"{name:16}{one['equal']:>3} of{one['seeds']:>3}{times}")
    results |= surroundings()
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    parser = arguments(__doc__ or "", 1)
    parser.add_argument("--seeds", type=int, default=10, help="episodes of each example")
    parser.add_argument("--seconds", type=float, default=3.0, help="duration of an episode [s]")
    parser.add_argument("--examples", nargs="+", default=EXAMPLES, help="names of files in examples/")
    parser.add_argument("--folder", type=Path, help="where the exports are, and stay; what is built there is used")
    given = vars(parser.parse_args())
    given.pop("repeats")
    main(**given)
