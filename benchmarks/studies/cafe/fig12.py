"""Fig. 12 of [Li2025CafeMpc]: the hybrid kinodynamic baseline trots and rolls over, beside the whole body in a cascade.

Both follow the same references on the same random plants: a trot at 0.5 m/s, and a barrel roll that is followed by a
pace. An episode is a line of ``fig12.csv``; those that are there are not run again. Then the table and the figure are
made.

Usage: ``fig12.py [--seeds 20] [--first 0] [--choose]``. With ``--choose`` the candidates for the settings of the
baseline run on seeds from 500, into ``fig12_choice.csv``.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from piaffe import models, ocp, simulation, solvers, viz
from piaffe.models import base, feet, joints
from piaffe.ocp import rotation

HERE = Path(__file__).resolve().parent
PICTURE = HERE.parents[2] / "docs" / "assets" / "cafe_fig12.png"
sys.path.insert(0, str(HERE.parents[1]))
from common import example  # noqa: E402  # the folder is known only now

LATENCY, SPEED, SECONDS = 0.02, 0.5, 4.0  # [s], [m/s], [s]
MOTIONS = ("trot", "roll")


@dataclass(frozen=True)
class Settings:
    """Settings of the kinodynamic controller; one set for both motions.

    Args:
        objective: ``"ours"``: that of ``examples/roll_then_pace.py``, without torques; ``"published"``: the baseline's;
            ``"published, one end"``: its weights of phase ends count at the end of the horizon alone.
        force: weight of the contact forces against those of the reference.
        iterations: of a plan.
        mu: friction coefficient of the plan.
        kp, kd: gains of the low level [Nm/rad], [Nm s/rad].
        in_stance: their factor on the ground.
    """

    objective: str = "ours"
    force: float = 0.002
    iterations: int = 4
    mu: float = 0.6
    kp: float = 40.0
    kd: Any = 1.0
    in_stance: float = 1.0


GAINS: dict[str, Any] = {"kp": 3.0, "kd": (1.0, 0.5, 0.5) * 4, "in_stance": 0.25}  # published, for the whole body
FIRST = Settings()
PUBLISHED = Settings("published", force=0.1, iterations=2, mu=0.7)
CANDIDATES = {
    "40": FIRST,
    "20": replace(FIRST, kp=20.0, kd=0.5),
    "40 force 0.0005": replace(FIRST, force=0.0005),
    "20 a quarter": replace(FIRST, kp=20.0, kd=0.5, in_stance=0.25),
    "published 40": PUBLISHED,
    "published 3 a quarter": replace(PUBLISHED, **GAINS),
    "published 40 force 0.01": replace(PUBLISHED, force=0.01),
    "published 40 force 0.001": replace(PUBLISHED, force=0.001),
    "published 40 force 0.001, 4 iterations": replace(PUBLISHED, force=0.001, iterations=4),
    "published 40 force 0.001, 10 iterations": replace(PUBLISHED, force=0.001, iterations=10),
    "published one end 40 force 0.001, 4 iterations": replace(
        PUBLISHED, objective="published, one end", force=0.001, iterations=4
    ),
    "3 a quarter force 0.0005": replace(FIRST, force=0.0005, **GAINS),
}
CHOSEN = CANDIDATES["40 force 0.0005"]
CONTROLLERS = {
    "whole body": None,
    "kinodynamic": CHOSEN,
    "kinodynamic, soft joints": replace(CHOSEN, **GAINS),
    "kinodynamic, published weights": CANDIDATES["published 40 force 0.001"],
}
STRIP = (0.10, 0.30, 0.45, 0.60, 0.75, 0.90, 1.05, 2.00)  # [s]


@cache
def ours() -> Any:
    """Return ``examples/roll_then_pace.py``."""
    return example("roll_then_pace")


@cache
def gaits() -> Any:
    """Return ``examples/gaits_mpc.py``."""
    return example("gaits_mpc")


@cache
def path() -> ocp.Motion:
    """Return the path of the roll, the whole body's, with the places of its feet: both controllers follow it."""
    given, body = ours(), ours().body
    calm = ocp.regularize(joints.torque, weight=0.03)
    alone = ocp.Problem(
        given.roll, body.until_end(dt=0.01), given.objective + calm, given.limits, initial=body.state(joints="stand")
    )
    trajectory = solvers.MSiLQR(alone).solve().raise_if_failed().trajectory
    parts = []
    for part in trajectory.phases:
        at = part.states[:-1]
        places = body.kinematics.world_feet(at[:, :3], at[:, 3:7], at[:, 7:19]).reshape(len(at), -1)
        parts.append(replace(part, outputs={**part.outputs, feet.position: places}))
    return ocp.Motion.from_trajectory(replace(trajectory, phases=tuple(parts)))


def on_ground(s: Any) -> Any:
    """Return 1 for feet on the ground, 0 for feet in the air."""
    return s.feet.contact


def joints_in_air(s: Any) -> Any:
    """Return 1 for the joints of feet in the air, 0 for others; three joints a leg."""
    import casadi as cs

    return cs.vec(cs.repmat(1 - cs.SX(s.feet.contact).T, 3, 1))


def published(force: float, at: Any) -> ocp.Objective:
    """Return the baseline's weights; its foothold is relative to the base, here to the frame of the plan.

    A plan's frame begins at the measured base. Weights at ends have no time step.

    Args:
        force: weight of the contact forces.
        at: where the weights of ends count: ``"phase_end"`` or ``"end"``, that of the horizon.
    """
    return ocp.Objective(
        ocp.track(base.orientation, weight=(4, 4, 1)),
        ocp.track(base.position, weight=(1, 1, 30)),
        ocp.track(base.angular_velocity, weight=(1, 0.5, 0.2)),
        ocp.track(base.linear_velocity, weight=1.0),
        ocp.track(joints.position, weight=0.1, mask=joints_in_air),
        ocp.track(feet.position, weight=(100, 100, 0) * 4, mask=on_ground),
        ocp.track(base.orientation, weight=(160, 80, 20), at=at),
        ocp.track(base.position, weight=(20, 20, 12000), at=at),
        ocp.track(base.angular_velocity, weight=(20, 2, 0.4), at=at),
        ocp.track(base.linear_velocity, weight=20.0, at=at),
        ocp.track(feet.position, weight=(2000, 2000, 0) * 4, mask=on_ground, at=at),
        ocp.track(feet.force, weight=force),
        ocp.regularize(joints.commanded_velocity, weight=0.1),
    )


def same_as_ours(force: float) -> ocp.Objective:
    """Return the objective of the whole body without torques, with costs on what the baseline commands."""
    kept = [term for term in ours().objective if term.name != "regularize joints.torque"]
    return ocp.Objective(
        *kept,
        ocp.track(base.linear_velocity, weight=9.0, name="follow"),
        ocp.track(feet.force, weight=force),
        ocp.regularize(joints.commanded_velocity, weight=0.001),
    )


def baseline(motion: str, settings: Settings) -> tuple[ocp.Problem, models.HybridKinodynamic]:
    """Return the problem of the baseline, and its model: a horizon of 0.6 s in steps of 10 ms, as published."""
    model = models.HybridKinodynamic(ours().robot)
    ends = {"published": "phase_end", "published, one end": "end"}.get(settings.objective)
    objective = published(settings.force, ends) if ends else same_as_ours(settings.force)
    limits = ocp.Constraints(
        models.friction_cone(mu=settings.mu), models.joint_limits(), models.joint_speed_limits(),
        models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
    )  # fmt: skip
    declared = path() + ours().pace if motion == "roll" else models.gaits.trot(**gaits().COMMAND)
    schedule = model.over(0.6, dt=0.01)
    return ocp.Problem(declared, schedule, objective, limits, initial=model.state(joints="stand")), model


Low = Callable[[simulation.Plant], tuple[Any, Any]]


@cache
def controller(motion: str, settings: Settings | None) -> Low:
    """Return a function of a plant that returns a planner and a low level; a plan is made every 20 ms."""
    if settings is None:
        problem = ours().problem() if motion == "roll" else gaits().trot
        options = dict(ours().mpc) if motion == "roll" else {"latency": LATENCY}
        mpc = solvers.RecedingHorizon(problem, **options)

        def whole(plant: simulation.Plant) -> tuple[Any, Any]:
            mpc.reset()
            leave_out = ("base.position x", "base.position y")
            return mpc, solvers.Vwbc(mpc.plan(problem.initial, 0.0), leave_out=leave_out)

        return whole
    declared, model = baseline(motion, settings)
    planner = solvers.RecedingHorizon(declared, latency=LATENCY, iterations=settings.iterations)

    def kinodynamic(plant: simulation.Plant) -> tuple[Any, Any]:
        planner.reset()
        low = simulation.ForcesAndJoints(
            model, planner.plan(declared.initial, 0.0), plant.space, kp=settings.kp, kd=settings.kd,
            in_stance=settings.in_stance,
        )  # fmt: skip
        return simulation.PartOfState(planner, model.state, plant.space), low

    return kinodynamic


def run(motion: str, settings: Settings | None, seed: int) -> simulation.OnlineEpisode:
    """Run an episode on the random plant of a seed."""
    robot, drawn, initial = ours().robot, simulation.Variation(), ours().body.state(joints="stand")
    plant = simulation.Plant(robot, **drawn.numbers(simulation.Plant(robot).links, seed))
    start = drawn.start.around(plant.model, initial, seed)
    planner, low = controller(motion, settings)(plant)
    fall = ours().fall if motion == "roll" else None
    return simulation.run_online(
        planner, low, plant, seconds=SECONDS, latency=LATENCY, seed=seed, initial=start, fall=fall
    )


def figures(motion: str, episode: simulation.OnlineEpisode) -> dict[str, Any]:
    """Return what is kept of an episode.

    It is a success if the robot does not fall, is upright at the end, and has at least 0.8 of the commanded speed in
    the last second. ``apart`` is the smallest distance to the left of a left foot from the right one beside it, in the
    axes of the base: below zero, legs cross.
    """
    last = episode.tracking(3.0)
    speed = float(last.velocity[0]) if last is not None and not episode.fell else float("nan")
    states = episode.states
    places = ours().body.kinematics.feet(states[:, 7:19])
    apart = np.minimum(places[:, 0, 1] - places[:, 1, 1], places[:, 2, 1] - places[:, 3, 1])
    up = rotation.np_matrix(states[:, 3:7])[:, 2, 2]
    parts = " ".join(f"{name}@{at:.2f}" for name, at in episode.collisions.items())
    return {
        "success": int(episode.success and speed >= 0.8 * SPEED), "end_s": round(episode.end, 3),
        "fault": episode.fault, "upright": int(episode.upright), "speed_m_per_s": round(speed, 4),
        "apex_m": round(float(states[:, 2].max()), 4), "apart_m": round(float(apart.min()), 4),
        "least_up": round(float(up.min()), 3), "other_contacts": parts,
        "limited": round(float(np.mean(np.any(episode.limited, axis=1))), 4),
        "slip_mean_m_per_s": round(float(np.nanmean(episode.slips)), 4),
        "plan_ms": round(1e3 * float(np.median(episode.plans.seconds)), 3),
    }  # fmt: skip


def rows(file: Path) -> list[dict[str, str]]:
    """Return the lines of a file of episodes."""
    if not file.exists():
        return []
    with file.open() as stream:
        return list(csv.DictReader(stream))


def study(file: Path, controllers: dict[str, Settings | None], seeds: range) -> Iterator[dict[str, Any]]:
    """Run the episodes that a file lacks, and add a line for each."""
    known = {(row["motion"], row["controller"], int(row["seed"])) for row in rows(file)}
    for name, settings in controllers.items():
        for motion in MOTIONS:
            for seed in seeds:
                if (motion, name, seed) in known:
                    continue
                found = figures(motion, run(motion, settings, seed))
                row = {"motion": motion, "controller": name, "seed": seed, **found}
                new = not file.exists()
                with file.open("a", newline="") as stream:
                    writer = csv.DictWriter(stream, list(row), lineterminator="\n")
                    if new:
                        writer.writeheader()
                    writer.writerow(row)
                yield row


def table(found: list[dict[str, str]]) -> str:
    """Return the table of the judged episodes."""
    head = (
        "motion", "controller", "successes", "falls", "legs cross", "knees or base touch", "median speed [m/s]",
        "median apex [m]", "least distance of legs, median [m]", "ticks at a torque limit", "plan [ms]",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for motion in MOTIONS:
        for name in CONTROLLERS:
            own = [row for row in found if (row["motion"], row["controller"]) == (motion, name)]
            if not own:
                continue
            speeds = [float(row["speed_m_per_s"]) for row in own if row["speed_m_per_s"] != "nan"]
            middle = {
                key: float(np.median([float(row[key]) for row in own])) for key in ("apex_m", "apart_m", "plan_ms")
            }
            counts = (
                sum(int(row["success"]) for row in own), sum(bool(row["fault"]) for row in own),
                sum(float(row["apart_m"]) < 0 for row in own), sum(bool(row["other_contacts"]) for row in own),
            )  # fmt: skip
            cells = (
                motion, name, *(f"{count} of {len(own)}" for count in counts),
                f"{np.median(speeds):.3f}" if speeds else "–", f"{middle['apex_m']:.3f}", f"{middle['apart_m']:.3f}",
                f"{100 * np.mean([float(row['limited']) for row in own]):.1f} %", f"{middle['plan_ms']:.1f}",
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def figure(seed: int = 0) -> None:
    """Draw the rolls of a seed as film strips, one below the other, into ``docs/assets/cafe_fig12.png``."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from PIL import Image

    drawn, axes = plt.subplots(len(CONTROLLERS), len(STRIP), figsize=(1.5 * len(STRIP), 1.35 * len(CONTROLLERS)))
    for line, (name, settings) in zip(axes, CONTROLLERS.items(), strict=True):
        episode = run("roll", settings, seed)
        for ax, t in zip(line, STRIP, strict=True):
            ax.set_axis_off()
            if t > episode.end and episode.fault:
                continue
            state = episode.states[np.searchsorted(episode.times, t - 1e-9).clip(0, len(episode.times) - 1)]
            ax.imshow(viz.picture(ours().robot, state, size=(320, 240), azimuth=180.0, distance=1.35))
            ax.set_title(f"{t:.2f} s", fontsize=7, loc="left", pad=2)
        fell = f", falls at {episode.end:.2f} s" if episode.fault else ""
        line[0].text(0, -34, f"{name}{fell}", fontsize=8, fontweight="bold")
    drawn.subplots_adjust(left=0.005, right=0.995, top=0.93, bottom=0.005, wspace=0.03, hspace=0.3)
    drawn.savefig(PICTURE, dpi=110)
    plt.close(drawn)
    with Image.open(PICTURE) as picture:
        small = picture.convert("RGB").quantize(96)
    small.save(PICTURE, optimize=True)


def main() -> None:
    """Run what is missing, and make the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--choose", action="store_true")
    given = parser.parse_args()
    viz.gl.prepare()  # before MuJoCo is imported
    if given.choose:
        for row in study(HERE / "fig12_choice.csv", dict(CANDIDATES), range(500, 500 + given.seeds)):
            print(row, flush=True)
        return
    for row in study(HERE / "fig12.csv", CONTROLLERS, range(given.first, given.first + given.seeds)):
        print(row, flush=True)
    (HERE / "fig12.md").write_text(table(rows(HERE / "fig12.csv")))
    figure()


if __name__ == "__main__":
    main()
