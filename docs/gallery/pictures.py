"""The pictures of the gallery: strips of poses of solutions and of simulated robots, and figures."""

import json
import pickle
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import figures  # in this folder
import matplotlib
import numpy as np
from figures import Array, Picture
from PIL import Image, ImageDraw, ImageFont

from piaffe import models, ocp, sampling, simulation, solvers, viz
from piaffe.files import write_whole

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, KEPT = ROOT / "examples", ROOT / "build" / "gallery"
SIZE, COUNT, GAP = (188, 168), 5, 4
"""Width and height of a pose [pixels], number of poses in a strip, and the gap between them."""
LARGEST = 60_000
"""Size of a picture's file [bytes]."""
FONT = ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), 9)


def draw(name: str, path: Path) -> None:
    """Write the picture of an example.

    Args:
        name: name of the example's file, without suffix. One that is not in :data:`DRAWN` gets a strip of the solution
            of its ``problem``.
        path: the file, ``.jpg``.
    """
    viz.gl.prepare()  # before anything imports MuJoCo
    KEPT.mkdir(parents=True, exist_ok=True)
    if str(EXAMPLES) not in sys.path:
        sys.path.insert(0, str(EXAMPLES))  # some examples import others
    picture = DRAWN.get(name, solved)(name)
    for quality in (88, 80, 70, 60, 50):
        content = BytesIO()
        Image.fromarray(picture).save(content, format="JPEG", quality=quality, optimize=True)
        if len(content.getvalue()) <= LARGEST:
            break
    write_whole(path, content.getvalue())
    sys.stdout.write(f"{path.name}: {len(content.getvalue()) / 1000:.0f} kB, {picture.shape[1]} x {picture.shape[0]}\n")


def kept(name: str, make: Callable[[], Any]) -> Any:
    """Return what a function makes, and keep it in a file."""
    path = KEPT / f"{name}.pkl"
    if not path.exists():
        path.write_bytes(pickle.dumps(make()))
    return pickle.loads(path.read_bytes())


# ---- strips of solutions


def solved(
    name: str, times: Sequence[float] | int = COUNT, *, azimuth: float = 60.0, of: Callable[[Any], Any] | None = None
) -> Picture:
    """Return a strip of the solution of an example's problem.

    Args:
        name: name of the example.
        times: times of the poses [s], or their number.
        azimuth: direction of view about the vertical [degree].
        of: function of the example's module that returns the problem; by default ``problem``.
    """
    path = KEPT / f"{name}.npz"
    if not path.exists():
        module = import_module(name)
        problem: ocp.Problem = module.problem if of is None else of(module)
        solvers.MSiLQR(problem).solve().raise_if_failed().save(path)
    return viz.strip(solvers.Solution.load(path), times, size=SIZE, azimuth=azimuth)


def notebook(name: str) -> Picture:
    """Return a strip of the solution of a notebook, whose cells are run up to it."""
    names: dict[str, Any] = {"__name__": "__main__"}
    for cell in json.loads((EXAMPLES / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code" and "solution" not in names:
            exec(compile("".join(cell["source"]), name, "exec"), names)
    return viz.strip(names["solution"], COUNT, size=SIZE)


# ---- strips of episodes


def posed(
    name: str, robot: str, times: Sequence[float], run: Callable[[Any], Any], *, words: Sequence[str] = (),
    terrain: models.terrain.Terrain | None = None, azimuth: float = 60.0,
) -> Picture:  # fmt: skip
    """Return a strip of a robot on a plant.

    Args:
        name: name of the example.
        robot: name of the robot.
        times: times of the poses [s].
        run: function of the example's module that returns an episode.
        words: what to write beside the times.
        terrain: the ground.
        azimuth: direction of view about the vertical [degree].
    """

    def states() -> list[Array]:
        episode = run(import_module(name))
        return [np.array(episode.states[int(np.argmin(np.abs(episode.times - t)))]) for t in times]

    captions = [f"{t:.2f} s   {word}" for t, word in zip(times, words or [""] * len(times), strict=True)]
    return strip(models.load(robot), kept(name, states), captions, terrain, azimuth)


def strip(
    robot: models.Robot, states: Sequence[Array], captions: Sequence[str],
    terrain: models.terrain.Terrain | None = None, azimuth: float = 60.0,
) -> Picture:  # fmt: skip
    """Return pictures of states side by side, with a text on each."""
    pictures = []
    for x, caption in zip(states, captions, strict=True):
        image = Image.fromarray(viz.picture(robot, x, terrain=terrain, size=SIZE, azimuth=azimuth))
        ImageDraw.Draw(image).text((5, SIZE[1] - 5), caption, font=FONT, fill="#222222", anchor="ls")
        pictures += [np.asarray(image), np.full((SIZE[1], GAP, 3), 255, dtype=np.uint8)]
    return np.concatenate(pictures[:-1], axis=1)


def online(problem: ocp.Problem, plant: simulation.Plant, seconds: float) -> simulation.OnlineEpisode:
    """Return an episode of a receding horizon."""
    mpc = solvers.RecedingHorizon(problem)
    low = solvers.Vwbc(mpc.plan(problem.initial, 0.0), leave_out=("base.position x", "base.position y"))
    return simulation.run_online(mpc, low, plant, seconds=seconds)


def five_gaits(name: str) -> Picture:
    """Return a pose of each gait, at the highest place of the base after 2 s."""

    def states() -> list[Array]:
        module, found = import_module(name), []
        for gait in gaits:
            episode = online(getattr(module, gait), simulation.Plant(module.robot, friction=0.7), 2.6)
            late = episode.states[episode.times > 2.0]
            found.append(np.array(late[int(np.argmax(late[:, 2]))]))
        return found

    gaits = ("trot", "pace", "bound", "flying_trot", "pronk")
    return strip(models.load("mini_cheetah"), kept(name, states), [gait.replace("_", " ") for gait in gaits])


def learnt(module: Any, problem: ocp.Problem, value: str, **more: Any) -> Any:
    """Return TD-CD-MPPI with a value of an example."""
    return sampling.TDCDMPPI(problem, module.options, reward=module.reward, value=EXAMPLES / value, **more)


def climb(module: Any) -> Any:
    """Return an episode of ``stairs_mppi.py``."""
    return sampling.run_episode(learnt(module, module.problem, module.value, allow=("terrain", "p_max")), steps=400)


def in_a_run(name: str) -> Picture:
    """Return a strip of a motion within a run: before it, at three shares of its time, and after it."""
    module = import_module(name)
    declared: ocp.Problem = module.problem()
    begins, lasts = (piece.duration for piece in declared.motion.pieces[:2])
    times = (begins - 0.4, *(begins + share * lasts for share in (0.25, 0.40, 0.55)), begins + lasts + 0.6)
    return posed(name, "mini_cheetah", times, lambda module: module.run(declared, range(1), times[-1] + 0.5)[0])


DRAWN: dict[str, Callable[[str], Picture]] = {
    "notebook_tour": notebook,
    "own_robot": notebook,
    "barrel_roll": lambda name: solved(name, (0.12, 0.33, 0.47, 0.61, 0.80)),
    "backflip": lambda name: solved(name, (0.14, 0.36, 0.50, 0.64, 0.80)),
    "box_jump": lambda name: solved(
        name, (0.30, 0.75, 0.95, 1.20, 2.24), azimuth=75.0, of=lambda module: module.anymal_c()
    ),
    "stairs_trot": lambda name: solved(name, azimuth=75.0),
    "run_roll_run": lambda name: solved(
        name, (0.30, 0.85, 1.05, 1.25, 2.10), of=lambda module: module.problem()
    ),
    "gaits": lambda name: figures.contacts(import_module(name)),
    "randomised_mass": lambda name: figures.payloads(import_module(name)),
    "own_dynamics": lambda name: figures.heights(import_module(name)),
    "own_model_mpc": lambda name: figures.flights(kept(name, lambda: figures.fly(import_module(name)))),
    "train_value": lambda name: figures.learning(EXAMPLES / "solo12_trot.value"),
    "trot_mpc": lambda name: posed(
        name, "mini_cheetah", (0.10, 1.00, 3.00, 5.50, 7.00), lambda module: module.run(7.1),
        words=("", "", "0.5 m/s", "0.8 m/s", "turning"),
    ),
    "bound_mpc": lambda name: posed(
        name, "mini_cheetah", (2.30, 2.54, 2.65, 2.80, 3.60), lambda module: module.run(seconds=3.7),
        words=("", "pushed", "", "", ""),
    ),
    "gaits_mpc": five_gaits,
    "go2_mpc": lambda name: posed(
        name, "go2", (0.10, 0.80, 1.55, 2.30, 2.95),
        lambda module: online(module.problem, module.plants()["other"], 3.0),
    ),
    "roll_then_pace": lambda name: posed(
        name, "mini_cheetah", (0.30, 0.47, 0.62, 0.85, 2.50), lambda module: module.run(range(1))[0]
    ),
    "stairs_mpc": lambda name: posed(
        name, "mini_cheetah", (0.50, 1.60, 2.10, 2.60, 4.00), lambda module: module.run(seconds=4.1),
        terrain=import_module(name).grounds["stairs"], azimuth=75.0,
    ),
    "running_roll": in_a_run,
    "run_roll_run_mpc": in_a_run,
    "front_flip_run": in_a_run,
    "trot_pace_roll": lambda name: posed(
        name, "mini_cheetah", (1.00, 3.00, 6.00, 9.10, 11.50), lambda module: module.run(range(1))[0],
        words=("trot", "pace", "trot", "roll", "trot"),
    ),
    "trot_mppi": lambda name: posed(
        name, "solo12", (0.10, 0.70, 1.35, 1.90, 2.50),
        lambda module: sampling.run_episode(learnt(module, module.sampled_problem(), module.value), steps=130),
    ),
    "short_horizon": lambda name: posed(
        name, "solo12", (0.10, 0.70, 1.35, 1.90, 2.50),
        lambda module: sampling.run_episode(learnt(module, module.sampled_problem(), module.value), steps=130),
    ),
    "own_sampler": lambda name: posed(
        name, "solo12", (0.10, 0.70, 1.35, 1.90, 2.50),
        lambda module: sampling.run_episode(
            module.controllers["cem"](module.problem(), reward=module.reward), steps=130
        ),
    ),
    "stairs_mppi": lambda name: posed(
        name, "solo12", (0.50, 2.50, 4.20, 5.80, 7.60), climb,
        terrain=import_module("trot_mppi").terrains["stairs"], azimuth=75.0,
    ),
}  # fmt: skip
"""Name of an example → what draws it."""
