"""The quantities of legged robots. Models bind those that they have; a term that none binds is an error.

World axes unless said otherwise; stacked feet are flat, (3 nf,), in the robot's order of feet.
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
"""The floating base's origin: world position and velocity, attitude, angular velocity in *body* axes; ``height`` is
that above the terrain's mean height below the feet, ``ground_normal`` the upward normal of the plane through the ground
below the feet, in body axes: (0, 0, 1) of a base that is parallel to it."""

joints = group("joints", position="rad", velocity="rad/s", acceleration="rad/s^2", torque="Nm", target="rad")
"""The actuated joints, in state order; ``target`` is what a joint controller follows."""

feet = group(
    "feet",
    position=("m", "point"),
    velocity=("m/s", "direction"),
    force=("N", "direction"),
    height="m",
    reach="m",
    contact="",
    landing="",
    lifting="",
)
"""The feet. ``height`` is the gap between ball and terrain; ``reach`` how far a foot is ahead and to the left of the
base's origin, in the axes of its heading; ``force`` acts on the robot, zero for feet in the air; ``contact`` is 1 for
feet on the ground, ``landing`` for feet that touch down at the phase's end, ``lifting`` for feet at the first two nodes
after they have left."""

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
