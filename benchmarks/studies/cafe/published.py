"""What the studies of the published results share: cost, schedules, plant, and results that are kept one by one.

From [Li2025CafeMpc]: schedules, terminal cost, rate of the plans, gains on joints, actuators and noise of the plant.
The running costs are those of ``examples/bound_mpc.py`` with the published weight of torques; ``trials.csv`` has what
was tried, on seeds from 500.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

from matplotlib import rc_context
from matplotlib.figure import Figure

from piaffe import models, ocp, simulation, solvers
from piaffe.codegen.cpu import this_cpu
from piaffe.files import write_whole
from piaffe.models import base, feet, joints
from piaffe.viz.figure import save_figure
from piaffe.viz.style import RC

HERE = Path(__file__).resolve().parent
PICTURES = HERE.parents[2] / "docs" / "assets"
GAITS: Mapping[str, Callable[..., ocp.Motion]] = {
    "pace": models.gaits.pace, "flying trot": models.gaits.flying_trot, "pronk": models.gaits.pronk,
    "bound": models.gaits.bound, "trot": models.gaits.trot,
}  # fmt: skip
SPEED = 0.5  # [m/s]
HEAD, HEAD_DT = 0.25, 0.01  # [s]
TAILS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 1.5, 2.0)  # [s]
TAIL_DTS = (0.05, 0.01)  # [s]
PERIOD, LATENCY, ITERATIONS = 0.03, 0.02, 4  # [s], [s], of a plan
NOISE = simulation.SensorNoise(orientation=0.003, angular_velocity=0.005)  # as published
LEAVE_OUT = ("base.position x", "base.position y")
LOSSES = {"rotors": True, "joint_damping": 0.01, "joint_friction": 0.2}  # [Nm s/rad], [Nm]


def swing(s: Any) -> Any:
    """Return 1 for feet in the air."""
    return 1 - s.feet.contact


def landing(s: Any) -> Any:
    """Return 1 for feet that touch down at the end of the phase."""
    return s.feet.landing


def terminal(at: Any = "running", factor: float = 1.0) -> ocp.Objective:
    """Return the published terminal cost, but that of feet.

    Args:
        at: where it counts.
        factor: of the weights; 1/dt in a running cost of one step.
    """
    return ocp.Objective(
        ocp.track(base.position, weight=(0, 0, factor), at=at),
        ocp.track(base.orientation, weight=factor, at=at),
        ocp.track(base.linear_velocity, weight=factor, at=at),
        ocp.track(base.angular_velocity, weight=factor, at=at),
        ocp.track(joints.position, weight=0.5 * factor, at=at),
        ocp.track(joints.velocity, weight=0.01 * factor, at=at),
    )


@cache
def declaration() -> dict[str, Any]:
    """Return robot, models and terms, which all problems share."""
    robot = models.load("mini_cheetah", **LOSSES)
    return {
        "robot": robot, "body": models.WholeBody(robot), "srb": models.SingleRigidBody(robot),
        "running": ocp.Objective(
            ocp.track(base.position, weight=(0, 0, 50)),
            ocp.track(base.orientation, weight=(2, 2, 1)),
            ocp.track(base.linear_velocity, weight=10.0),
            ocp.track(base.angular_velocity, weight=(2, 2, 1)),
            ocp.track(joints.position, weight=1.0),
            ocp.track(joints.velocity, weight=0.01),
            ocp.track(feet.position, weight=10.0, mask=swing),
            ocp.track(feet.velocity, weight=1.0, mask=swing),
            ocp.regularize(joints.torque, weight=0.1),
        ),
        "phase ends": terminal("phase_end") + ocp.Objective(
            ocp.track(feet.position, weight=(20, 20, 1) * 4, mask=landing, at="phase_end"),
            models.soft_landing(weight=1.0),
        ),
        "end": terminal("end"), "switch": terminal(factor=1 / HEAD_DT),
        "effort": ocp.track(feet.force, weight=0.008),
        "limits": ocp.Constraints(
            models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(),
            models.base_height(minimum=0.13), models.foot_clearance(minimum=0.0),
        ),
    }  # fmt: skip


def problem(gait: str, tail: float, tail_dt: float = 0.05, *, switch: bool = True) -> ocp.Problem:
    """Return the problem of a gait and a published schedule: 0.25 s of whole body, then a rigid body.

    Args:
        gait: name of the gait.
        tail: T_s, for which the rigid body is planned [s]; 0 for none.
        tail_dt: its time step [s].
        switch: whether the terminal cost also counts where the model changes, as it does in the published code. It is
            a running cost of the last step of the whole body.
    """
    of = declaration()
    body, objective = of["body"], of["running"] + of["phase ends"] + of["end"] + of["effort"]
    switch = switch and tail > 0
    own = (of["effort"], of["switch"]) if switch else (of["effort"],)
    schedule = body.over(HEAD - HEAD_DT * switch, dt=HEAD_DT).without(*own)
    if switch:
        schedule, objective = schedule + body.over(HEAD_DT, dt=HEAD_DT).without(of["effort"]), objective + of["switch"]
    if tail:
        schedule = schedule + of["srb"].over(tail, dt=tail_dt).without(of["limits"], of["phase ends"], *own[1:])
    motion = GAITS[gait](SPEED, velocity_gain=0.02)
    return ocp.Problem(motion, schedule, objective, of["limits"], initial=body.state(joints="stand"))


def planner(of: ocp.Problem) -> solvers.RecedingHorizon:
    """Return the receding horizon with the published rate."""
    return solvers.RecedingHorizon(of, period=PERIOD, iterations=ITERATIONS, latency=LATENCY)


def gains() -> solvers.JointPD:
    """Return the published gains on joints, a quarter of them in stance."""
    return solvers.JointPD(
        3.0, (1.0, 0.5, 0.5) * 4, in_stance=0.25, contact_of=declaration()["robot"].foot_of_joint
    )  # fmt: skip


def vwbc(plan: solvers.Plan) -> solvers.Vwbc:
    """Return the low level."""
    return solvers.Vwbc(plan, gains=gains(), leave_out=LEAVE_OUT)


def plant(seed: int) -> simulation.Plant:
    """Return the plant of a seed, which draws masses within 5 % and friction from 0.5 to 0.8."""
    robot = declaration()["robot"]
    drawn = simulation.Variation(noise=NOISE).numbers(simulation.Plant(robot).links, seed)
    return simulation.Plant(robot, actuators=simulation.mini_cheetah_actuators(), **drawn)


def episode(
    mpc: Any, low: Any, seed: int, seconds: float, pushes: Sequence[simulation.Push] = ()
) -> simulation.OnlineEpisode:
    """Return an episode of a seed, which also draws the first state and the noise."""
    on = plant(seed)
    start = simulation.Variation().start.around(on.model, mpc.initial, seed)
    return simulation.run_online(
        mpc, low, on, seconds=seconds, latency=LATENCY, seed=seed, initial=start, pushes=pushes
    )


class Runs:
    """Episodes of one problem, whose planner is made when the first one runs.

    Args:
        gait: name of the gait. tail: T_s [s]. tail_dt: dt_s [s].
    """

    def __init__(self, gait: str, tail: float, tail_dt: float = TAIL_DTS[0]) -> None:
        self.gait, self.tail, self.tail_dt = gait, tail, tail_dt

    @cached_property
    def mpc(self) -> solvers.RecedingHorizon:
        """The receding horizon."""
        return planner(problem(self.gait, self.tail, self.tail_dt))

    def __call__(
        self,
        seed: int,
        seconds: float,
        low: Callable[[solvers.Plan], Any] = vwbc,
        pushes: Sequence[simulation.Push] = (),
    ) -> simulation.OnlineEpisode:
        """Return the episode of a seed with a low level of its own."""
        self.mpc.reset()
        return episode(self.mpc, low(self.mpc.plan(self.mpc.initial, 0.0)), seed, seconds, pushes)


class Cells:
    """Results that are kept one by one, so that a study that was stopped goes on.

    Args:
        folder: where they lie, no part of the repository.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def get(self, key: str, make: Callable[..., Any], *of: Any) -> Any:
        """Return the result of a key, ``make(*of)`` if there is none; its file is written whole or not at all."""
        path = self.folder / f"{key.replace(' ', '-')}.json"
        if not path.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(path, json.dumps(make(*of)).encode())
        return json.loads(path.read_text(encoding="utf-8"))


def write_results(name: str, rows: Sequence[Mapping[str, Any]], **more: Any) -> None:
    """Write rows with the same names as CSV, and with machine and further numbers as JSON."""
    lines = [",".join(rows[0]), *(",".join(str(value) for value in row.values()) for row in rows)]
    print("\n".join(lines))
    write_whole(HERE / f"{name}.csv", ("\n".join(lines) + "\n").encode())
    here = {"processor": str(this_cpu()), "load": os.getloadavg()[0], "python": platform.python_version()}
    text = json.dumps({"rows": list(rows), **more, **here}, indent=1) + "\n"
    write_whole(HERE / f"{name}.json", text.encode())


def draw(name: str, fill: Callable[[Figure], None], size: tuple[float, float]) -> None:
    """Draw a figure into docs/assets/cafe_NAME.png."""
    with rc_context(RC):
        figure = Figure(figsize=size, layout="constrained")
        fill(figure)
        save_figure(figure, PICTURES / f"cafe_{name}.png", 100)
