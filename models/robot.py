"""A robot: the numbers of a ``pinocchio.Model`` with a floating base, its feet, limits and named poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from piaffe.errors import ModelError, ShapeError, UnknownNameError
from piaffe.html import html_table
from piaffe.ocp import match_labels

from .doctor_text import Finding

Array = NDArray[np.float64]

ROLES = ("front", "hind", "left", "right")
ROOT = 1  # index of the floating base in a pinocchio.Model; joint j of the state is ROOT + 1 + j


@dataclass(frozen=True)
class Foot:
    """A point of the robot that may touch the ground.

    Args:
        name: short name, the robot's own, e.g. ``"FL"``.
        frame: name of the frame at the centre of the foot's ball.
        roles: its roles in gaits, a subset of ``ROLES``.
    """

    name: str
    frame: str
    roles: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for role in self.roles:
            if role not in ROLES:
                raise UnknownNameError(f"foot '{self.name}'", "role", role, ROLES)


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot: its mechanism, feet, limits and poses. Robots compare by identity.

    Args:
        name: name for messages and files.
        model: pinocchio model whose first joint is a free-flyer and all others have one degree of freedom.
        feet: the feet; their order is that of every stacked foot quantity.
        foot_radius: radius of the foot's ball; a foot touches the ground when its frame is this far above it [m].
        joint_names: names in state order, n of them.
        torque_limit: largest torque, (n,) [Nm], force of a prismatic joint [N]; this and the other limits are infinite
            where there is none. A joint whose limit is zero is passive: it has no control.
        joint_lower: smallest angle, (n,) [rad].
        joint_upper: largest angle, (n,) [rad].
        joint_speed_limit: largest speed, (n,) [rad/s].
        armature: rotor inertia reflected to the joints, (n,) [kg m^2].
        poses: named joint angles, each (n,) [rad]; ``"stand"`` and ``"crouch"`` at least.
        urdf: the file that it was read from, if any; the visual geometry comes from it.
        package_dirs: folders in which ``package://`` meshes are searched.
        recipe: how it was loaded, for files: see :mod:`piaffe.models.robots`; empty for a robot built by hand.
        joint_damping: viscous damping of the joints, (n,) [Nm s/rad]; zero if it is left out.
        joint_friction: dry friction of the joints, (n,) [Nm]; zero if it is left out.
        base: ``"free"`` for a floating base, ``"fixed"`` for one that stands still in the world. The model has a
            free-flyer in both cases; with a fixed base its place is the origin.
        warnings: what :func:`piaffe.models.diagnose` finds and is no error; ``describe`` and solves show them.
    """

    name: str
    model: pinocchio.Model
    feet: tuple[Foot, ...]
    foot_radius: float
    joint_names: tuple[str, ...]
    torque_limit: Array
    joint_lower: Array
    joint_upper: Array
    joint_speed_limit: Array
    armature: Array
    poses: Mapping[str, Array]
    urdf: Path | None = None
    package_dirs: tuple[str, ...] = field(default=(), repr=False)
    recipe: Mapping[str, Any] = field(default_factory=dict, repr=False)
    joint_damping: Array = field(default_factory=lambda: np.zeros(0))
    joint_friction: Array = field(default_factory=lambda: np.zeros(0))
    base: Literal["free", "fixed"] = "free"
    warnings: tuple[Finding, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        _check_joints(self.name, self.model, self.joint_names)
        self._check_feet()
        if not np.isfinite(self.foot_radius) or self.foot_radius < 0:
            raise ModelError(
                f"robot '{self.name}': foot_radius is not a length - got {self.foot_radius}, expected a finite number "
                "≥ 0 [m]; give the radius of the foot's ball, 0 for a point"
            )
        for key in ("torque_limit", "joint_lower", "joint_upper", "joint_speed_limit", "armature"):
            self._check_size(key, getattr(self, key))
        for key in ("joint_damping", "joint_friction"):
            self._check_losses(key)
        for key, angles in self.poses.items():
            self._check_size(f"pose '{key}'", angles)
        self._copy_arrays()

    def __repr__(self) -> str:
        feet = " ".join(self.foot_names)
        return f"Robot('{self.name}', {len(self.joint_names)} joints, feet {feet}, {self.mass:.3f} kg)"

    def _repr_html_(self) -> str:
        head = ("joint", "from", "to", "speed", "torque", "inertia of the rotor")
        limits = (self.joint_lower, self.joint_upper, self.joint_speed_limit, self.torque_limit, self.armature)
        rows = [(name, *(f"{v[i]:.4g}" for v in limits)) for i, name in enumerate(self.joint_names)]
        return html_table(f"{self!r}; SI units, angles in rad", head, rows)

    # ---- sizes and names

    @property
    def num_joints(self) -> int:
        """Number of joints n, passive ones included."""
        return len(self.joint_names)

    @property
    def foot_names(self) -> tuple[str, ...]:
        """Names of the feet, in order."""
        return tuple(foot.name for foot in self.feet)

    @cached_property
    def motors(self) -> tuple[int, ...]:
        """Indices of the joints that have a control; the others are passive, with a torque limit of zero."""
        return tuple(int(i) for i in np.flatnonzero(self.torque_limit > 0))

    @property
    def motor_names(self) -> tuple[str, ...]:
        """Names of the joints that have a control, in state order."""
        return tuple(self.joint_names[i] for i in self.motors)

    @cached_property
    def foot_of_joint(self) -> tuple[int, ...]:
        """Index of the one foot that each joint moves, (n,); -1 for joints that move none or several."""
        moved: list[list[int]] = [[] for _ in self.joint_names]
        for foot, each in enumerate(self.feet):
            joint = self.model.frames[self.frame_id(each.frame)].parentJoint
            while joint > ROOT:
                moved[joint - ROOT - 1].append(foot)
                joint = self.model.parents[joint]
        return tuple(feet[0] if len(feet) == 1 else -1 for feet in moved)

    @cached_property
    def mass(self) -> float:
        """Total mass [kg]."""
        return float(pinocchio.computeTotalMass(self.model))

    @cached_property
    def visual(self) -> pinocchio.GeometryModel | None:
        """The visual geometry, read on first use; None without a file, or if its meshes are not found."""
        return self._geometry(pinocchio.GeometryType.VISUAL)

    @cached_property
    def collision(self) -> pinocchio.GeometryModel | None:
        """The collision geometry, read on first use; None without a file, or if its meshes are not found."""
        return self._geometry(pinocchio.GeometryType.COLLISION)

    def _geometry(self, kind: pinocchio.GeometryType) -> pinocchio.GeometryModel | None:
        if self.urdf is None:
            return None
        try:
            return pinocchio.buildGeomFromUrdf(self.model, str(self.urdf), kind, package_dirs=list(self.package_dirs))
        except (ValueError, RuntimeError):
            return None

    def foot(self, name: str) -> Foot:
        """Return the foot of that name."""
        for foot in self.feet:
            if foot.name == name:
                return foot
        raise UnknownNameError(f"robot '{self.name}'", "foot", name, self.foot_names)

    def feet_with(self, roles: str | Iterable[str]) -> tuple[Foot, ...]:
        """Return the feet that have all the roles, ``"front left"`` or ``("front", "left")``; all feet for no role."""
        wanted = tuple(roles.split() if isinstance(roles, str) else roles)
        for role in wanted:
            if role not in ROLES:
                raise UnknownNameError(f"robot '{self.name}'", "role", role, ROLES)
        return tuple(foot for foot in self.feet if foot.roles.issuperset(wanted))

    def frame_id(self, name: str) -> int:
        """Return the index in the model of a frame; joints and links are frames too."""
        if not self.model.existFrame(name):
            raise UnknownNameError(f"robot '{self.name}'", "frame", name, [f.name for f in self.model.frames])
        return frame_index(self.model, name)

    def joint_axis(self, index: int) -> Array:
        """Return the motion subspace of a joint in its own frame, (6,): axis of translation, axis of rotation.

        One of the two is zero.
        """
        joint = self.model.joints[index]
        data = joint.createData()
        joint.calc(data, np.zeros(1))
        return np.asarray(data.S, dtype=float).reshape(6)

    # ---- poses

    def pose(self, joints: object) -> Array:
        """Return joint angles, (n,) [rad].

        Args:
            joints: the name of a pose, n numbers, or a mapping from labels to angles, e.g. ``{"FL_HAA": 0.3}`` or
                ``{"HAA": 0.3}`` for that joint of every leg; the other joints have their angles of ``"stand"``.
        """
        where = f"robot '{self.name}', joints"
        if isinstance(joints, str):
            if joints not in self.poses:
                raise UnknownNameError(
                    f"robot '{self.name}'", "pose", joints, self.poses,
                    f"add it: models.load(..., poses={{'{joints}': angles}}), or write the angles, as "
                    f"{{'{_kind(self.joint_names[-1])}': {self.poses['stand'][-1]:g}}}",
                )  # fmt: skip
            return np.array(self.poses[joints], dtype=float)
        if isinstance(joints, Mapping):
            angles = np.array(self.poses["stand"], dtype=float)
            for label, value in joints.items():
                indices = match_labels(self.joint_names, label, where)
                entries: Array = np.atleast_1d(np.asarray(value, dtype=float))
                if entries.shape not in ((1,), (len(indices),)):
                    names = ", ".join(self.joint_names[i] for i in indices)
                    raise ShapeError(
                        f"{where}, label '{label}': wrong size - got {entries.size} entries, expected 1 or "
                        f"{len(indices)} ({names}) [rad]; give one angle for all of them or one each"
                    )
                angles[indices] = entries
            return angles
        try:
            angles = np.array(joints, dtype=float)
        except (TypeError, ValueError):
            raise ModelError(
                f"{where}: not joint angles - got {joints!r}, expected the name of a pose ({', '.join(self.poses)}), "
                f"{self.num_joints} numbers or a mapping from labels to angles; give one of them"
            ) from None
        self._check_size("joints", angles)
        return angles

    def inverse_kinematics(
        self,
        feet: Mapping[str, ArrayLike],
        position: ArrayLike = (0.0, 0.0, 0.0),
        rpy: ArrayLike = (0.0, 0.0, 0.0),
        joints: object = "stand",
    ) -> Array:
        """Return joint angles, (n,) [rad], that put feet at given places; damped least squares within the joint limits.

        A foot stands on the ground at z = 0 if its place has the height ``foot_radius``.

        Args:
            feet: name → place of the foot's point in the world (x, y, z) [m]; other legs keep the angles of ``joints``.
            position: of the base in the world [m].
            rpy: roll, pitch, yaw of the base [rad].
            joints: the pose from which the search starts; it decides to which side the knees bend.

        Raises:
            ModelError: a place is out of reach; the message has the nearest one.
            UnknownNameError: there is no such foot.
            ShapeError: a place is not three finite numbers.
        """
        from .inverse_kinematics import inverse_kinematics

        return inverse_kinematics(self, feet, position, rpy, joints)

    def forward_kinematics(
        self, joints: object = "stand", position: ArrayLike | None = None, rpy: ArrayLike = (0.0, 0.0, 0.0)
    ) -> dict[str, Array]:
        """Return the places of the feet in the world, name → (x, y, z) [m], as ``feet=`` of a keyframe takes them.

        ``ocp.Keyframe(position=..., feet=robot.forward_kinematics())`` moves the base of a robot that stands, and
        leaves its feet where they are.

        Args:
            joints: a pose's name, n numbers, or a mapping of labels, see :meth:`pose` [rad].
            position: of the base [m]; by default at x = y = 0, with the lowest foot on the ground at z = 0.
            rpy: roll, pitch, yaw of the base [rad].

        Raises:
            ShapeError: position or rpy are not three finite numbers.
        """
        from .inverse_kinematics import forward_kinematics

        return forward_kinematics(self, joints, position, rpy)

    def base_height(self, joints: object = "stand") -> float:
        """Return the height of a level base at which the lowest foot touches flat ground at z = 0 [m]."""
        if not self.feet:
            raise ModelError(
                f"robot '{self.name}': its base has no height above the ground - got no feet, expected at least one; "
                "give the base's position"
            )
        q = pinocchio.neutral(self.model)
        q[7:] = self.pose(joints)
        data = self.model.createData()
        pinocchio.framesForwardKinematics(self.model, data, q)
        lowest = min(float(data.oMf[self.frame_id(foot.frame)].translation[2]) for foot in self.feet)
        return self.foot_radius - lowest

    def _copy_arrays(self) -> None:
        """Replace the arrays that were given by copies that cannot be written to."""
        for key in ("torque_limit", "joint_lower", "joint_upper", "joint_speed_limit", "armature", "joint_damping",
                    "joint_friction"):  # fmt: skip
            object.__setattr__(self, key, _fixed(getattr(self, key)))
        object.__setattr__(self, "poses", {key: _fixed(angles) for key, angles in self.poses.items()})

    def _check_feet(self) -> None:
        """Raise unless the feet have names of their own, and frames."""
        given = list(self.foot_names)
        twice = sorted({name for name in given if given.count(name) > 1})
        if twice:
            raise ModelError(
                f"robot '{self.name}', feet: are not distinct - got {', '.join(map(repr, twice))} twice, expected "
                "another name for each foot; give a mapping from names to frames"
            )
        for foot in self.feet:
            self.frame_id(foot.frame)

    def _check_losses(self, key: str) -> None:
        """Write zeros where nothing was given; raise unless there is one finite number ≥ 0 per joint."""
        values: Array = np.asarray(getattr(self, key), dtype=float)
        if values.shape == (0,):
            object.__setattr__(self, key, np.zeros(self.num_joints))
            return
        self._check_size(key, values)
        if not np.all(np.isfinite(values) & (values >= 0)):
            raise ModelError(
                f"robot '{self.name}': {key} is out of range - got {values.tolist()}, expected finite numbers ≥ 0, "
                f"one per joint [{'Nm s/rad' if key == 'joint_damping' else 'Nm'}]; change them"
            )

    def _check_size(self, what: str, values: Any) -> None:
        shape = np.shape(values)
        if shape != (self.num_joints,):
            got = f"{shape[0]} entries" if len(shape) == 1 else f"shape {shape}"
            raise ShapeError(
                f"robot '{self.name}', {what}: wrong size - got {got}, expected {self.num_joints} "
                f"({', '.join(self.joint_names)}); give one number per joint"
            )


def _kind(joint: str) -> str:
    """Return the name of a joint without that of its leg."""
    return joint.partition("_")[2] or joint


def _fixed(values: Any) -> Array:
    """Return a copy that cannot be written to; of such an array, the array itself."""
    if isinstance(values, np.ndarray) and not values.flags.writeable:
        return values
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def frame_index(model: pinocchio.Model, name: str) -> int:
    """Return the index of a frame that exists; of a link and a joint of one name, whose frames agree, the link's."""
    kinds = pinocchio.FrameType.BODY
    return int(model.getFrameId(name, kinds) if model.existFrame(name, kinds) else model.getFrameId(name))


def to_pinocchio(x: Array) -> tuple[Array, Array]:
    """Return pinocchio's (q, v) of a state: quaternion (x, y, z, w) and base velocity in body axes.

    Args:
        x: state (position, quaternion w first, joints, world linear velocity, body angular velocity, joint
            velocities), (nq + nv,) with nq = nv + 1.
    """
    nq = (len(x) + 1) // 2
    q, v = np.array(x[:nq], dtype=float), np.array(x[nq:], dtype=float)
    q[3:7] = x[[4, 5, 6, 3]]
    rotation = pinocchio.Quaternion(q[3:7]).toRotationMatrix()
    v[:3] = rotation.T @ v[:3]
    return q, v


def _check_joints(name: str, model: pinocchio.Model, joint_names: tuple[str, ...]) -> None:
    """Raise unless the model is a free-flyer followed by joints of one degree of freedom, named in order."""
    if model.njoints < ROOT + 1 or model.joints[ROOT].shortname() != "JointModelFreeFlyer":
        raise ModelError(
            f"robot '{name}': the base is fixed - got '{model.joints[ROOT].shortname() if model.njoints > 1 else ''}' "
            "as first joint, expected a free-flyer; build the model with pinocchio.JointModelFreeFlyer()"
        )
    for joint, joint_name in zip(model.joints[ROOT + 1 :], model.names[ROOT + 1 :], strict=False):
        if (joint.nq, joint.nv) != (1, 1):
            raise ModelError(
                f"robot '{name}', joint '{joint_name}': not a single angle - got {joint.shortname()} with {joint.nq} "
                f"position and {joint.nv} velocity entries, expected 1 and 1; make it 'revolute' (with limits) in the "
                "URDF, or lock it"
            )
    if tuple(model.names[ROOT + 1 :]) != joint_names:
        raise ModelError(
            f"robot '{name}': joint names out of order - got {joint_names}, expected {tuple(model.names[ROOT + 1 :])}; "
            "name them in the order of the model"
        )


def require_robot(robot: object, where: str) -> None:
    """Raise unless something is a robot."""
    if not isinstance(robot, Robot):
        raise ModelError(f"{where}: not a robot - got {robot!r}, expected what models.load returns; load one")
