"""Write a page of the documentation for each robot that Piaffe knows by name: numbers from its URDF, and pictures.

Run it after a robot changes: ``python docs/robots/make.py``. With ``--text``, it writes no pictures.
"""

import sys
from pathlib import Path

import numpy as np

from piaffe import models

HERE = Path(__file__).parent
NAMES = ("mini_cheetah", "solo12", "go2", "anymal_c")
DIRECTIONS = (("ahead", "back"), ("left", "right"), ("up", "down"))


def moves(robot: models.Robot, joint: int) -> str:
    """Return where the feet of a joint go when its angle increases from the stand, in axes of the base."""
    kinematics, stand = models.Kinematics(robot), robot.pose("stand")
    more = stand.copy()
    more[joint] += 1e-4
    way = (kinematics.feet(more) - kinematics.feet(stand)) / 1e-4
    foot = robot.foot_of_joint[joint]
    size = np.abs(way[foot]).max()
    words = [
        DIRECTIONS[axis][0 if way[foot, axis] > 0 else 1] for axis in range(3) if abs(way[foot, axis]) > 0.35 * size
    ]
    return " and ".join(words)


def page(name: str) -> str:
    """Return the page of a robot."""
    robot = models.load(name)
    stand = robot.pose("stand")
    lines = [
        f"# {name}",
        "",
        f'`models.load("{name}")`: {robot.mass:.2f} kg, {robot.num_joints} joints, feet {", ".join(robot.foot_names)}.',
        f"In the pose `stand` the base is {robot.base_height():.3f} m above the ground.",
        f"A foot stands on the ground if its point is {1000 * robot.foot_radius:.1f} mm above it.",
        "",
        f"![{name}: the poses {', '.join(robot.poses)}](../assets/robots/{name}.png)",
        "",
        "The state has the joints in this order.",
        "The last column says where the foot goes, in axes of the base, when the angle increases from `stand`.",
        "",
        "| joint | from [rad] | to [rad] | stand [rad] | speed [rad/s] | torque [Nm] | its foot goes |",
        "|---|---|---|---|---|---|---|",
    ]
    for i, joint in enumerate(robot.joint_names):
        limits = [
            robot.joint_lower[i],
            robot.joint_upper[i],
            stand[i],
            robot.joint_speed_limit[i],
            robot.torque_limit[i],
        ]
        cells = " | ".join("none" if not np.isfinite(value) else f"{value:.4g}" for value in limits)
        lines.append(f"| `{joint}` | {cells} | {moves(robot, i)} |")
    lines += ["", f"Poses by name: {', '.join(f'`{pose}`' for pose in robot.poses)}.", ""]
    return "\n".join(lines)


def draw(name: str) -> None:
    """Write the picture of a robot's poses side by side."""
    from piaffe import viz

    robot = models.load(name)
    pictures = [viz.picture(robot, pose, size=(360, 270), azimuth=60) for pose in robot.poses]
    folder = HERE.parent / "assets" / "robots"
    folder.mkdir(exist_ok=True)
    viz.save_picture(np.concatenate(pictures, axis=1), folder / f"{name}.png")


def main(pictures: bool = True) -> None:
    """Write the pages, and the pictures."""
    for name in NAMES:
        (HERE / f"{name}.md").write_text(page(name), encoding="utf-8")
        if pictures:
            draw(name)


if __name__ == "__main__":
    main("--text" not in sys.argv)
