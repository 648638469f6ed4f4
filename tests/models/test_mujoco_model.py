"""MuJoCo as a model of the schedule: the whole body's quantities, the PD law, the simulator that goes with them."""

from math import inf, pi

import casadi as cs
import mujoco
import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ModelError, ProblemError
from piaffe.models import base, com, feet, frames, joints, momentum, terrain
from piaffe.models.mujoco.scene import compile_spec
from piaffe.ocp import rotation

ROBOT = models.load("solo12")
BODY = models.WholeBody(ROBOT)
PLANT = models.Mujoco(ROBOT)
SHARED = [
    base.position, base.orientation, base.linear_velocity, base.angular_velocity, base.height, base.ground_normal,
    joints.position, joints.velocity, feet.position, feet.velocity, feet.height, feet.reach, feet.contact, feet.landing,
    feet.lifting, com.position, com.velocity, momentum, frames["FL_KFE"].position, frames["HR_KFE"].velocity,
]  # fmt: skip


def random_state(rng, robot=ROBOT):
    x = np.concatenate([rng.normal(size=7), rng.uniform(-1, 1, robot.num_joints), rng.normal(size=robot.model.nv)])
    x[3:7] /= np.linalg.norm(x[3:7])
    return x


def evaluate(model, quantity, x, u, **slots):
    """Return a quantity's value, its labels too, at a state and control."""
    X, U = cs.SX.sym("x", model.state.nx), cs.SX.sym("u", model.control.nx)
    z, p = cs.SX.zeros(model.implicit_size("contact")), {k: cs.SX(v) for k, v in model.numbers(**slots).items()}
    bound = model.dynamics("contact", X, U, z, {**p, "dt": cs.SX(0.02)}).quantities.bind(quantity)
    return cs.Function("value", [X, U], [bound.value])(x, u).full().ravel(), bound.labels


def problem(model, *, motion=None, without=(), objective=None, constraints=None, dt=0.02, length=0.16, initial=None):
    objective = objective or ocp.Objective(ocp.track(base.linear_velocity), ocp.regularize(joints.torque, 0.01))
    return ocp.Problem(
        motion or models.gaits.trot(0.3, intro=0.04), model.over(length, dt=dt).without(*without), objective,
        constraints or ocp.Constraints(), initial=BODY.state() if initial is None else initial,
    )  # fmt: skip


# ---- quantities


@pytest.mark.parametrize("quantity", SHARED, ids=str)
def test_quantities_are_the_whole_body_s(quantity):
    rng, flags = np.random.default_rng(0), {"contact": [1, 0, 0, 1], "landing": [0, 1, 0, 0], "lifting": [0, 0, 1, 0]}
    for _ in range(5):
        x, u = random_state(rng), rng.normal(size=12)
        mine, labels = evaluate(PLANT, quantity, x, u, **flags)
        theirs, expected = evaluate(BODY, quantity, x, u, **flags)
        assert labels == expected
        assert mine == pytest.approx(theirs, abs=1e-12)


def test_state_is_the_whole_body_s():
    assert PLANT.state.blocks == BODY.state.blocks
    assert PLANT.state(joints="crouch") == pytest.approx(BODY.state(joints="crouch"))


def test_rows_that_both_models_have_are_equal():
    shared = ocp.Objective(
        *(ocp.regularize(quantity, 1.0) for quantity in (base.height, feet.position, com.velocity, momentum))
    )
    limits = ocp.Constraints(
        models.base_height(0.1, maximum=0.3), models.joint_range("HAA", 0.2), models.joint_limits()
    )
    rng = np.random.default_rng(1)
    sizes = {}
    for model in (PLANT, BODY):
        lowered = ocp.compile_problem(
            problem(model, objective=shared, constraints=limits), checks=False
        ).phases[0]  # fmt: skip
        p, mode, rng = lowered.p[0], lowered.mode, np.random.default_rng(1)
        rows = []
        for _ in range(5):
            values = mode.functions["stage"](random_state(rng), rng.normal(size=12), np.zeros(mode.nz), p)
            rows.append(np.concatenate([value.full().ravel() for value in values[-3:]]))
        sizes[model] = np.array(rows)
    assert sizes[PLANT] == pytest.approx(sizes[BODY], abs=1e-12)


def test_heights_are_above_the_terrain():
    rng, ground = np.random.default_rng(2), terrain.stairs(0.05, 0.25, start=-0.4)
    plant = models.Mujoco(ROBOT, terrain=ground)
    for _ in range(5):
        x = random_state(rng)
        places = evaluate(plant, feet.position, x, np.zeros(12))[0].reshape(4, 3)
        below = ground.height(places[:, 0], places[:, 1])
        gaps = places[:, 2] - below - ROBOT.foot_radius
        assert evaluate(plant, feet.height, x, np.zeros(12))[0] == pytest.approx(gaps, abs=1e-12)
        assert evaluate(plant, base.height, x, np.zeros(12))[0] == pytest.approx([x[2] - below.mean()], abs=1e-12)
        assert plant.height_above_terrain(x) == pytest.approx(x[2] - below.mean(), abs=1e-12)


def test_ground_normal_of_a_base_that_leans_with_the_slope_is_its_own_axis():
    angle = 0.3
    plant = models.Mujoco(ROBOT, terrain=terrain.incline(angle, start=-inf, direction=0.5))
    lean = rotation.np_multiply(
        rotation.np_from_rpy(np.array([0.0, 0.0, 0.5])), rotation.np_from_rpy(np.array([0.0, -angle, 0.0]))
    )
    for yaw in (0.0, 1.0, -2.0):
        x = PLANT.state()
        x[3:7] = rotation.np_multiply(lean, rotation.np_from_rpy(np.array([0.0, 0.0, yaw])))
        assert evaluate(plant, base.ground_normal, x, np.zeros(12))[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-4)
    x[3:7] = rotation.np_from_rpy(np.array([0.2, 0.0, 0.5]))
    rolled = evaluate(PLANT, base.ground_normal, x, np.zeros(12))[0]
    assert rolled == pytest.approx([0.0, np.sin(0.2), np.cos(0.2)], abs=1e-12)


def test_reach_of_feet_is_in_heading_axes():
    rng = np.random.default_rng(6)
    for _ in range(5):
        x = random_state(rng)
        yaw = rotation.np_to_rpy(x[3:7])[2]
        places = evaluate(PLANT, feet.position, x, np.zeros(12))[0].reshape(4, 3)[:, :2] - x[:2]
        c, s = np.cos(yaw), np.sin(yaw)
        expected = np.column_stack([places @ [c, s], places @ [-s, c]])
        value, labels = evaluate(PLANT, feet.reach, x, np.zeros(12))
        assert value == pytest.approx(expected.ravel(), abs=1e-9)
        assert labels[:2] == ("FL ahead", "FL left")


def test_single_rigid_body_and_whole_body_stand_on_their_terrain_s_height():
    rigid, x = models.SingleRigidBody(ROBOT), random_state(np.random.default_rng(3))
    assert evaluate(BODY, base.height, x, np.zeros(12), terrain=0.2)[0] == pytest.approx([x[2] - 0.2])
    assert evaluate(rigid, base.height, x[[*range(7), *range(19, 25)]], np.zeros(12), terrain=0.2)[0] == pytest.approx(
        [x[2] - 0.2]
    )


def test_a_gait_s_heights_are_those_of_its_feet_and_base():
    path = models.gaits.trot(0.3, intro=0.04, height=0.22).bind((PLANT,), PLANT.state.unpack(BODY.state()))
    for t in np.arange(0.0, 1.5, 0.013):
        sample = path.sample(t, path.interval_at(t))
        place = sample[feet.position].reshape(4, 3)[:, 2] - ROBOT.foot_radius
        assert sample[feet.height] == pytest.approx(place)
        assert sample[base.height] == pytest.approx([sample[base.position][2]])
        x = BODY.state.pack({name: sample[name] for name in BODY.state.unpack(BODY.state())})
        for quantity in (feet.reach, base.ground_normal):
            assert sample[quantity] == pytest.approx(evaluate(BODY, quantity, x, np.zeros(12))[0], abs=2e-3)
    assert sample[base.height] == pytest.approx([0.22])
    late = np.array([path.sample(t, path.interval_at(t))[feet.height] for t in np.arange(2.0, 2.5, 0.01)])
    assert late.min() == pytest.approx(0.0, abs=1e-12)
    assert (late.max(axis=0) > 0.02).all()


# ---- actions


def test_torque_of_joint_targets_is_the_pd_law():
    rng = np.random.default_rng(4)
    kp = {"HAA": 3.0, "HFE": 4.0, "KFE": 5.0}
    plant = models.Mujoco(ROBOT, action=models.joint_targets(kp, kd=np.arange(12) / 10))
    x, u = random_state(rng), rng.normal(size=12)
    by_hand = np.tile([3.0, 4.0, 5.0], 4) * (u - x[7:19]) - np.arange(12) / 10 * x[25:]
    assert evaluate(plant, joints.torque, x, u)[0] == pytest.approx(by_hand, abs=1e-14)
    assert plant.action.torque(u, x[7:19], x[25:]) == pytest.approx(by_hand, abs=1e-14)
    assert evaluate(plant, joints.target, x, u)[0] == pytest.approx(u)


def test_one_step_of_joint_targets_is_a_step_of_their_torques():
    rng = np.random.default_rng(5)
    pushed = models.Mujoco(ROBOT, action=models.torques(), armature=PLANT.compiled().dof_armature[6:])
    for _ in range(5):
        x, target = random_state(rng), PLANT.action.centre + 0.3 * rng.normal(size=12)
        x[25:] *= 0.3
        torque = np.clip(PLANT.action.torque(target, x[7:19], x[25:]), -ROBOT.torque_limit, ROBOT.torque_limit)
        after = []
        for model, control in ((PLANT.compiled(), target), (pushed.compiled(), torque)):
            data = mujoco.MjData(model)
            data.qpos[:], data.qvel[:], data.ctrl[:] = x[:19], x[19:], control
            mujoco.mj_step(model, data)
            after.append(np.concatenate([data.qpos, data.qvel]))
            assert data.actuator_force == pytest.approx(torque, abs=1e-12)
        assert after[0] == pytest.approx(after[1], rel=1e-12, abs=1e-12)


def test_ranges_of_actions():
    action = models.joint_targets(centre={"HAA": 0.1}, half_range={"HAA": 0.3, "HFE": 0.4, "KFE": 0.5}).bind(ROBOT)
    assert action.centre == pytest.approx(ROBOT.pose({"HAA": 0.1}))
    assert action.upper - action.lower == pytest.approx(np.tile([0.6, 0.8, 1.0], 4))
    assert models.torques().bind(ROBOT).upper == pytest.approx(ROBOT.torque_limit)
    assert models.Mujoco(ROBOT, action=models.torques(1.0)).control.labels[0] == "joints.torque FL_HAA"


def test_default_gains_are_in_proportion_to_the_torque_limits():
    solo, go2 = (models.joint_targets().bind(robot) for robot in (ROBOT, models.load("go2")))
    assert solo.kp == pytest.approx(4.0)
    assert solo.kd == pytest.approx(0.2)
    assert go2.kp == pytest.approx(models.load("go2").torque_limit / 0.675)


def test_numbers_of_an_action_that_leave_joints_out():
    with pytest.raises(ModelError, match="joint_targets, half_range of 'solo12': no number for joint 'FL_KFE' - got"):
        models.Mujoco(ROBOT, action=models.joint_targets(half_range={"HAA": 0.3, "HFE": 0.4}))
    with pytest.raises(ModelError, match="joint_targets, kp of 'solo12': no number for joint 'FL_HAA' - got -1"):
        models.Mujoco(ROBOT, action=models.joint_targets(kp=-1))


def test_initial_controls_hold_the_path_s_joints():
    phase = ocp.compile_problem(problem(PLANT)).phases[0]
    assert phase.guess_controls[0] == pytest.approx(ROBOT.pose("stand"), abs=1e-6)
    narrow = models.Mujoco(ROBOT, action=models.joint_targets(half_range=0.01))
    guess = ocp.compile_problem(problem(narrow, length=0.4)).phases[0].guess_controls
    assert np.abs(guess - narrow.action.centre).max() == pytest.approx(0.01)
    pushed = models.Mujoco(ROBOT, action=models.torques())
    assert not ocp.compile_problem(problem(pushed)).phases[0].guess_controls.any()


# ---- the compiler


def test_mode_has_rows_and_no_dynamics():
    friction = models.friction_cone()
    compiled = ocp.compile_problem(problem(PLANT, constraints=ocp.Constraints(friction), without=[friction]))
    (phase,) = compiled.phases
    assert set(phase.mode.functions) == {"stage", "stage_w", "terminal", "terminal_w", "outputs"}
    assert phase.mode.functions["stage"].name_out() == ["residual", "g", "h"]
    assert (phase.num_stages, phase.mode.nz, phase.mode.nu) == (8, 0, 12)
    flags = phase.p[:, phase.mode.layout.slots["contact"]]
    assert flags[1].tolist() == [1, 1, 1, 1]
    assert flags[2].tolist() == [1, 0, 0, 1]
    assert "friction cone" in str(ocp.describe(compiled))
    assert ocp.check_derivatives(compiled) == []


def test_the_step_of_the_schedule_is_the_simulator_s():
    with pytest.raises(
        ProblemError, match=r"model 'solo12 in MuJoCo': dt is not the model's own - got 0.01 s, expected 0.02 s"
    ):
        PLANT.over(0.16, dt=0.01)
    assert PLANT.as_plant(0.0025).substeps == 8
    assert PLANT.as_plant().over(0.16, dt=0.02).segments[0].dt == 0.02
    with pytest.raises(ModelError, match="timestep does not divide the schedule's step - got 0.003 s, expected 0.02 s"):
        PLANT.as_plant(0.003)


@pytest.mark.parametrize(
    ("term", "why"),
    [
        (
            models.friction_cone(),
            "cannot supply 'feet.contact_force' (there is no contact force before the simulator's step",
        ),
        (ocp.inequality(lambda s: s.joints.acceleration), "cannot supply 'joints.acceleration' (there is no acceler"),
    ],
)
def test_what_a_simulator_cannot_supply(term, why):
    with pytest.raises(ProblemError) as error:
        ocp.compile_problem(problem(PLANT, constraints=ocp.Constraints(term)))
    assert f"applies nowhere - got model 'solo12 in MuJoCo' {why}" in str(error.value)
    ocp.compile_problem(problem(PLANT, constraints=ocp.Constraints(term), without=[term]))


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [({"terrain": "stairs"}, "a Terrain"), ({"payload": 0.5}, "a Payload"), ({"contact": 4}, "a SoftContact")],
)
def test_parts_of_another_kind_are_refused(wrong, expected):
    with pytest.raises(ModelError, match=f"{next(iter(wrong))} is unusable - got .*, expected {expected}"):
        models.Mujoco(models.load("solo12"), **wrong)


def test_solvers_that_differentiate_refuse_it():
    with pytest.raises(
        ProblemError, match="model 'solo12 in MuJoCo': has no derivatives - got a model that can only be"
    ):
        solvers.MSiLQR(problem(PLANT))


def test_verification_is_of_the_rows_alone():
    compiled = ocp.compile_problem(problem(PLANT, constraints=ocp.Constraints(models.base_height(maximum=0.2))))
    (phase,) = compiled.phases
    states = np.tile(BODY.state(), (9, 1))
    part = ocp.PhaseTrajectory(
        name=phase.name, mode=phase.label, model=PLANT.name, state=PLANT.state, control=PLANT.control,
        times=phase.times, states=states, controls=phase.guess_controls, outputs={},
    )  # fmt: skip
    found = ocp.verify(compiled, ocp.Trajectory((part,)))
    assert found.max_inequality == pytest.approx(BODY.state()[2] - 0.2)
    assert found.max_defect == pytest.approx(0.0, abs=1e-12)


# ---- the simulator


def test_flight_is_the_whole_body_s():
    """Of the same rotors and payload; contacts are the simulator's own."""
    rng, plant = np.random.default_rng(6), models.Mujoco(ROBOT, action=models.torques(), armature=0.01)
    loaded = models.Mujoco(
        ROBOT, action=models.torques(), armature=0.01, payload=models.payload(0.5, (0.05, 0.0, 0.06))
    )
    weighs = models.WholeBody(loaded.simulated)
    for model, body, rotors in ((plant, BODY, np.full(12, 0.01)), (loaded, weighs, np.full(12, 0.01))):
        data = mujoco.MjData(model.compiled())
        for _ in range(5):
            x, u = random_state(rng), rng.uniform(-1, 1, 12)
            x[2] = 5.0
            data.qpos[:], data.qvel[:], data.ctrl[:] = x[:19], x[19:], u
            mujoco.mj_forward(model.compiled(), data)
            expected = body.acceleration(x, u, "", armature=rotors)
            assert np.max(np.abs(expected - data.qacc)) < 1e-8 * np.max(np.abs(data.qacc))


def test_payload_is_a_point_mass_on_the_base():
    loaded, x = (
        models.Mujoco(ROBOT, payload=models.payload(0.5, (0.1, 0.0, 0.05))),
        random_state(np.random.default_rng(7)),
    )
    assert loaded.compiled().body_mass.sum() == pytest.approx(ROBOT.mass + 0.5, rel=1e-12)
    place = x[:3] + rotation.np_matrix(x[3:7]) @ (0.1, 0.0, 0.05)
    before, after = (evaluate(model, com.position, x, np.zeros(12))[0] for model in (PLANT, loaded))
    assert after == pytest.approx((ROBOT.mass * before + 0.5 * place) / (ROBOT.mass + 0.5), abs=1e-12)
    with pytest.raises(ModelError, match="payload: mass is out of range - got -1, expected a number ≥ 0"):
        models.payload(-1)


def play(model, x, seconds):
    """Hold the pose and return the last state."""
    compiled = model.compiled()
    data = mujoco.MjData(compiled)
    data.qpos[:], data.qvel[:], data.ctrl[:] = x[:19], x[19:], model.action.centre
    for _ in range(round(seconds / compiled.opt.timestep)):
        mujoco.mj_step(compiled, data)
    return np.concatenate([data.qpos, data.qvel])


@pytest.mark.parametrize("plant", [PLANT, PLANT.as_plant()], ids=["planner", "plant"])
def test_it_stands(plant):
    x = play(plant, BODY.state(), 5.0)
    assert not plant.fallen(x)
    assert rotation.np_matrix(x[3:7])[2, 2] > np.cos(0.01)
    assert np.linalg.norm(x[:2]) < 0.01
    assert np.abs(x[19:]).max() < 0.01


@pytest.mark.parametrize(
    "ground",
    [
        terrain.incline(pi / 18, start=-inf),
        terrain.boxes(terrain.Box((0.0, 0.0), (1.0, 1.0), 0.1)),
        terrain.heightfield(np.full((4, 5), 0.05) + 0.01 * np.eye(4, 5), (1.5, 1.5)),
    ],
    ids=["incline", "box", "heightfield"],
)
def test_it_stands_on_its_terrain(ground):
    plant = models.Mujoco(ROBOT, terrain=ground).as_plant()
    x = BODY.state()
    places = models.Kinematics(ROBOT).world_feet(x[:3], x[3:7], x[7:19])
    x[2] += ground.height(places[:, 0], places[:, 1]).max()
    after = play(plant, x, 0.6)
    assert not plant.fallen(after)
    gaps = evaluate(plant, feet.height, after, np.zeros(12))[0]
    assert np.abs(gaps).max() < 0.01  # of a foot: contacts are soft


def test_states_are_placed_on_the_terrain():
    plant = models.Mujoco(ROBOT, terrain=terrain.stairs(0.05, 0.25))
    assert plant.state()[:3] == pytest.approx(BODY.state()[:3])
    x = plant.state(position=(1.5, 0.1), rpy=(0, 0.1, 1.0), joints="crouch")
    assert x[:2] == pytest.approx([1.5, 0.1])
    assert evaluate(plant, feet.height, x, np.zeros(12))[0].min() == pytest.approx(0.0, abs=1e-12)
    assert BODY.state(position=(1.5, 0.1), rpy=(0, 0.1, 1.0), joints="crouch")[2] == pytest.approx(x[2] - 0.15)


def test_a_fallen_robot_sinks_unless_its_body_collides():
    on_its_back = BODY.state(position=(0, 0, 0.2), rpy=(pi, 0, 0))
    bare, whole = (models.Mujoco(ROBOT, body_collisions=flag) for flag in (False, True))
    assert play(bare, on_its_back, 1.0)[2] < -0.05 < 0.0 < play(whole, on_its_back, 1.0)[2]
    standing = play(whole, BODY.state(), 1.0)
    assert standing == pytest.approx(play(bare, BODY.state(), 1.0), abs=1e-9)  # the hull is off the ground


def test_falls():
    standing, tilted = BODY.state(), BODY.state(rpy=(0.51, 0.0, 1.0))
    low, leaning = BODY.state(position=(0, 0, 0.14), joints="crouch"), BODY.state(rpy=(0.3, 0.35, 2.0))
    states = np.stack([standing, tilted, low, leaning, np.full(37, np.nan)])
    assert PLANT.fallen(states).tolist() == [False, True, True, False, True]
    assert PLANT.fallen(states.reshape(5, 1, 37), models.Fall(tilt=0.4, height=0.1)).ravel().tolist() == [
        False, True, False, True, True,
    ]  # fmt: skip
    assert not PLANT.fallen(standing)


def test_armature_is_raised_for_explicit_steps_alone():
    geared = models.load("solo12", rotors=True)
    enough = 0.2 * 0.02 + 4.0 * 0.02**2
    assert models.Mujoco(geared).compiled().dof_armature[6:] == pytest.approx(enough)
    assert models.Mujoco(geared, armature=0.01).compiled().dof_armature[6:] == pytest.approx(0.01)
    assert models.Mujoco(geared).as_plant().compiled().dof_armature[6:] == pytest.approx(geared.armature)
    assert models.Mujoco(geared, armature=0.01).as_plant().compiled().dof_armature[6:] == pytest.approx(0.01)


def test_friction_and_changes_of_a_plant():
    plant = models.Mujoco(ROBOT, friction=0.9).as_plant(friction=0.4, payload=models.payload(0.3))
    compiled = plant.compiled()
    assert compiled.geom("FL").friction[0] == pytest.approx(0.4)
    assert compiled.geom("FL").priority[0] > compiled.geom("floor").priority[0]
    assert plant.name != PLANT.name
    assert plant.robot is ROBOT


@pytest.mark.parametrize("ground", [terrain.flat(), terrain.stairs(0.05, 0.1, start=0.1)], ids=["flat", "stairs"])
def test_contacts_declared_in_pairs_are_those_that_mujoco_finds(ground):
    plant = models.Mujoco(ROBOT, terrain=ground, body_collisions=True, friction=0.7)
    x, counts = plant.state(position=(0.0, 0.0, 0.22), rpy=(0.1, 0.2, 0.0)), []
    runs = []
    for model in (plant.compiled(), compile_spec(plant.spec(), plant.simulated)):
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[:19], x[19:], plant.action.centre
        for _ in range(20):
            mujoco.mj_step(model, data)
            counts.append(data.ncon)
        runs.append(np.concatenate([data.qpos, data.qvel]))
    assert runs[0] == pytest.approx(runs[1], abs=1e-9)
    assert max(counts) >= 4


def test_compiled_is_made_once():
    assert PLANT.compiled() is PLANT.compiled()
    assert PLANT.compiled(visuals=True).ngeom > PLANT.compiled().ngeom
    assert PLANT.spec() is not PLANT.spec()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: models.Mujoco("solo12"), "models.Mujoco: not a robot - got 'solo12'"),
        (lambda: models.Mujoco(ROBOT, timestep=0.0), "models.Mujoco of 'solo12': timestep is out of range - got 0.0"),
        (lambda: models.Mujoco(ROBOT, substeps=1.5), "models.Mujoco of 'solo12': substeps is out of range - got 1.5"),
        (lambda: models.SoftContact(solver="qp"), "contact: solver is unknown - got 'qp', expected one of"),
        (lambda: models.SoftContact(iterations=0), "contact: iterations is out of range - got 0, expected a whole"),
        (lambda: models.payload(1, (0, 1)), "payload: offset is not a position - got"),
    ],
)
def test_arguments_out_of_range_are_refused(make, message):
    with pytest.raises(ModelError, match="^" + message.replace("(", r"\(")):
        make()
