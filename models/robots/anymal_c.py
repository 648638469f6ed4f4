"""ANYmal C (ANYbotics), 12 joints, 52.135 kg.

Sources: the URDF of the package example-robot-data, limits and foot radius included.
"""

from __future__ import annotations

from .known import KnownRobot

ROBOT = KnownRobot(
    urdf="anymal_c_simple_description/urdf/anymal.urdf",
    legs=("LF", "RF", "LH", "RH"),
    foot_frame="{}_FOOT",
    foot_radius=0.03,
    poses={
        "stand": ((0.0, 0.7, -1.2), (0.0, 0.7, -1.2), (0.0, -0.7, 1.2), (0.0, -0.7, 1.2)),
        "crouch": ((0.0, 1.0, -1.9), (0.0, 1.0, -1.9), (0.0, -1.0, 1.9), (0.0, -1.0, 1.9)),
    },
)
"""ANYmal C; its URDF holds the limits that it has."""
