"""Figures of the gallery, of examples whose idea a strip of poses does not show."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from piaffe import ocp, sampling, solvers

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC3E6B", "#7B5EA7", "#56B4E9", "#8C6D31", "#555555")

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]


def figure(height: float = 1.9) -> Figure:
    """Return an empty figure of the width of a strip, with a height [100 pixels]."""
    return Figure(figsize=(9.56, height), dpi=100, layout="constrained")


def painted(made: Figure) -> Picture:
    """Return a figure as a picture."""
    content = BytesIO()
    made.savefig(content, format="png", dpi=100)
    return np.asarray(Image.open(content).convert("RGB"))


def dress(axes: Any, title: str, x: str = "", y: str = "") -> None:
    """Set the texts of a diagram."""
    axes.set_title(title, loc="left", fontsize=9)
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=7.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#D9DDE3", linewidth=0.5)


def heights(module: Any) -> Picture:
    """Draw the heights of the ball and of the rocket of ``own_dynamics.py``."""
    made = figure()
    titles = {"problem": "The ball with a thruster", "launch": "The rocket, then its capsule"}
    for axes, (name, title) in zip(made.subplots(1, 2), titles.items(), strict=True):
        solution = solvers.MSiLQR(getattr(module, name)).solve().raise_if_failed()
        for part, colour in zip(solution.trajectory.phases, COLOURS, strict=False):
            axes.plot(part.times, part.states[:, 0], color=colour, label=part.name)
        dress(axes, title, "time [s]", "height [m]")
        axes.legend(fontsize=7.5, frameon=False)
    return painted(made)


def fly(module: Any) -> list[Array]:
    """Return the states of flights of the quadrotor of ``own_model_mpc.py``."""
    mpc = solvers.RecedingHorizon(module.problem)
    low = solvers.Riccati(mpc.plan(module.problem.initial, 0.0))
    return [module.run(mpc, low, module.start(seed), seconds=4.0) for seed in range(len(COLOURS))]


def flights(flown: list[Array]) -> Picture:
    """Draw flights in the plane, with the quadrotor every 0.2 s."""
    made = figure(3.0)
    axes = made.subplots()
    for states, colour in zip(flown, COLOURS, strict=True):
        axes.plot(states[:, 0], states[:, 1], color=colour, linewidth=0.8, alpha=0.7)
        for x, z, angle in states[:1500:100, :3]:
            arm = 0.17 * np.array([np.cos(angle), np.sin(angle)])
            axes.plot([x - arm[0], x + arm[0]], [z - arm[1], z + arm[1]], color=colour, linewidth=2.0)
    axes.plot(0, 0, "o", color="#222222", markersize=5)
    axes.set_aspect("equal")
    dress(axes, "Flights from random starts to a point, a quadrotor every 0.2 s", "x [m]", "z [m]")
    return painted(made)


def contacts(module: Any) -> Picture:
    """Draw the contacts of the gaits of ``gaits.py``."""
    made, feet = figure(2.5), module.robot.foot_names
    names = ("bound", "pace", "flying_trot", "pronk", "trot", "walk")
    for axes, name in zip(made.subplots(2, 3).ravel(), names, strict=True):
        for interval in getattr(module, name).motion.intervals():
            down = module.body.resolve(interval.phase.mode).feet
            for row in (feet.index(foot) for foot in down):
                axes.barh(row, interval.end - interval.start, left=interval.start, height=0.62, color=COLOURS[row])
        dress(axes, name.replace("_", " "))
        axes.set_yticks(range(len(feet)), feet)
        axes.invert_yaxis()
        axes.grid(visible=False)
    made.supxlabel("contacts over time [s]", fontsize=8)
    return painted(made)


def payloads(module: Any) -> Picture:
    """Draw torques by payload of the trot of ``randomised_mass.py``."""
    compiled = ocp.compile_problem(module.problem)
    nominal = solvers.MSiLQR(compiled).solve().raise_if_failed()
    loads = np.linspace(0.0, 3.0, 7)
    masses = np.tile(compiled.parameters["mini_cheetah.link_mass"], (len(loads), 1))
    masses[:, 0] += loads
    starts = np.tile(compiled.initial, (len(loads), 1))
    batch = solvers.solve_batch(compiled, starts, {"mini_cheetah.link_mass": masses}, warm_start=nominal)
    made = figure()
    left, right = made.subplots(1, 2, width_ratios=(2, 1))
    times = np.concatenate([part.times[:-1] for part in nominal.trajectory.phases])
    for controls, shade in zip(batch.controls, np.linspace(0.2, 1.0, len(loads)), strict=True):
        left.plot(times, np.abs(controls).max(axis=1), color=COLOURS[0], alpha=shade, linewidth=1.0)
    dress(left, "Largest torque of all joints; darker: more payload", "time [s]", "[Nm]")
    right.plot(loads, np.abs(batch.controls).max(axis=(1, 2)), "o-", color=COLOURS[1])
    dress(right, "Largest torque of the motion", "payload [kg]", "[Nm]")
    return painted(made)


def learning(value: Path) -> Picture:
    """Draw the curves of the value that ``train_value.py`` learns."""
    curves = sampling.load_value(value).record["curves"]
    made = figure()
    titles = {"mean_value": "Mean value over the data", "loss": "Mean square of the temporal difference"}
    for axes, (name, title), colour in zip(made.subplots(1, 2), titles.items(), COLOURS, strict=False):
        axes.plot(curves["update"], curves[name], color=colour)
        dress(axes, title, "updates of the network")
    return painted(made)
