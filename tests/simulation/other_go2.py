"""The MJCF file of a Go2 with other numbers than ours, as a user would have identified them, written as text.

It differs in mass (5 % less), in the places of the feet (1.5 mm), armature, damping, dry friction and the limits of
force, in the order of the legs, in all names, and in the gears of its motors. ``python -m tests.simulation.other_go2``
writes ``examples/other_go2.xml``.
"""

from pathlib import Path

import numpy as np
import pinocchio as pin

from piaffe import models

FILE = Path(__file__).parents[2] / "examples" / "other_go2.xml"
LEGS = {"RR": "hind_right", "RL": "hind_left", "FR": "front_right", "FL": "front_left"}
KINDS = {"hip": "abduction", "thigh": "hip", "calf": "knee"}
ARMATURE = {"hip": 0.012, "thigh": 0.012, "calf": 0.036}  # [kg m²]
DAMPING = {"hip": 0.15, "thigh": 0.18, "calf": 0.24}  # [Nm s/rad]
FRICTION = {"hip": 0.2, "thigh": 0.4, "calf": 1.0}  # [Nm]
LIMIT = {"hip": 23.0, "thigh": 23.0, "calf": 44.0}  # [Nm]
GEAR = {"hip": 1.0, "thigh": 1.0, "calf": 2.0}
LIGHTER, ASIDE = 0.95, (0.0012, 0.0, -0.0009)  # factor of all masses; place of every foot relative to ours [m]

ROBOT = models.load("go2")
JOINTS = {f"{leg}_{kind}_joint": f"{LEGS[leg]}_{KINDS[kind]}" for leg in LEGS for kind in KINDS}
FEET = {leg: f"{LEGS[leg]}_toe" for leg in LEGS}


def text() -> str:
    """Return the file's text."""
    model = ROBOT.model
    lines = [
        '<mujoco model="other_go2">',
        '  <compiler angle="radian" autolimits="true"/>',
        '  <option timestep="0.002" cone="elliptic" impratio="10" integrator="implicitfast"/>',
        "  <worldbody>",
        '    <geom name="ground" type="plane" size="0 0 0.05" condim="3" friction="0.7 0.005 0.0001"/>',
        f'    <body name="trunk" pos="0 0 {_n(ROBOT.base_height())}">',
        '      <freejoint name="floating"/>',
        _inertial(model.inertias[1], 6),
        '      <geom name="belly" type="box" size="0.19 0.05 0.05" contype="0" conaffinity="1" group="4"/>',
    ]
    for leg in LEGS:
        for depth, kind in enumerate(KINDS):
            j, pad = model.getJointId(f"{leg}_{kind}_joint"), 6 + 2 * depth
            axis = ROBOT.joint_axis(j)[3:]
            lower, upper = ROBOT.joint_lower[j - 2], ROBOT.joint_upper[j - 2]
            lines += [
                f'{" " * pad}<body name="{LEGS[leg]}_{kind}" pos="{_n(*model.jointPlacements[j].translation)}">',
                f'{" " * pad}  <joint name="{JOINTS[model.names[j]]}" axis="{_n(*axis)}" range="{_n(lower, upper)}" '
                f'armature="{ARMATURE[kind]}" damping="{DAMPING[kind]}" frictionloss="{FRICTION[kind]}"/>',
                _inertial(model.inertias[j], pad + 2),
            ]
        frame = model.frames[model.getFrameId(f"{leg}_foot")]
        place = frame.placement.translation + np.array(ASIDE)
        lines += [
            f'{" " * pad}  <geom type="sphere" size="{_n(ROBOT.foot_radius)}" pos="{_n(*place)}" condim="3" '
            'friction="0.7 0.005 0.0001" priority="1"/>',
            f'{" " * pad}  <site name="{FEET[leg]}" pos="{_n(*place)}"/>',
            *(" " * (pad - 2 * i) + "</body>" for i in range(3)),
        ]
    lines += ["    </body>", "  </worldbody>", "  <actuator>"]
    for leg in sorted(LEGS):
        for kind in KINDS:
            most = LIMIT[kind] / GEAR[kind]
            lines.append(
                f'    <motor name="{LEGS[leg]}_{kind}_motor" joint="{LEGS[leg]}_{KINDS[kind]}" gear="{_n(GEAR[kind])}" '
                f'ctrlrange="{_n(-most, most)}"/>'
            )
    return "\n".join([*lines, "  </actuator>", "</mujoco>", ""])


def _inertial(inertia: pin.Inertia, pad: int) -> str:
    full = LIGHTER * inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    mass, place = _n(LIGHTER * inertia.mass), _n(*inertia.lever)
    return f'{" " * pad}<inertial mass="{mass}" pos="{place}" fullinertia="{_n(*full)}"/>'


def _n(*values: float) -> str:
    return " ".join(f"{value:.6g}" for value in values)


if __name__ == "__main__":
    FILE.write_text(text())
