"""Problem files and their solutions, made once with the commands themselves."""

from pathlib import Path

import pytest

from piaffe.cli.app import main

BALL = '''
from piaffe import ocp

ball = ocp.Model(
    "ball", state={"z": 1, "vz": 1}, control={"thrust": 1},
    modes={"fall": lambda s: {"z": s.vz, "vz": s.thrust - 9.81}},
)
bounce = ocp.Motion(
    ocp.Phase("drop", "fall", 0.45, until=ocp.equality(lambda s: s.z, name="ground", unit="m"),
              reset=ocp.reset(lambda s: {"vz": -0.8 * s.vz})),
    ocp.Phase("rise", "fall", 0.40, {"z": 0.6}),
)
objective = ocp.Objective(ocp.track("z", 10.0, at="end"), ocp.regularize("thrust", 0.1))
limits = ocp.Constraints(ocp.inequality(lambda s: s.thrust, lower=-3, upper=3, name="thrust limit", unit="N"))
problem = ocp.Problem(bounce, ball.until_end(dt=0.01), objective, limits, initial=[1.0, 0.0])


def made():
    """Return the problem from another height."""
    return problem.with_initial([1.1, 0.0])


def broken():
    return 1 / 0


kink = ocp.Problem(
    ocp.Motion(ocp.Phase("fall", "fall", 0.1)), ball.until_end(dt=0.05),
    objective + ocp.residual(lambda s: abs(s.z - 1.0)).weighted(1.0, name="kink"), initial=[1.0, 0.0],
)
singular = ocp.Problem(
    ocp.Motion(ocp.Phase("fall", "fall", 0.1)), ball.until_end(dt=0.05),
    objective + ocp.residual(lambda s: s.vz**0.5).weighted(1.0, name="root"), initial=[1.0, 0.0],
)
impossible = ocp.Problem(
    ocp.Motion(ocp.Phase("fall", "fall", 0.1)), ball.until_end(dt=0.05), objective,
    ocp.Constraints(ocp.inequality(lambda s: s.z, lower=2.0, name="ceiling", unit="m")), initial=[1.0, 0.0],
)
'''

HOP = """
from piaffe import models, ocp
from piaffe.models import base, joints, stance

body = models.WholeBody(models.load("mini_cheetah"))
feet = stance("FL FR HL HR")
hop = ocp.Motion(
    ocp.Phase("push", feet, 0.16, ocp.Keyframe(position=(0, 0, 0.28), joints="stand")),
    ocp.Phase("flight", stance(""), 0.12, ocp.Keyframe(position=(0, 0, 0.27), joints="stand")),
    ocp.Phase("land", feet, 0.12, ocp.Keyframe(position=(0, 0, 0.25), joints="stand")),
)
objective = ocp.Objective(
    ocp.track(base.position, 10.0), ocp.track(base.orientation, 5.0), ocp.track(base.linear_velocity, 1.0),
    ocp.track(base.angular_velocity, 1.0), ocp.track(joints.position, 0.1), ocp.track(joints.velocity, 0.05),
    ocp.regularize(joints.torque, 0.1),
)
limits = ocp.Constraints(models.friction_cone(mu=0.6), models.torque_limits(), models.joint_limits())
problem = ocp.Problem(hop, body.until_end(dt=0.02), objective, limits, initial=body.state(joints="stand"))
"""

SAMPLED = """
from piaffe import models, ocp, sampling
from piaffe.models import base, joints

robot = models.load("solo12")
body = models.WholeBody(robot)
trot = models.gaits.trot(0.3)
objective = ocp.Objective(
    ocp.track(base.linear_velocity, weight=2.0), ocp.track(base.orientation, weight=1.0),
    ocp.regularize(joints.torque, weight=1e-3),
)
limits = ocp.Constraints(
    ocp.inequality(lambda s: s.joints.position["FL_HAA"], lower=-0.2, upper=0.2, name="hip", unit="rad", scale=0.2),
    ocp.inequality(lambda s: s.base.height, upper=0.1, name="ceiling", unit="m", scale=0.1),
)
start = body.state(joints="stand")
reward = sampling.Reward(scale=0.5)
options = {"dial": {"samples": 12, "first_stages": 2}, "td-cd": {"samples": 10, "first_stages": 1}}


def sampled_problem(slope: float = 0.0, ground: str = "flat") -> ocp.Problem:
    if ground not in ("flat", "soft"):
        raise ValueError(f"no ground '{ground}'")
    plant = models.Mujoco(robot)
    return ocp.Problem(trot, plant.over(0.08, dt=0.02), objective, limits, initial=start)


problem = ocp.Problem(trot.cycles(1), body.until_end(dt=0.01), objective, initial=start)


def needs(height: float) -> ocp.Problem:
    return sampled_problem()


def clashes(steps: int = 3) -> ocp.Problem:
    return sampled_problem()
"""


@pytest.fixture(scope="session")
def ball_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ball") / "ball.py"
    path.write_text(BALL)
    return path


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own for each test: `solve` saves into its `results`."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def hop_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hop") / "hop.py"
    path.write_text(HOP)
    return path


@pytest.fixture(scope="session")
def ball(ball_file: Path) -> Path:
    """The ball's solution."""
    saved = ball_file.with_suffix(".npz")
    assert main(["solve", str(ball_file), "--save", str(saved), "--json"]) == 0
    return saved


@pytest.fixture(scope="session")
def hop(hop_file: Path) -> Path:
    """The hop's solution."""
    saved = hop_file.with_suffix(".npz")
    assert main(["solve", str(hop_file), "--save", str(saved), "--json"]) == 0
    return saved


@pytest.fixture(scope="session")
def sampled_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sampled") / "sampled.py"
    path.write_text(SAMPLED)
    return path
