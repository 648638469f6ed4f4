"""Go2 (Unitree), 12 joints, 16.085 kg.

Sources: the URDF of the package example-robot-data, limits included. It holds no ball at the foot; the radius is that
of Unitree's own description.
"""

from __future__ import annotations

from .known import KnownRobot

ROBOT = KnownRobot(
    urdf="go2_description/urdf/go2.urdf",
    legs=("FL", "FR", "RL", "RR"),
    foot_frame="{}_foot",
    foot_radius=0.022,
    poses={"stand": ((0.0, 0.8, -1.6),), "crouch": ((0.0, 1.15, -2.3),)},
)
"""Go2; its URDF holds all limits."""
