"""Warnings about keyframes that a robot cannot reach or hold, or that no ballistic flight joins.

A warning does not stop a solve.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from piaffe.ocp import Keyframes, Path, PlacedPhase, ProblemWarning, Sample, placed_phases

from .ground_warnings import OFF_GROUND, feet_off_ground
from .postures import SHORT_NAMES
from .quantities import base, joints
from .robot import Robot, to_pinocchio
from .stance import Stance
from .terrain import Flat, Terrain

Array = NDArray[np.float64]

OFF_FLIGHT = 0.02
"""Largest distance of the centre of mass from a ballistic flight in a keyframe without a warning [m]."""

_WEAK = 1e-3  # [Nm], limit of a passive joint when torques are shared

_POSE = {name for name in SHORT_NAMES if name in ("position", "rpy", "joints")}
_POSE |= {SHORT_NAMES[name].path for name in _POSE}


@dataclass(frozen=True, eq=False)
class PlacedKeyframe:
    """A keyframe and its place in the motion.

    Args:
        placed: the phase that ends at the keyframe.
        sample: the path at the keyframe.
        stance: feet on the ground in the phase.
        landing: feet that touch down at the beginning of the next phase.
        named: the names of the keyframe's entries.
    """

    placed: PlacedPhase
    sample: Sample
    stance: tuple[str, ...]
    landing: tuple[str, ...]
    named: frozenset[str]

    @property
    def where(self) -> str:
        """The keyframe's phase and its place in the user's file."""
        phase = self.placed.phase
        return f"phase '{phase.name}' ({phase.source}), keyframe"

    @property
    def has_pose(self) -> bool:
        """Whether the keyframe has an entry of the posture, and the path has all of the posture."""
        return bool(self.named & _POSE) and joints.position in self.sample


def keyframe_warnings(
    robot: Robot, terrain: Terrain, resolve: Callable[[Hashable], Stance], path: Path
) -> list[ProblemWarning]:
    """Return warnings about the keyframes of a motion; pieces with another reference have none.

    Args:
        robot: the robot.
        terrain: the ground.
        resolve: function that returns the feet on the ground in a phase's mode.
        path: the motion's path.
    """
    keyframes = list(_placed_keyframes(resolve, path))
    warnings: list[ProblemWarning] = []
    for keyframe in keyframes:
        if keyframe.has_pose:
            warnings += _limits(robot, keyframe)
            warnings += _feet(robot, terrain, keyframe)
            warnings += _torques(robot, keyframe)
    return warnings + (list(_flights(robot, path, keyframes)) if robot.base == "free" else [])


def _placed_keyframes(resolve: Callable[[Hashable], Stance], path: Path) -> Iterator[PlacedKeyframe]:
    """Yield the keyframe of every phase whose reference is keyframes; of a cyclic motion those of one cycle."""
    phases = placed_phases(path.pieces)
    count = sum(len(piece.phases) for piece in path.pieces)
    first = [next(phases) for _ in range(count)]
    for placed, following in zip(first, [*first[1:], None], strict=True):
        if not isinstance(path.pieces[placed.piece].reference, Keyframes):
            continue
        feet = resolve(placed.phase.mode).feet
        landing = set(resolve(following.phase.mode).feet) - set(feet) if following else set()
        target = placed.phase.target
        yield PlacedKeyframe(
            placed,
            path.sample(placed.end, placed),
            feet,
            tuple(sorted(landing)),
            frozenset(target.values) if target else frozenset(),
        )


# ---- one keyframe


def _limits(robot: Robot, keyframe: PlacedKeyframe) -> Iterator[ProblemWarning]:
    """Yield joints that are beyond their limits."""
    angles = keyframe.sample[joints.position]
    beyond = np.flatnonzero((angles < robot.joint_lower - 1e-6) | (angles > robot.joint_upper + 1e-6))
    if len(beyond) and keyframe.named & {"joints", joints.position.path}:
        got = ", ".join(f"{robot.joint_names[i]} at {angles[i]:.3f} rad" for i in beyond)
        allowed = ", ".join(f"{robot.joint_lower[i]:.3f} to {robot.joint_upper[i]:.3f} rad" for i in beyond)
        what = f"joint beyond its limit - got {got}, expected {allowed}; change the angle"
        yield ProblemWarning(keyframe.where, what, keyframe.placed.phase.source)


def _feet(robot: Robot, terrain: Terrain, keyframe: PlacedKeyframe) -> Iterator[ProblemWarning]:
    """Yield feet that stand or land but are not on the ground."""
    for names, what in ((keyframe.stance, "stance"), (keyframe.landing, "landing")):
        pose = (base.position, base.orientation, joints.position) if names else ()
        got = (
            feet_off_ground(robot, terrain, names, *(np.asarray(keyframe.sample[each]) for each in pose))
            if pose
            else ""
        )
        if got:
            ground = ", or give the model its ground, terrain=" if what == "landing" and terrain == Flat() else ""
            yield ProblemWarning(
                keyframe.where,
                f"{what} foot is not on the ground - got {got}, expected within {OFF_GROUND} m; change the position of "
                f"the base or the joint angles (feet= finds them){ground}",
                keyframe.placed.phase.source,
            )


def _torques(robot: Robot, keyframe: PlacedKeyframe) -> Iterator[ProblemWarning]:
    """Yield joints whose limit is too small to hold the pose at rest."""
    if not keyframe.stance and robot.base == "free":
        return
    torque = static_torques(robot, _configuration(robot, keyframe.sample)[0], keyframe.stance)
    beyond = np.flatnonzero(np.abs(torque) > robot.torque_limit)
    if len(beyond):
        got = ", ".join(f"{robot.joint_names[i]} {abs(torque[i]):.1f} Nm" for i in beyond)
        allowed = ", ".join(f"{robot.torque_limit[i]:.1f} Nm" for i in beyond)
        on = f" on {' '.join(keyframe.stance)}" if keyframe.stance else ""
        yield ProblemWarning(
            keyframe.where,
            f"static torque beyond the limit - got {got} at rest{on}, expected at most "
            f"{allowed}; straighten the legs or put more feet on the ground",
            keyframe.placed.phase.source,
        )


def static_torques(robot: Robot, q: Array, feet: tuple[str, ...]) -> Array:
    """Return the joint torques that support the robot at rest, (n,) [Nm].

    The contact forces balance the weight exactly, and its moments as far as the feet allow. Among such distributions of
    forces the result has the smallest torques relative to the limits.

    Args:
        robot: the robot.
        q: pinocchio's configuration.
        feet: names of the feet on the ground.
    """
    data = robot.model.createData()
    weight = pin.computeGeneralizedGravity(robot.model, data, q)
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    if robot.base == "fixed":
        return np.array(weight[6:])
    frames = [robot.frame_id(robot.foot(name).frame) for name in feet]
    J = np.vstack([
        pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3] for frame in frames
    ])  # fmt: skip
    scale = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])  # forces before moments
    balance = scale[:, None] * J[:, :6].T
    force = np.linalg.lstsq(balance, scale * weight[:6], rcond=None)[0]
    _, sizes, directions = np.linalg.svd(balance)
    free = directions[int(np.sum(sizes > 1e-9 * sizes[0])) :].T
    per_limit = 1 / np.maximum(robot.torque_limit[:, None], _WEAK)  # zero for a joint without a limit
    if free.size:
        torque = weight[6:] - J[:, 6:].T @ force
        change = np.linalg.lstsq(per_limit * (J[:, 6:].T @ free), per_limit[:, 0] * torque, rcond=None)[0]
        force = force + free @ change
    return np.asarray(weight[6:] - J[:, 6:].T @ force)


# ---- several keyframes


def _flights(robot: Robot, path: Path, keyframes: list[PlacedKeyframe]) -> Iterator[ProblemWarning]:
    """Yield keyframes that are not on the ballistic flight through the others of the same flight.

    A ballistic flight joins any two keyframes. Three keyframes, or a keyframe and a given velocity, may contradict.
    """
    airborne: list[PlacedKeyframe] = []
    for i, keyframe in enumerate(keyframes):
        following = keyframes[i + 1] if i + 1 < len(keyframes) else None
        if keyframe.stance:
            continue
        airborne.append(keyframe)
        if following is None or following.stance or following.placed.start != keyframe.placed.end:
            yield from _flight(robot, path, airborne)
            airborne = []


def _flight(robot: Robot, path: Path, airborne: list[PlacedKeyframe]) -> Iterator[ProblemWarning]:
    """Yield the keyframe that is farthest from the ballistic flight of consecutive phases without contact."""
    first = airborne[0].placed
    keyframes = [keyframe for keyframe in airborne if keyframe.named & _POSE]
    start = path.sample(first.start, first)
    gravity = robot.model.gravity.linear
    times = np.array([0.0] + [keyframe.placed.end - first.start for keyframe in keyframes])
    states = [_configuration(robot, sample) for sample in (start, *(keyframe.sample for keyframe in keyframes))]
    # positions of the centre of mass without the effect of gravity: they are on a straight line
    places = np.array([_com(robot, *state)[0] for state in states]) - 0.5 * times[:, None] ** 2 * gravity
    given = [(0.0, places[0], velocity) for velocity in [_take_off(robot, path, first)] if velocity is not None]
    for keyframe, t, place, state in zip(keyframes, times[1:], places[1:], states[1:], strict=True):
        if keyframe.named & {"linear_velocity", base.linear_velocity.path}:
            given.append((float(t), place, _com(robot, *state)[1] - t * gravity))
    if given:
        t0, place, velocity = given[0]
    elif len(keyframes) > 1:
        t0, place, velocity = 0.0, places[0], (places[-1] - places[0]) / times[-1]
    else:
        return
    line = place + (times - t0)[:, None] * velocity
    error = places - line
    worst = int(np.argmax(np.abs(error[:, 2])))
    if abs(error[worst, 2]) > OFF_FLIGHT:
        keyframe = keyframes[worst - 1] if worst else keyframes[0]
        actual = places[worst, 2] + 0.5 * times[worst] ** 2 * gravity[2]
        side = "high" if error[worst, 2] > 0 else "low"
        yield ProblemWarning(
            keyframe.where,
            f"no ballistic flight joins the keyframes - got a height of {actual:.3f} m for the centre of mass after "
            f"{times[worst]:.3f} s in the air, expected {actual - error[worst, 2]:.3f} m: "
            f"{abs(error[worst, 2]):.3f} m too {side}; move the keyframe or change the durations",
            keyframe.placed.phase.source,
        )


def _take_off(robot: Robot, path: Path, first: PlacedPhase) -> Array | None:
    """Return the velocity of the centre of mass at the beginning of a flight, (3,) [m/s]; None if it is not given."""
    if first.start == 0.0:
        start = getattr(path.placed[0].reference, "start", {})
        return _com(robot, *_configuration(robot, start))[1] if base.linear_velocity in start else None
    before = path.interval_before(first.start)
    target = before.phase.target
    if target is None or not {"linear_velocity", base.linear_velocity.path} & set(target.values):
        return None
    return _com(robot, *_configuration(robot, path.sample(before.end, before)))[1]


def _configuration(robot: Robot, sample: Sample) -> tuple[Array, Array]:
    """Return pinocchio's q and v of a sample; missing joint angles are those of ``"stand"``, missing velocities 0."""
    defaults = {
        base.position: np.zeros(3),
        base.orientation: np.array([1.0, 0.0, 0.0, 0.0]),
        joints.position: robot.pose("stand"),
        joints.velocity: np.zeros(robot.num_joints),
        base.linear_velocity: np.zeros(3),
        base.angular_velocity: np.zeros(3),
    }
    order = (base.position, base.orientation, joints.position, base.linear_velocity, base.angular_velocity)
    full = {**defaults, **sample}
    return to_pinocchio(np.concatenate([np.asarray(full[quantity]) for quantity in (*order, joints.velocity)]))


def _com(robot: Robot, q: Array, v: Array) -> tuple[Array, Array]:
    """Return position [m] and velocity [m/s] of the centre of mass in world axes, (3,) each."""
    data = robot.model.createData()
    pin.centerOfMass(robot.model, data, q, v)
    return np.array(data.com[0]), np.array(data.vcom[0])
