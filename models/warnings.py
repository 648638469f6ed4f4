"""Warnings about keyframes that a robot cannot reach, hold or fly between; they do not stop a solve."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from piaffe.ocp import Keyframes, Path, PlacedPhase, ProblemWarning, Sample, placed_phases

from .postures import SHORT_NAMES
from .quantities import base, joints
from .robot import Robot, to_pinocchio
from .stance import Stance

Array = NDArray[np.float64]

OFF_GROUND = 0.02
"""How far above or below the ground a keyframe may hold a foot that stands [m]."""
OFF_FLIGHT = 0.02
"""How far from a ballistic flight a keyframe may hold the centre of mass [m]."""

_POSE = {name for name in SHORT_NAMES if name in ("position", "rpy", "joints")}
_POSE |= {SHORT_NAMES[name].path for name in _POSE}


@dataclass(frozen=True, eq=False)
class Knot:
    """A keyframe in its place.

    Args:
        interval: the phase that it ends.
        sample: the path there.
        stance: feet on the ground in the phase.
        landing: feet that come to the ground in the next phase.
        named: what the keyframe names.
    """

    interval: PlacedPhase
    sample: Sample
    stance: tuple[str, ...]
    landing: tuple[str, ...]
    named: frozenset[str]

    @property
    def where(self) -> str:
        """The keyframe's phase and place in the user's file."""
        phase = self.interval.phase
        return f"phase '{phase.name}' ({phase.source}), keyframe"

    @property
    def has_pose(self) -> bool:
        """Whether the keyframe says anything of the posture, and the path knows all of it."""
        return bool(self.named & _POSE) and joints.position in self.sample


def keyframe_warnings(robot: Robot, resolve: Callable[[Hashable], Stance], path: Path) -> list[ProblemWarning]:
    """Return warnings about the keyframes of a motion; pieces that follow another reference have none.

    Args:
        robot: the robot.
        resolve: turns a phase's mode into the feet on the ground.
        path: the motion's path.
    """
    knots = list(_knots(resolve, path))
    found: list[ProblemWarning] = []
    for knot in knots:
        if knot.has_pose:
            found += _limits(robot, knot)
            found += _feet(robot, knot)
            found += _torques(robot, knot)
    return found + list(_flights(robot, path, knots))


def _knots(resolve: Callable[[Hashable], Stance], path: Path) -> Iterator[Knot]:
    """Yield every phase that has keyframes for a reference, of an endless motion those of one cycle."""
    intervals = placed_phases(path.pieces)
    count = sum(len(piece.phases) for piece in path.pieces)
    laid = [next(intervals) for _ in range(count)]
    for interval, following in zip(laid, [*laid[1:], None], strict=True):
        if not isinstance(path.pieces[interval.piece].reference, Keyframes):
            continue
        feet = resolve(interval.phase.mode).feet
        landing = set(resolve(following.phase.mode).feet) - set(feet) if following else set()
        target = interval.phase.target
        yield Knot(
            interval,
            path.sample(interval.end, interval),
            feet,
            tuple(sorted(landing)),
            frozenset(target.values) if target else frozenset(),
        )


# ---- one keyframe


def _limits(robot: Robot, knot: Knot) -> Iterator[ProblemWarning]:
    """Yield joints that are beyond their limits."""
    angles = knot.sample[joints.position]
    beyond = np.flatnonzero((angles < robot.joint_lower - 1e-6) | (angles > robot.joint_upper + 1e-6))
    if len(beyond) and knot.named & {"joints", joints.position.path}:
        got = ", ".join(f"{robot.joint_names[i]} at {angles[i]:.3f} rad" for i in beyond)
        allowed = ", ".join(f"{robot.joint_lower[i]:.3f} to {robot.joint_upper[i]:.3f} rad" for i in beyond)
        yield ProblemWarning(knot.where, f"joint beyond its limit - got {got}, expected {allowed}; bend it less")


def _feet(robot: Robot, knot: Knot) -> Iterator[ProblemWarning]:
    """Yield feet that stand or land but are held off the ground."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, _configuration(robot, knot.sample)[0])
    for names, what in ((knot.stance, "stance"), (knot.landing, "landing")):
        frames = {name: robot.frame_id(robot.foot(name).frame) for name in names}
        heights = {name: float(data.oMf[i].translation[2]) - robot.foot_radius for name, i in frames.items()}
        off = {name: height for name, height in heights.items() if abs(height) > OFF_GROUND}
        if off:
            got = ", ".join(f"{name} {abs(h):.3f} m {'above' if h > 0 else 'below'} it" for name, h in off.items())
            yield ProblemWarning(
                knot.where,
                f"{what} foot held off the ground - got {got}, expected within {OFF_GROUND} m; move the base or bend "
                "the leg",
            )


def _torques(robot: Robot, knot: Knot) -> Iterator[ProblemWarning]:
    """Yield joints that cannot hold the pose still, whatever the distribution of forces among the feet."""
    if not knot.stance:
        return
    torque = static_torques(robot, _configuration(robot, knot.sample)[0], knot.stance)
    beyond = np.flatnonzero(np.abs(torque) > robot.torque_limit)
    if len(beyond):
        got = ", ".join(f"{robot.joint_names[i]} {abs(torque[i]):.1f} Nm" for i in beyond)
        allowed = ", ".join(f"{robot.torque_limit[i]:.1f} Nm" for i in beyond)
        yield ProblemWarning(
            knot.where,
            f"static torque beyond the limit - got {got} to hold still on {' '.join(knot.stance)}, expected at most "
            f"{allowed}; straighten the legs or put more feet on the ground",
        )


def static_torques(robot: Robot, q: Array, feet: tuple[str, ...]) -> Array:
    """Return joint torques that carry the robot at rest, (n,) [Nm].

    Forces balance exactly and moments as far as the feet allow; among the distributions over the feet the one with
    the least torque relative to the limits is taken.

    Args:
        robot: the robot.
        q: pinocchio's configuration.
        feet: names of the feet that carry.
    """
    data = robot.model.createData()
    weight = pin.computeGeneralizedGravity(robot.model, data, q)
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    frames = [robot.frame_id(robot.foot(name).frame) for name in feet]
    J = np.vstack([
        pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3] for frame in frames
    ])  # fmt: skip
    scale = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])  # forces before moments
    balance = scale[:, None] * J[:, :6].T
    force = np.linalg.lstsq(balance, scale * weight[:6], rcond=None)[0]
    _, sizes, directions = np.linalg.svd(balance)
    free = directions[int(np.sum(sizes > 1e-9 * sizes[0])) :].T
    share = 1 / robot.torque_limit[:, None]  # zero for a joint without a limit
    if free.size:
        at_first = weight[6:] - J[:, 6:].T @ force
        force = force + free @ np.linalg.lstsq(share * (J[:, 6:].T @ free), share[:, 0] * at_first, rcond=None)[0]
    return np.asarray(weight[6:] - J[:, 6:].T @ force)


# ---- several keyframes


def _flights(robot: Robot, path: Path, knots: list[Knot]) -> Iterator[ProblemWarning]:
    """Yield keyframes that lie off the flight which the others of the same time in the air have left to choose.

    Between two keyframes there is always a flight; a third, or a velocity that is given, leaves none to choose.
    """
    airborne: list[Knot] = []
    for i, knot in enumerate(knots):
        following = knots[i + 1] if i + 1 < len(knots) else None
        if knot.stance:
            continue
        airborne.append(knot)
        if following is None or following.stance or following.interval.start != knot.interval.end:
            yield from _flight(robot, path, airborne)
            airborne = []


def _flight(robot: Robot, path: Path, airborne: list[Knot]) -> Iterator[ProblemWarning]:
    """Yield what is off one flight over consecutive phases without contact."""
    first = airborne[0].interval
    knots = [knot for knot in airborne if knot.named & _POSE]
    began = path.sample(first.start, first)
    gravity = robot.model.gravity.linear
    times = np.array([0.0] + [knot.interval.end - first.start for knot in knots])
    states = [_configuration(robot, sample) for sample in (began, *(knot.sample for knot in knots))]
    # where each centre of mass would be without gravity: one straight line
    places = np.array([_com(robot, *state)[0] for state in states]) - 0.5 * times[:, None] ** 2 * gravity
    given = [(0.0, places[0], velocity) for velocity in [_take_off(robot, path, first)] if velocity is not None]
    for knot, t, place, state in zip(knots, times[1:], places[1:], states[1:], strict=True):
        if knot.named & {"linear_velocity", base.linear_velocity.path}:
            given.append((float(t), place, _com(robot, *state)[1] - t * gravity))
    if given:
        t0, place, velocity = given[0]
    elif len(knots) > 1:
        t0, place, velocity = 0.0, places[0], (places[-1] - places[0]) / times[-1]
    else:
        return
    line = place + (times - t0)[:, None] * velocity
    missed = places - line
    worst = int(np.argmax(np.abs(missed[:, 2])))
    if abs(missed[worst, 2]) > OFF_FLIGHT:
        knot = knots[worst - 1] if worst else knots[0]
        actual = places[worst, 2] + 0.5 * times[worst] ** 2 * gravity[2]
        side = "high" if missed[worst, 2] > 0 else "low"
        yield ProblemWarning(
            knot.where,
            f"no ballistic flight joins the keyframes - got a height of {actual:.3f} m for the centre of mass after "
            f"{times[worst]:.3f} s in the air, expected {actual - missed[worst, 2]:.3f} m: "
            f"{abs(missed[worst, 2]):.3f} m too {side}; move the keyframe or change the durations",
        )


def _take_off(robot: Robot, path: Path, first: PlacedPhase) -> Array | None:
    """Return the velocity of the centre of mass at the beginning of a flight if it is given, (3,) [m/s]."""
    if first.start == 0.0:
        start = getattr(path.placed[0].reference, "start", {})
        return _com(robot, *_configuration(robot, start))[1] if base.linear_velocity in start else None
    before = path.interval_before(first.start)
    target = before.phase.target
    if target is None or not {"linear_velocity", base.linear_velocity.path} & set(target.values):
        return None
    return _com(robot, *_configuration(robot, path.sample(before.end, before)))[1]


def _configuration(robot: Robot, sample: Sample) -> tuple[Array, Array]:
    """Return pinocchio's q and v of a sample; without joints the robot stands."""
    resting = {
        joints.position: robot.pose("stand"),
        joints.velocity: np.zeros(robot.num_joints),
        base.linear_velocity: np.zeros(3),
        base.angular_velocity: np.zeros(3),
    }
    order = (base.position, base.orientation, joints.position, base.linear_velocity, base.angular_velocity)
    full = {**resting, **sample}
    return to_pinocchio(np.concatenate([np.asarray(full[quantity]) for quantity in (*order, joints.velocity)]))


def _com(robot: Robot, q: Array, v: Array) -> tuple[Array, Array]:
    """Return position [m] and velocity [m/s] of the centre of mass, (3,) each."""
    data = robot.model.createData()
    pin.centerOfMass(robot.model, data, q, v)
    return np.array(data.com[0]), np.array(data.vcom[0])
