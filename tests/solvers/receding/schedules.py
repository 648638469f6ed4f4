"""Random problems for receding horizons: schedules, motions and numbers over a few structures.

Each motion of a structure begins with the same modes and resets in the same order. What follows has no others, so that
all motions of a structure share their compiled functions, and little compiles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from piaffe import models, ocp
from piaffe.models import base, feet, joints, stance
from tests import balls
from tests.problems import PLACE as ROPE_PLACE
from tests.problems import SPEED as ROPE_SPEED
from tests.problems import Rope

from .floater import ATTITUDE, PLACE, PUSH, SPEED, Floater

Rng = np.random.Generator
DT = (0.01, 0.02, 0.0125, 1 / 60, 0.004)
SHORTER = (1, 1, 2, 4)


class Kind(NamedTuple):
    """A structure: its models, terms, first phases, and what a phase after them may be.

    Args:
        models: of the parts of the horizon, in order.
        terms: objective and constraints.
        first: modes and options of the first phases, in order.
        target: returns a random target.
        initial: the first state.
    """

    models: tuple[ocp.ModelBase, ...]
    terms: tuple[ocp.Objective, ocp.Constraints]
    first: tuple[tuple[str, Mapping[str, Any]], ...]
    target: Callable[[Rng], Mapping[str, Any]]
    initial: np.ndarray


def _bounce(s: Any) -> Any:
    return {"vz": -0.6 * s.vz}


def _height(s: Any) -> Any:
    return s.z


def _slower(s: Any) -> Any:
    return {"speed": 0.5 * s.speed}


def _force(s: Any) -> Any:
    return s.force


def _push(s: Any) -> Any:
    return s.push


@cache
def kinds() -> dict[str, Kind]:
    """Return the structures of models of one's own, by name."""
    plain = balls.problem(ocp.Motion(balls.phase("a", 1.0)), balls.ball().over(0.1, dt=0.01))
    ball_terms = plain.objective, plain.constraints
    bounce, slower = ocp.reset(_bounce), ocp.reset(_slower)
    until = {"until": ocp.equality(_height, name="ground"), "reset": bounce}
    fall = (("fall", {}), ("slow", {}), ("fall", until), ("slow", {"reset": bounce}))
    rope = ocp.Objective(
        ocp.regularize("force", 0.02), ocp.track(ROPE_SPEED, 0.05), ocp.track(ROPE_PLACE, 4.0),
        ocp.track(ROPE_PLACE, 40.0, at="end"), ocp.regularize("tension", 1e-3),
    )  # fmt: skip
    rope_limits = ocp.Constraints(ocp.inequality(_force, lower=-30.0, upper=30.0, name="force limit"))
    floating = ocp.Objective(
        ocp.track(PLACE, (1.0, 2.0, 3.0)), ocp.track(ATTITUDE, 2.0), ocp.track(SPEED, 0.5),
        ocp.regularize(PUSH, 0.05), ocp.regularize("turn", 0.05), ocp.track(PLACE, 10.0, at="phase_end"),
    )  # fmt: skip
    pushes = ocp.Constraints(ocp.inequality(_push, lower=-40.0, upper=40.0, name="push limit"))
    floats = (("float", {}), ("rest", {}), ("float", {"reset": slower}), ("rest", {"reset": slower}))
    level = np.array([0.3, -0.2, 0.1, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    start = np.array([1.0, 0.0])

    def height(rng: Rng) -> Mapping[str, Any]:
        return {"z": float(rng.uniform(0.3, 1.5))}

    def hanging(rng: Rng) -> Mapping[str, Any]:
        return {"place": rng.uniform((-0.8, -0.9), (0.8, -0.3))}

    def place(rng: Rng) -> Mapping[str, Any]:
        return {
            "place": rng.uniform((-1, -1, 0), (1, 1, 0.4)),
            "attitude": rng.uniform((-0.4, -0.4, -3), (0.4, 0.4, 3)),
        }

    head, fine, tail = balls.ball("head"), balls.ball("fine"), balls.ball("coarse", cut=False)
    return {
        "ball": Kind((balls.ball("single"),), ball_terms, fall, height, start),
        "two balls": Kind((head, fine), ball_terms, fall, height, start),
        "tail": Kind((head, tail), ball_terms, fall[:2], height, start),
        "first uncut": Kind((tail, fine), ball_terms, fall[:2], height, start),
        "rope": Kind(
            (Rope(),), (rope, rope_limits), (("slack", {}), ("taut", {})), hanging, np.array([0.2, 0.1, 1, 0])
        ),
        "floater": Kind((Floater(),), (floating, pushes), floats, place, level),
        "two floaters": Kind((Floater("near"), Floater("far")), (floating, pushes), floats, place, level),
    }


def own_problem(name: str, rng: Rng) -> ocp.Problem:
    """Return a random problem of a structure."""
    kind = kinds()[name]
    dt = float(rng.choice(DT))
    steps = [dt]
    for _ in kind.models[1:]:
        steps.append(dt / float(rng.choice(SHORTER)) if name != "tail" else dt * float(rng.integers(1, 6)))
    if name == "first uncut":
        steps[0] = dt * float(rng.integers(1, 6))
        steps[1] = dt
    schedule = ocp.Schedule(())
    for model, step in zip(kind.models, steps, strict=True):
        schedule = schedule + model.over(int(rng.integers(1, 20)) * step, dt=step)
    number = iter(range(1000))

    def phase(mode: str, options: Mapping[str, Any], least: int = 1) -> ocp.Phase:
        length = int(rng.integers(least, 13)) * dt
        if rng.random() < 0.002:
            length += 0.37 * dt  # is refused
        return ocp.Phase(f"p{next(number)}", mode, length, kind.target(rng), **options)

    def more(count: int) -> list[ocp.Phase]:
        plain = [(mode, {k: v for k, v in options.items() if k != "until"}) for mode, options in kind.first]
        return [phase(*plain[int(rng.integers(len(plain)))]) for _ in range(count)]

    first = [phase(mode, options, 2) for mode, options in kind.first]
    first += [phase(kind.first[0][0], {})]
    shape = int(rng.integers(5))
    if shape == 0:
        motion = ocp.Motion(*first, *more(int(rng.integers(0, 6))))
    elif shape == 1:
        motion = ocp.Motion(*more(int(rng.integers(1, 5))), once=tuple(first), cyclic=True)
    elif shape == 2:
        motion = ocp.Motion(*first, cyclic=True)
    elif shape == 3:
        motion = ocp.Motion(*first, *more(2)) + ocp.Motion(*more(int(rng.integers(1, 4))), cyclic=True)
    else:
        tail = ocp.Motion(phase(kind.first[0][0], {}), cyclic=True)
        motion = (
            ocp.Motion(*first)
            + tail.cycles(int(rng.integers(1, 4)))
            + ocp.Motion(*more(1), phase(kind.first[0][0], {}))
        )
    noise = 0.05 * rng.standard_normal(kind.models[0].state.ndx)
    return ocp.Problem(motion, schedule, *kind.terms, initial=kind.models[0].state.np_plus(kind.initial, noise))


@cache
def quadruped() -> tuple[models.WholeBody, models.SingleRigidBody]:
    """Return the models of the robot."""
    robot = models.load("mini_cheetah")
    return models.WholeBody(robot), models.SingleRigidBody(robot)


@cache
def robot_terms() -> tuple[ocp.Objective, ocp.Constraints, ocp.Cost]:
    """Return objective, constraints of all joints, and the cost of the second model."""
    objective = ocp.Objective(
        ocp.track(base.position, weight=(0, 1, 30)), ocp.track(base.orientation, weight=(5, 2, 2)),
        ocp.track(base.linear_velocity, weight=2.0), ocp.track(base.angular_velocity, weight=1.0),
        ocp.track(joints.position, weight=1.0), ocp.track(joints.velocity, weight=0.05),
        ocp.regularize(joints.torque, weight=0.02), ocp.track(base.position, weight=(0, 1, 50), at="phase_end"),
        models.soft_landing(weight=0.1),
    )  # fmt: skip
    limits = ocp.Constraints(
        models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits(), models.foot_clearance(minimum=0.0)
    )
    return objective, limits, ocp.regularize(feet.force, weight=0.01)


GAITS = ("trot", "pace", "bound", "pronk", "walk", "flying_trot")


def hop(rng: Rng) -> ocp.Motion:
    """Return a random hop with keyframes."""
    stands = stance("FL FR HL HR")

    def place(height: float) -> ocp.Keyframe:
        x, y, yaw = rng.uniform((-0.05, -0.05, -0.2), (0.1, 0.05, 0.2))  # feet stay within reach
        return ocp.Keyframe(position=(x, y, height), rpy=(0, 0, yaw))

    lengths = 0.01 * rng.integers(4, 14, size=4)
    return ocp.Motion(
        ocp.Phase("push", stands, lengths[0], place(0.3)), ocp.Phase("lean", stance("HL HR"), lengths[1], place(0.3)),
        ocp.Phase("air", stance(""), lengths[2], place(0.28)), ocp.Phase("land", stands, lengths[3], place(0.26)),
    )  # fmt: skip


def gait(rng: Rng) -> ocp.Motion:
    """Return a random gait without end."""
    speed, sideways, yaw = rng.uniform((-0.3, -0.1, -0.5), (0.6, 0.1, 0.5))
    return getattr(models.gaits, str(rng.choice(GAITS)))(speed=speed, lateral_speed=sideways, yaw_rate=yaw)  # type: ignore[no-any-return]


def robot_problem(rng: Rng) -> ocp.Problem:
    """Return a random motion of a robot with a cascade of two models, or with one."""
    body, srb = quadruped()
    objective, limits, effort = robot_terms()
    shape = int(rng.integers(5))
    if shape == 0:
        motion = gait(rng)
    elif shape == 1:
        motion = hop(rng) + gait(rng)
    elif shape == 2:
        motion = gait(rng).cycles(int(rng.integers(1, 3))) + gait(rng)
    elif shape == 3:
        motion = gait(rng).cycles(1) + hop(rng) + gait(rng)
    else:
        motion = hop(rng) + hop(rng)
    head = body.over(0.01 * rng.integers(5, 25), dt=0.01)
    step = 0.01 * float(rng.choice((3, 5)))
    schedule = head.without(effort) + srb.over(step * rng.integers(1, 6), dt=step).without(limits)
    return ocp.Problem(motion, schedule, objective + effort, limits, initial=body.state(joints="stand"))
