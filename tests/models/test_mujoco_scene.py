"""MuJoCo scenes: the same robot, in numbers and in looks."""

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.errors import ModelError
from piaffe.models.mujoco.scene import body_names, mujoco_model, mujoco_spec
from piaffe.models.terrain import FLOOR
from tests.robots import ROBOTS


@pytest.fixture(scope="module", params=[*ROBOTS, "mini_cheetah with rotors"])
def robot(request):
    name, *more = request.param.split(" with ")
    return models.load(name, rotors=bool(more))


def random_state(rng, robot):
    x = np.concatenate([rng.normal(size=7), rng.uniform(-2, 2, robot.num_joints), rng.normal(size=robot.model.nv)])
    x[3:7] /= np.linalg.norm(x[3:7])
    return x


def test_joints_actuators_and_limits_are_in_state_order(robot):
    model = mujoco_model(robot, visuals=False)
    assert (model.nq, model.nv, model.nu) == (7 + robot.num_joints, 6 + robot.num_joints, robot.num_joints)
    assert tuple(model.actuator(i).name for i in range(model.nu)) == robot.joint_names
    assert [model.jnt_qposadr[i + 1] for i in range(robot.num_joints)] == list(range(7, model.nq))
    assert model.actuator_ctrlrange[:, 1] == pytest.approx(robot.torque_limit)
    assert model.actuator_gear[:, 0] == pytest.approx(1.0)
    assert model.jnt_range[1:] == pytest.approx(np.column_stack([robot.joint_lower, robot.joint_upper]))
    assert model.dof_armature[6:] == pytest.approx(robot.armature)
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()


def test_damping_and_dry_friction_are_the_robot_s():
    damping, friction = np.tile([0.1, 0.2, 0.3], 4), np.tile([0.5, 0.6, 0.7], 4)
    robot = models.load("go2", joint_damping=damping, joint_friction=friction)
    off = mujoco.mjtDisableBit
    unused = off.mjDSBL_FRICTIONLOSS | off.mjDSBL_DAMPER | off.mjDSBL_EULERDAMP
    plant = models.Mujoco(robot)
    for model in (mujoco_model(robot, visuals=False), plant.compiled(), plant.as_plant().compiled()):
        assert model.dof_damping[6:] == pytest.approx(damping)
        assert model.dof_frictionloss[6:] == pytest.approx(friction)
        assert not model.dof_damping[:6].any()
        assert not model.dof_frictionloss[:6].any()
        assert not model.opt.disableflags & int(unused)
    damped = models.load("go2", joint_damping=0.1)
    flags = models.Mujoco(damped).compiled().opt.disableflags
    assert flags & int(unused) == int(off.mjDSBL_FRICTIONLOSS)
    assert models.Mujoco(models.load("go2")).compiled().opt.disableflags & int(unused) == int(unused)


def test_every_inertial_is_that_of_the_pinocchio_model(robot):
    model = mujoco_model(robot, visuals=True, meshes=False)
    assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-12)
    for name, inertia in zip(body_names(robot), list(robot.model.inertias)[1:], strict=True):
        body = model.body(name)
        assert body.mass[0] == pytest.approx(inertia.mass, rel=1e-12)
        assert body.ipos == pytest.approx(inertia.lever, abs=1e-12)
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, body.iquat)
        about = axes.reshape(3, 3) @ np.diag(body.inertia) @ axes.reshape(3, 3).T
        assert about == pytest.approx(inertia.inertia, abs=1e-9 * np.trace(inertia.inertia))


def test_flight_acceleration_matches_the_whole_body_model(robot):
    body, model = models.WholeBody(robot), mujoco_model(robot, visuals=False)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(10):
        x, u = random_state(rng, robot), rng.uniform(-1, 1, robot.num_joints) * np.minimum(robot.torque_limit, 10.0)
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[: model.nq], x[model.nq :], u
        mujoco.mj_forward(model, data)
        assert np.max(np.abs(body.acceleration(x, u, "") - data.qacc)) < 1e-8 * np.max(np.abs(data.qacc))


def test_plus_is_mujoco_s_integration_of_positions(robot):
    body, model = models.WholeBody(robot), mujoco_model(robot, visuals=False)
    rng = np.random.default_rng(1)
    for dt in (0.01, 0.5, -0.3):
        x, v = random_state(rng, robot), rng.normal(size=model.nv)
        q = x[: model.nq].copy()
        mujoco.mj_integratePos(model, q, v, dt)
        moved = body.state.np_plus(x, np.concatenate([v * dt, np.zeros(model.nv)]))
        assert moved[: model.nq] == pytest.approx(q, rel=1e-8, abs=1e-9)


def test_feet_are_balls_at_the_feet_s_frames(robot):
    model, legs = mujoco_model(robot, visuals=False), models.Kinematics(robot)
    data, rng = mujoco.MjData(model), np.random.default_rng(2)
    x = random_state(rng, robot)
    data.qpos[:] = x[: model.nq]
    mujoco.mj_kinematics(model, data)
    feet = legs.world_feet(x[:3], x[3:7], x[7 : model.nq])
    for i, foot in enumerate(robot.feet):
        assert data.geom(foot.name).xpos == pytest.approx(feet[i], abs=1e-9)
        assert data.site(foot.name).xpos == pytest.approx(feet[i], abs=1e-9)
        assert model.geom(foot.name).size[0] == robot.foot_radius


def test_standing_under_stiff_joints_rests_on_four_feet():
    robot = models.load("mini_cheetah")
    model = mujoco_model(robot, visuals=False)
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = robot.base_height(), robot.pose("stand")
    for _ in range(500):
        data.ctrl[:] = 100 * (robot.pose("stand") - data.qpos[7:]) - 2.0 * data.qvel[6:]
        mujoco.mj_step(model, data)
    touching = {model.geom(g).name for contact in data.contact for g in contact.geom}
    assert touching == {FLOOR, *robot.foot_names}
    assert np.abs(data.qvel[:6]).max() < 0.02
    force = sum(np.linalg.norm(_contact_force(model, data, i)[:3]) for i in range(data.ncon))
    assert force == pytest.approx(robot.mass * 9.81, rel=0.1)
    assert data.contact[0].friction[0] == pytest.approx(0.6)


def _contact_force(model, data, i):
    force = np.zeros(6)
    mujoco.mj_contactForce(model, data, i, force)
    return force


def test_contacts_can_be_left_out_or_taken_of_all_shapes():
    robot = models.load("mini_cheetah")
    touched = {}
    for contacts in ("none", "feet", "all"):
        model = mujoco_model(robot, contacts=contacts)
        data = mujoco.MjData(model)
        data.qpos[2], data.qpos[3:7], data.qpos[7:] = 0.05, (0, 1, 0, 0), robot.pose("crouch")  # on its back
        mujoco.mj_step(model, data, 5)
        touched[contacts] = {model.geom(g).name for contact in data.contact for g in contact.geom} - {FLOOR}
    assert touched["none"] == touched["feet"] == set()
    assert touched["all"] == {""}, "shapes of the body have no names"


def test_a_foot_of_radius_zero_is_a_ball_of_a_millimetre():
    model = mujoco_model(models.load("mini_cheetah", foot_radius=0.0))
    assert model.geom("FL").size[0] == 1e-3


def test_drawings_have_no_mass_and_a_camera_follows(robot):
    drawn, bare = mujoco_model(robot, meshes=False), mujoco_model(robot, visuals=False)
    assert drawn.ngeom > bare.ngeom + 8
    assert drawn.body_mass == pytest.approx(bare.body_mass)
    assert drawn.camera("track").bodyid[0] == 1


def test_the_spec_can_be_changed_before_it_is_compiled():
    spec = mujoco_spec(models.load("mini_cheetah"))
    spec.worldbody.add_geom(name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.1, 0.1))
    assert spec.compile().geom("box").id > 0


def test_an_inertia_that_mujoco_cannot_hold_is_named(tmp_path):
    cheetah = models.load("mini_cheetah")
    urdf = tmp_path / "light.urdf"
    urdf.write_text(
        cheetah.urdf.read_text().replace('<mass value="0.064"/>', '<mass value="1e-16"/>').replace('0.000006"', '0"')
    )
    robot = models.load(urdf, feet=("FL_FOOT",), name="light")
    with pytest.raises(ModelError, match=r"(?s)robot 'light': MuJoCo does not compile it - .*(mass|inertia).*doctor"):
        mujoco_model(robot)
