"""Pictures of poses, and the calls in Python that the commands make."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import sys
import numpy as np
from piaffe import models, ocp, solvers, viz
from piaffe.models import base, joints, stance

try:
    viz.gl.prepare()
except viz.gl.DisplayError as error:
    print("no OpenGL:", error)
    sys.exit(77)
robot = models.load("solo12")
body = models.WholeBody(robot)
"""


def run(code: str, folder: Path) -> str:
    """Run code in a process of its own: how MuJoCo renders is settled when it is imported."""
    done = subprocess.run([sys.executable, "-c", CODE + code], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode == 77:
        pytest.skip(done.stdout)
    assert done.returncode == 0, done.stderr
    return done.stdout


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "piaffe", *map(str, arguments)]
    return subprocess.run(line, env=os.environ, capture_output=True, text=True, check=False)


def test_a_picture_shows_the_pose_and_its_marks(tmp_path: Path) -> None:
    run(
        """
standing = viz.picture(robot, "stand", size=(160, 120))
assert standing.shape == (120, 160, 3)
assert np.array_equal(standing, viz.picture(robot, body.state(), size=(160, 120)))
at = (0, 0, robot.base_height())
moved = viz.picture(robot, body.state(position=at, joints={"FL_KFE": -0.4}), size=(160, 120))
changed = np.any(standing != moved, axis=2).mean()
assert 0.001 < changed < 0.2, changed  # one leg
marked = viz.picture(robot, "stand", marked=robot.foot_names, size=(320, 240)).astype(int)
red = (marked[..., 0] > 120) & (marked[..., 0] > 2 * marked[..., 1])
assert red.sum() > 20
stairs = viz.picture(robot, "stand", terrain=models.terrain.incline(0.2), size=(160, 120))
assert np.any(standing != stairs, axis=2).mean() > 0.01
for wrong in (np.zeros(5), np.zeros((2, 37))):
    try:
        viz.picture(robot, wrong)
    except Exception as error:
        assert type(error).__name__ == "ShapeError" and "solo12" in str(error)
    else:
        raise AssertionError
""",
        tmp_path,
    )


def test_a_strip_and_keyframes_are_one_image(tmp_path: Path) -> None:
    run(
        """
high = ocp.Keyframe(position=(0, 0, robot.base_height() + 0.06))
motion = ocp.Motion(
    ocp.Phase("up", stance("FL FR HL HR"), 0.1, high),
    ocp.Phase("rest", stance("FL FR HL HR"), 0.1),
    ocp.Phase("down", stance("FL FR HL HR"), 0.1, ocp.Keyframe(position=(0, 0, robot.base_height()))),
    ocp.Phase("flight", stance(""), 0.1, high),
    ocp.Phase("land", stance("FL FR HL HR"), 0.1),
)
objective = ocp.Objective(ocp.track(base.position, weight=1.0), ocp.regularize(joints.torque, weight=0.1))
problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=body.state())
keyframes = viz.keyframes(problem, size=(120, 90)).astype(int)
assert keyframes.shape == (90, 4 * 120 + 3 * 4, 3)  # the start and the three keyframes
red = (keyframes[..., 0] > 120) & (keyframes[..., 0] > 2 * keyframes[..., 1])
assert red[:, 124:244].sum() > 10  # "up" is too high for its feet
assert red[:, 372:].sum() > 10  # so is "flight", at whose end feet land
assert red[:, :120].sum() == red[:, 248:368].sum() == 0
solution = solvers.MSiLQR(problem, solvers.Options(max_iterations=2)).solve()
assert viz.strip(solution, 3, size=(80, 60)).shape == (60, 3 * 80 + 8, 3)
assert viz.strip(solution, [0.05], size=(80, 60)).shape == (60, 80, 3)
for wrong in ([], ):
    try:
        viz.strip(solution, wrong)
    except Exception as error:
        assert type(error).__name__ == "ProblemError"
    else:
        raise AssertionError
path, text = viz.film(solution, "hop.png", size=(240, 160))
assert path.exists() and text == ""
from matplotlib.figure import Figure
assert isinstance(viz.plot(solution), Figure)
assert viz.plot(solution, "hop.pdf").exists()
""",
        tmp_path,
    )


def test_poses_and_keyframes_by_command(hop_file: Path, tmp_path: Path) -> None:
    done = command("pose", "go2", "-o", tmp_path / "go2.png", "--joints", "RL_calf_joint=-2.0", "--rpy", "0,0.1,0")
    if "OpenGL" in done.stderr:
        pytest.skip(done.stderr)
    assert (done.returncode, done.stderr) == (0, "")
    said = done.stdout.splitlines()
    assert re.fullmatch(r"base 0\.3\d+ m above the ground", said[0])
    assert [re.sub(r"at .*", "", line) for line in said[1:5]] == ["foot FL ", "foot FR ", "foot RL ", "foot RR "]
    assert min(float(line.split(",")[2].split(")")[0]) for line in said[1:5]) == pytest.approx(0.022, abs=1e-4)
    assert said[5:] == [f"saved {tmp_path / 'go2.png'}"]
    done = command("pose", "go2", "-o", tmp_path / "go2.png", "--joints", "calf_joint=-3")
    assert done.stderr.count("joint beyond its limit - got") == 4
    assert "got FL_calf_joint at -3.000 rad, expected -2.723 to -0.838 rad" in done.stderr
    done = command("describe", hop_file, "--pictures", tmp_path / "hop.png")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == f"saved {tmp_path / 'hop.png'}"
    for name in ("go2.png", "hop.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("pose", "go3", "-o", "p.png"), "no robot 'go3'"),
        (("pose", "go2", "-o", "p.mp4"), "expected a picture"),
        (("pose", "go2", "-o", "p.png", "--joints", "KNEE=1"), "KNEE"),
        (("pose", "go2", "-o", "p.png", "--joints", "RL_calf_joint=x"), "expected 1 numbers"),
        (("pose", "go2", "-o", "p.png", "--rpy", "1,2"), "expected 3 numbers"),
    ],
)
def test_bad_poses_are_named(arguments: tuple[str, ...], words: str) -> None:
    done = command(*arguments)
    if "OpenGL" in done.stderr:
        pytest.skip(done.stderr)
    assert done.returncode == 2
    assert words in done.stderr
