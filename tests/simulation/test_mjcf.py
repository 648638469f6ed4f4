"""MJCF files as plants: matched by names, compared by geometry, simulated with their own numbers."""

import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError, UnknownNameError
from piaffe.models import Fall
from piaffe.simulation import Actuators, Plant, run_online
from tests.simulation import other_go2
from tests.simulation.online import Angles, Springs
from tests.simulation.other_go2 import FEET, FILE, JOINTS, ROBOT

BODY = models.WholeBody(ROBOT)
STAND = ROBOT.pose("stand")
START = BODY.state(joints="stand")
NEVER = Fall(tilt=np.pi, height=-np.inf)


def load(path: Path | str = FILE, **changes: Any) -> Plant:
    return Plant.from_mjcf(path, ROBOT, **{"joints": JOINTS, "feet": FEET, **changes})


def rewritten(folder: Path, *changes: tuple[str, str]) -> Path:
    """Return a copy of the file with other text in some places."""
    text = FILE.read_text()
    for old, new in changes:
        assert re.search(old, text), old
        text = re.sub(old, new, text)
    (folder / "changed.xml").write_text(text)
    return folder / "changed.xml"


class Stiff(Springs):
    """Springs that carry the robot."""

    def control(self, x: np.ndarray, t: float) -> np.ndarray:
        assert self.plan is not None
        return 60.0 * (self.plan.target - x[7:19]) - 2.0 * x[25:37]


def test_the_file_is_what_its_generator_writes() -> None:
    assert FILE.read_text() == other_go2.text()


def test_joints_and_feet_are_matched_in_another_order_and_under_other_names() -> None:
    plant = load()
    model = plant.scene.compiled
    x = START + np.concatenate([np.zeros(7), np.linspace(-0.1, 0.1, 12), np.linspace(-1, 1, 18)])
    data = plant.simulate(x)._data
    for i, name in enumerate(ROBOT.joint_names):
        joint = model.joint(JOINTS[name])
        assert data.qpos[joint.qposadr[0]] == x[7 + i]
        assert data.qvel[joint.dofadr[0]] == x[25 + i]
    assert plant.scene.feet != tuple(sorted(plant.scene.feet))  # legs have another order
    for foot, geom in zip(ROBOT.foot_names, plant.scene.feet, strict=True):
        assert model.geom_bodyid[geom] == model.site(FEET[foot]).bodyid[0]
    np.testing.assert_array_equal(plant.simulate(x).state, x)


def test_the_files_own_numbers_count() -> None:
    plant = load()
    model, weight = plant.scene.compiled, 0.95 * ROBOT.mass * 9.81
    assert plant.simulate(START).weight == pytest.approx(weight, rel=1e-5)
    dofs = plant.scene.velocities[6:]
    np.testing.assert_array_equal(model.dof_armature[dofs], np.tile([0.012, 0.012, 0.036], 4))
    np.testing.assert_array_equal(model.dof_damping[dofs], np.tile([0.15, 0.18, 0.24], 4))
    np.testing.assert_array_equal(model.dof_frictionloss[dofs], np.tile([0.2, 0.4, 1.0], 4))
    np.testing.assert_allclose(plant.torque_limit, np.tile([23.0, 23.0, 44.0], 4))  # through the gear of the knees
    assert (plant.timestep, model.opt.impratio) == (0.001, 10.0)
    made = run_online(None, Stiff(Angles(STAND)), plant, seconds=1.5, initial=START)
    assert made.success
    assert made.forces[-1, :, 2].sum() == pytest.approx(weight, rel=0.01)
    other = load(friction=0.3, actuators=Actuators(friction=0.0, torque_limit=5.0), mass_scale={"trunk": 2.0})
    assert np.all(other.scene.compiled.geom_friction[:, 0] == 0.3)
    assert not other.scene.compiled.dof_frictionloss.any()
    np.testing.assert_array_equal(other.torque_limit, 5.0)
    np.testing.assert_array_equal(other.scene.compiled.dof_damping[dofs], np.tile([0.15, 0.18, 0.24], 4))


def test_with_our_numbers_a_file_moves_as_our_own_plant(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    zero = dict.fromkeys(("hip", "thigh", "calf"), 0.0)
    for name, value in (
        ("LIGHTER", 1.0),
        ("ASIDE", (0, 0, 0)),
        ("ARMATURE", {**zero, "calf": 0.02}),
        ("LIMIT", dict.fromkeys(zero, 8.0)),
    ):
        monkeypatch.setattr(other_go2, name, value)
    monkeypatch.setattr(other_go2, "_n", lambda *values: " ".join(repr(float(v)) for v in values))
    text = other_go2.text().replace('integrator="implicitfast"', 'integrator="Euler"')
    (tmp_path / "same.xml").write_text(text)
    numbers = {"armature": {"hip_joint": 0.0, "thigh_joint": 0.0, "calf_joint": 0.02}}
    numbers |= {"damping": np.tile([0.15, 0.18, 0.24], 4), "friction": np.tile([0.2, 0.4, 1.0], 4)}  # type: ignore[dict-item]
    ours = Plant(ROBOT, actuators=Actuators(**numbers, torque_limit=8.0))  # type: ignore[arg-type]
    high = BODY.state(joints="stand", position=(0, 0, 3.0), linear_velocity=(1, 0, 0), angular_velocity=(1, 2, -1))
    target = STAND + 0.4 * np.sin(np.arange(12))
    made = [
        run_online(None, Stiff(Angles(target)), plant, seconds=0.2, tick=1e-3, initial=high, fall=NEVER)
        for plant in (ours, load(tmp_path / "same.xml"))
    ]
    np.testing.assert_allclose(made[1].states, made[0].states, atol=1e-7)
    assert np.abs(made[0].last[7:19] - STAND).max() > 0.1
    assert made[0].limited.any()


@pytest.mark.parametrize("kind", ["geom", "site", "body"])
def test_a_foot_is_a_geom_a_site_or_a_body(tmp_path: Path, kind: str) -> None:
    text = FILE.read_text()
    feet = dict(FEET)
    if kind == "geom":
        text = re.sub(r'(<geom )(type="sphere".*\n.*<site name=")(\w+)_toe', r'\1name="\3_ball" \2\3_toe', text)
        feet = {leg: f"{name}_ball" for leg, name in other_go2.LEGS.items()}
    elif kind == "body":
        feet = {leg: f"{name}_calf" for leg, name in other_go2.LEGS.items()}
    (tmp_path / "feet.xml").write_text(text)
    plant = load(tmp_path / "feet.xml", feet=feet)
    assert plant.scene.feet == load().scene.feet


def test_default_names_of_feet_and_joints_are_the_robots(tmp_path: Path) -> None:
    text = FILE.read_text()
    for ours, theirs in JOINTS.items():
        text = text.replace(f'"{theirs}"', f'"{ours}"')
    for leg, site in FEET.items():
        text = text.replace(f'"{site}"', f'"{leg}_foot"')
    (tmp_path / "ours.xml").write_text(text)
    plant = Plant.from_mjcf(tmp_path / "ours.xml", ROBOT)
    np.testing.assert_array_equal(plant.scene.positions, load().scene.positions)


def test_a_file_without_ground_gets_one_and_one_with_other_bodies_keeps_them(tmp_path: Path) -> None:
    bare = rewritten(tmp_path, (r'    <geom name="ground".*\n', ""))
    low = models.terrain.flat(-0.5)
    plant = load(bare, terrain=low)
    on_it = BODY.state(joints="stand", position=(0, 0, ROBOT.base_height() - 0.5))
    assert run_online(None, Stiff(Angles(STAND)), plant, seconds=1.0, initial=on_it).success
    assert run_online(None, Stiff(Angles(STAND)), load(bare), seconds=1.0, initial=START).success
    ball = '<body name="ball" pos="2 0 1"><freejoint name="rolls"/><geom type="sphere" size="0.1" mass="1"/></body>'
    beside = rewritten(tmp_path, (r"  <worldbody>\n", f"  <worldbody>\n{ball}\n"))
    plant = load(beside)
    assert plant.scene.positions[0] == 7
    np.testing.assert_array_equal(plant.simulate(START).state, START)
    assert plant.simulate(START).weight == pytest.approx(0.95 * ROBOT.mass * 9.81, rel=1e-5)
    with_ball = run_online(None, Stiff(Angles(STAND)), plant, seconds=0.5, initial=START)
    alone = run_online(None, Stiff(Angles(STAND)), load(), seconds=0.5, initial=START)
    np.testing.assert_allclose(with_ball.last, alone.last, atol=1e-6)
    raised = rewritten(tmp_path, (r'name="ground" type="plane"', 'name="ground" type="plane" pos="0 0 0.4"'))
    on_it = BODY.state(joints="stand", position=(0, 0, ROBOT.base_height() + 0.4))
    assert run_online(None, Stiff(Angles(STAND)), load(raised), seconds=0.2, initial=on_it).success
    assert run_online(None, Stiff(Angles(STAND)), load(raised), seconds=0.2, initial=START).fell


def test_limits_come_from_joints_actuators_or_the_robot(tmp_path: Path) -> None:
    limited = r'axis="0 1 0" actuatorfrcrange="-9 9"'
    both = rewritten(
        tmp_path,
        (r'(joint name="front_left_knee" )axis="0 1 0"', rf"\1{limited}"),
        (r'    <motor name="hind_left_hip.*\n', ""),
    )
    limit = dict(zip(ROBOT.joint_names, load(both).torque_limit, strict=True))
    assert limit["FL_calf_joint"] == 9.0
    assert limit["FR_calf_joint"] == 44.0
    assert limit["RL_hip_joint"] == ROBOT.torque_limit[0] != 23.0


def test_the_files_actuators_do_not_act(tmp_path: Path) -> None:
    servo = '    <position joint="front_left_knee" kp="100"/>\n  </actuator>'
    made = [
        run_online(None, Stiff(Angles(STAND)), load(path), seconds=0.2, initial=START).last
        for path in (FILE, rewritten(tmp_path, (r"  </actuator>", servo)))
    ]
    np.testing.assert_array_equal(made[0], made[1])


def test_collisions_are_of_the_robot_with_the_ground(tmp_path: Path) -> None:
    ball = '<body name="ball" pos="2 0 0.1"><freejoint/><geom type="sphere" size="0.1" mass="1"/></body>'
    inside = '<geom name="inner" type="sphere" size="0.2" mass="0"/>'  # touches parts of the legs, not the ground
    knee = '<geom type="sphere" size="0.05" mass="0"/>'
    changes = [
        (r"  <worldbody>\n", f"  <worldbody>\n{ball}\n"),
        (r'(      <geom name="belly")', rf"      {inside}\n\1"),
    ]
    crowded = rewritten(tmp_path, *changes, (r'(      +<joint name="front_left_hip")', rf"        {knee}\n\1"))
    low = Stiff(Angles(STAND))
    made = run_online(None, low, load(crowded), seconds=0.05, initial=START)
    assert made.collisions == {}
    limp = Stiff(Angles(STAND))
    limp.control = lambda x, t: np.zeros(12)  # type: ignore[method-assign]
    plants = [(load(crowded), "inner"), (load(), "belly")]
    plants.append((load(rewritten(tmp_path, (r'name="belly" ', ""))), "trunk"))  # a geom without a name
    for plant, name in plants:
        fallen = run_online(None, limp, plant, seconds=1.5, initial=START, fall=NEVER)
        assert set(fallen.collisions) == {name}
        assert fallen.collisions[name] > 0.1


ERRORS: list[tuple[dict[str, Any], list[tuple[str, str]], str]] = [
    ({"joints": {}}, [], "joints of robot 'go2' are missing - got front_left_abduction, front_left_hip,"),
    ({"joints": {**JOINTS, "FL_hip_joint": "hip"}}, [], "are missing - got front_left_abduction, expected hip; give"),
    ({"joints": {**JOINTS, "FL_hip_joint": "front_left_hip"}}, [], "got 'front_left_hip' for 'FL_thigh_joint' and"),
    (
        {"joints": {**JOINTS, "FL_hip_joint": "hind_left_abduction", "RL_hip_joint": "front_left_abduction"}}, [],
        "its axis is not that of",
    ),
    ({"feet": {**FEET, "FL": "front_right_toe"}}, [], "foot 'FL': it is not where the robot's is - got (0.2"),
    ({"feet": {**FEET, "FL": "front_left_hip"}}, [], "foot 'FL': 'front_left_hip' does not collide - got no geom with"),
    ({"tolerance": 0.001}, [], "foot 'FL': it is not where the robot's is"),
    ({"terrain": models.terrain.flat()}, [], "it has a ground of its own - got terrain=Flat(level=0.0) and geoms"),
    ({}, [(r'axis="1 0 0"', 'axis="-1 0 0"')], "its axis is not that of 'FL_hip_joint' - got (-1.000, 0.000,"),
    ({}, [(r'      <freejoint name="floating"/>\n', "")], "robot 'go2' has no free joint - got joints under"),
    ({}, [(r'<joint name="hind_left_knee"', '<joint type="slide" name="hind_left_knee"')], "it is of another kind"),
    (
        {}, [(r'(<geom name="belly")', r'<body name="head"><joint name="neck"/><geom size="0.1"/></body>\1')],
        "it has joints that robot 'go2' does not have - got neck, expected only",
    ),
    (
        {}, [(r'(<body name="front_left_thigh" pos=")0 0\.', r"\g<1>0.03 0.")],
        "joint 'front_left_hip': it is not where 'FL_thigh_joint' is - got 30.0 mm between their axes in the compared",
    ),
    ({}, [("</mujoco>", "</mujoko>")], "MuJoCo cannot read it - got 'XML"),
    ({"timestep": 0.005}, [], "plant: timestep is out of range"),
    ({"friction": -1.0}, [], "plant: friction is out of range"),
]  # fmt: skip


@pytest.mark.parametrize(("options", "changes", "text"), ERRORS)
def test_what_does_not_match_is_named(
    tmp_path: Path, options: dict[str, Any], changes: list[tuple[str, str]], text: str
) -> None:
    with pytest.raises(ModelError, match=re.escape(text)):
        load(rewritten(tmp_path, *changes), **options)


def test_names_that_do_not_exist_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="joints: no joint of the robot 'FL_hip'"):
        load(joints={**JOINTS, "FL_hip": "front_left_hip"})
    with pytest.raises(UnknownNameError, match="feet: no foot of the robot 'LF'"):
        load(feet={**FEET, "LF": "front_left_toe"})
    with pytest.raises(UnknownNameError, match="foot 'FL': no geom, site or body 'FL or FL_foot'"):
        load(feet={})
    with pytest.raises(ModelError, match="no such file"):
        load(tmp_path / "none.xml")
    assert mujoco.MjModel.from_xml_path(str(FILE)).nu == 12
