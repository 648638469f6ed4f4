"""The quantities of legged robots.

Each model binds the quantities that it has; a term whose quantity no model binds is an error. Vectors are in world axes
unless their description names other axes. Vectors of all feet are stacked, (3 nf,), in the robot's order of feet.
"""

from __future__ import annotations

from piaffe.ocp import Quantity, QuantityGroup, group

base = group(
    "base",
    position=("m", "point"),
    orientation=("rad", "rotation"),
    linear_velocity=("m/s", "direction"),
    angular_velocity="rad/s",
    height="m",
    ground_normal="",
)
"""The floating base: position and velocity of its origin in world axes, orientation, angular velocity in *body* axes.
``height`` is the height of the origin above the mean height of the terrain below the feet. ``ground_normal`` is the
upward normal, in body axes, of the plane that fits the terrain below the feet; it is (0, 0, 1) if the base is parallel
to this plane."""

joints = group(
    "joints",
    position="rad",
    velocity="rad/s",
    acceleration="rad/s^2",
    torque="Nm",
    target="rad",
    commanded_velocity="rad/s",
)
"""The actuated joints, in state order; ``target`` is the target angle of a joint controller, ``commanded_velocity`` the
velocity that the control of a kinodynamic model asks for: legs on the ground do not follow it."""

feet = group(
    "feet",
    position=("m", "point"),
    velocity=("m/s", "direction"),
    force=("N", "direction"),
    impulse=("N s", "direction"),
    contact_force="N",
    contact_impulse="N s",
    height="m",
    clearance="m",
    normal=("", "direction"),
    normal_speed="m/s",
    surfaces=("m", "point"),
    normals=("", "direction"),
    reach="m",
    contact="",
    landing="",
    lifting="",
)
"""The feet. ``height`` is the distance between the foot's ball and the ground where it stands; in the air, the ground
between where it has stood and where it will. ``clearance`` are the distances that feet in the air keep, see
:func:`~piaffe.models.foot_clearance`. ``normal`` is the upward normal of the ground where a foot stands,
``normal_speed`` the speed along it. ``contact_force`` and ``contact_impulse`` are ``force`` and ``impulse`` in axes of
the ground where the foot stands, the normal last. ``surfaces`` and ``normals`` are points and normals of planes of the
terrain, (9 nf,): where the feet stand, what is below them, and what is beside them. ``reach`` is the position of a foot
relative to the base's origin in the base's heading axes: ahead and left. ``force`` acts on the robot; it is zero for
feet in the air. ``impulse`` acts on the robot in the impact at a phase's end, for terms with ``at="phase_end"``; it is
zero for feet that do not take part. ``contact`` is 1 for feet on the ground, ``landing`` is 1 for feet that touch down
at the phase's end, ``lifting`` is 1 for feet whose place after their liftoff depends on the stance alone: at the first
node; with Euler's step at the first two."""

com = group("com", position=("m", "point"), velocity=("m/s", "direction"))
"""The centre of mass of the whole robot."""

momentum = Quantity("momentum", "kg m^2/s", "direction")
"""Angular momentum about the centre of mass, world axes (the linear part is the mass times ``com.velocity``)."""


class Frames:
    """Any frame of the robot by its URDF name: ``frames["FL_KFE"].position``."""

    def __getitem__(self, name: str) -> QuantityGroup:
        return group(f"frames.{name}", position=("m", "point"), velocity=("m/s", "direction"))


frames = Frames()
"""Links and joints by name; ``position`` and ``velocity`` of the frame's origin."""
