"""Feet on a terrain: planes against MuJoCo and Pinocchio, friction along them, derivatives, and what stays the same."""

from math import inf

import casadi as cs
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ModelError, ProblemError
from piaffe.models import base, feet, joints, natural, stance, terrain
from piaffe.ocp import rotation
from piaffe.ocp.reports.verify import quantity_function
from tests.robots import ROBOTS

SLOPE = terrain.incline(0.3, start=-inf, direction=0.7)
BUMPS = terrain.heightfield(0.1 * np.random.default_rng(3).random((8, 8)), size=(2.4, 2.4))
STAIRS = terrain.stairs(0.06, 0.3, 4, start=-0.35)
BLOCK = terrain.boxes(terrain.Box((0.9, 0.0), (0.8, 1.2), 0.15, yaw=0.2))
GROUNDS = {"slope": SLOPE, "bumps": BUMPS, "stairs": STAIRS, "block": BLOCK}


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request):
    return models.load(request.param)


@pytest.fixture(params=GROUNDS.values(), ids=GROUNDS.keys())
def ground(request):
    return request.param


def posed(robot, ground, body):
    """Return a keyframe and its stance feet's places: the robot stands on the ground, level, wherever that is."""
    places = body.kinematics.feet(robot.pose("stand"))
    stand = ground.standing(places[:, :2], robot.foot_radius)
    z = robot.base_height("stand") + float(np.mean(stand[:, 2])) - robot.foot_radius
    angles, missed = body.kinematics.world_inverse(np.array([0.0, 0.0, z]), np.array([1.0, 0, 0, 0]), stand)
    return (0.0, 0.0, z), angles, stand, missed


def problem_of(robot, ground, *, limits=None, objective=None, dt=0.02):
    """Return a problem in which the robot stands, lifts a pair of feet and puts it down again, on a ground."""
    body = models.WholeBody(robot, terrain=ground)
    position, angles, _, _ = posed(robot, ground, body)
    key = ocp.Keyframe(position=position, joints=angles)
    names = robot.foot_names
    pair = " ".join((names[0], names[3]))
    motion = ocp.Motion(
        ocp.Phase("stand", stance(roles="all"), 2 * dt, key),
        ocp.Phase("lift", stance(pair), 4 * dt, key),
        ocp.Phase("down", stance(roles="all"), 2 * dt, key),
    )
    terms = objective or ocp.Objective(
        ocp.track(base.position, weight=10.0), ocp.track(joints.position, weight=1.0),
        ocp.regularize(joints.velocity, weight=0.01), ocp.regularize(joints.torque, weight=0.001),
    )  # fmt: skip
    own = limits or ocp.Constraints(models.friction_cone(0.7), models.foot_clearance())
    initial = body.state(position=position, joints=angles)
    return ocp.Problem(motion, body.until_end(dt=dt), terms, own, initial=initial)


# ---- planes


def test_a_ball_on_the_ground_touches_it_in_mujoco(ground):
    radius = 0.02
    for x, y in np.random.default_rng(0).uniform(-0.9, 0.9, (40, 2)):
        if any(abs(box.side(np.array([[x, y]]))[0][0]) < 0.03 for box in ground.boxes):
            continue  # beside an edge the ball may touch the block's side
        centre = ground.standing(np.array([[x, y]]), radius)[0]
        spec = mujoco.MjSpec()
        ground.add_to(spec)
        ball = spec.worldbody.add_body(pos=centre)
        ball.add_freejoint()
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0), margin=0.05)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        gaps = [contact.dist for contact in data.contact]
        if ground is BUMPS:  # heights in single precision, by an iteration; another triangle may be nearer
            assert min(gaps) < 1e-5
        else:
            assert min(gaps) == pytest.approx(0.0, abs=1e-9)


def test_normals_are_those_of_mujocos_contacts(ground):
    points, normals = ground.surface(np.random.default_rng(1).uniform(-0.9, 0.9, (200, 2)))
    step = 1e-6
    for axis in range(2):
        moved = points[:, :2] + step * np.eye(2)[axis]
        rises = (ground.height(*moved.T) - points[:, 2]) / step
        level = np.abs(rises) < 100  # not across an edge
        slope = -normals[:, axis] / normals[:, 2]
        assert np.median(np.abs(rises[level] - slope[level])) < 1e-6
        assert np.mean(np.abs(rises[level] - slope[level]) < 1e-4) > 0.98  # not across the edge of a triangle


def test_feet_stand_on_the_plane_below_their_reference(robot, ground):
    compiled = ocp.compile_problem(problem_of(robot, ground), checks=False)
    body = compiled.phases[0].mode.model
    _, _, stand, missed = posed(robot, ground, body)
    if missed.max() > 1e-6:
        pytest.skip("the robot cannot stand there")
    x = compiled.initial
    height = quantity_function(compiled.phases[0].mode, feet.height)(x, compiled.phases[0].p[0]).full().ravel()
    assert height == pytest.approx(0.0, abs=1e-7)
    slots, p = compiled.phases[0].mode.layout.slots, compiled.phases[0].p[0]
    points, normals = ground.surface(stand[:, :2])
    assert p[slots["surfaces"]][: points.size] == pytest.approx(points.ravel(), abs=1e-6)
    assert p[slots["normals"]][: normals.size] == pytest.approx(normals.ravel(), abs=1e-6)
    assert body.foot_positions(x) == pytest.approx(stand, abs=1e-6)


def test_heights_are_distances_of_balls_from_mujocos_plane(robot):
    body = models.WholeBody(robot, terrain=SLOPE)
    model = models.mujoco_model(robot, terrain=SLOPE, visuals=False)
    model.geom_margin[:] = 10.0
    data = mujoco.MjData(model)
    rng = np.random.default_rng(2)
    compiled = ocp.compile_problem(problem_of(robot, SLOPE), checks=False)
    function = quantity_function(compiled.phases[0].mode, feet.height)
    p = compiled.phases[0].p[0].copy()
    part = compiled.phases[0].mode.layout.slots["normals"]
    assert p[part][:3] == pytest.approx(normal_of(SLOPE))
    for _ in range(10):
        x = body.state.np_normalise(
            np.concatenate([rng.normal(size=2), [1.5], rng.normal(size=4), rng.uniform(-1, 1, 12), np.zeros(18)])
        )
        data.qpos[:] = x[:19]
        mujoco.mj_forward(model, data)
        expected = {model.geom(contact.geom2).name: contact.dist for contact in data.contact}
        expected |= {model.geom(contact.geom1).name: contact.dist for contact in data.contact}
        # the planes of all feet are one, so any state may be compared
        got = function(x, p).full().ravel()
        assert got == pytest.approx([expected[name] for name in robot.foot_names], rel=1e-8, abs=1e-9)


def normal_of(ground):
    return ground.surface(np.zeros((1, 2)))[1][0]


def test_a_swing_goes_from_the_plane_it_leaves_to_the_plane_it_reaches(robot):
    problem = problem_of(robot, SLOPE)
    compiled = ocp.compile_problem(problem, checks=False)
    body = compiled.phases[1].mode.model
    lift = compiled.phases[1]
    slots, n = lift.mode.layout.slots, 3 * len(robot.feet)
    points = np.array([row[slots["surfaces"]][:n] for row in (*lift.p, lift.p_end)])
    stand = body.foot_positions(compiled.initial)
    expected = SLOPE.surface(stand[:, :2])[0].ravel()
    assert points[0] == pytest.approx(expected, abs=1e-6)
    assert points[-1] == pytest.approx(expected, abs=1e-6)  # the keyframe is where it began
    assert lift.p_end[slots["landing"]].sum() == 2


# ---- forces and impulses


def test_contact_axes_are_a_rotation_that_turns_the_vertical_onto_the_normal():
    from piaffe.models.ground import contact_axes
    from piaffe.models.measures import on_ground

    rng = np.random.default_rng(4)
    for _ in range(20):
        normal = rng.normal(size=3)
        normal[2] = abs(normal[2]) + 0.2
        normal /= np.linalg.norm(normal)
        axes = np.array(cs.evalf(contact_axes(cs.SX(normal))))
        assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-12)
        assert axes[:, 2] == pytest.approx(normal)
        angle = np.arccos(normal[2])
        turn = np.cross([0, 0, 1], normal)
        expected = pin.exp3(angle * turn / np.linalg.norm(turn))
        assert axes == pytest.approx(expected, abs=1e-12)
        force = rng.normal(size=3)
        assert on_ground(force, normal) == pytest.approx(axes.T @ force, abs=1e-12)


def test_friction_on_a_slope_holds_up_to_its_angle(robot):
    """A robot at rest on a slope pushes down: the force is in the cone of the slope if tan(angle) < mu."""
    for mu, angle, holds in ((0.6, 0.5, True), (0.6, 0.58, False)):
        assert (np.tan(angle) < mu) == holds
        compiled = ocp.compile_problem(
            problem_of(robot, terrain.incline(angle, start=-inf), limits=ocp.Constraints(models.friction_cone(mu))),
            checks=False,
        )
        phase = compiled.phases[0]
        weight = robot.mass * 9.81 / len(robot.feet)
        normal = phase.p[0][phase.mode.layout.slots["normals"]][:3]
        sideways, along = np.tan(angle) * weight * np.cos(angle), weight * np.cos(angle)
        assert models.measures.on_ground(np.array([0, 0, weight]), normal) == pytest.approx(
            [sideways, 0.0, along], abs=1e-9
        )


def test_impulses_of_a_landing_on_a_slope_are_those_of_pinocchio(robot):
    """Feet come to rest on the slope; the impulse in contact axes is the impulse against the plane."""
    body = models.WholeBody(robot, terrain=SLOPE)
    rng = np.random.default_rng(5)
    compiled = ocp.compile_problem(problem_of(robot, SLOPE), checks=False)
    transition = compiled.phases[1].transition
    p = compiled.phases[1].p_transition
    for _ in range(5):
        x = body.state.np_normalise(np.concatenate([rng.normal(size=7), rng.uniform(-1, 1, 12), rng.normal(size=18)]))
        K, r0 = (each.full() for each in transition.functions["implicit"](x, p))
        z = -np.linalg.solve(K, r0.ravel())
        impulse = z[body.nv :].reshape(-1, 3)
        g = transition.functions["rows"](x, z, p)[1].full().ravel()
        q, v = pin_state(x)
        model, data = robot.model, robot.model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        world = pin.LOCAL_WORLD_ALIGNED
        J = np.vstack([pin.getFrameJacobian(model, data, robot.frame_id(f.frame), world)[:3] for f in robot.feet])
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T + np.diag(np.r_[np.zeros(6), robot.armature])
        expected = np.linalg.solve(J @ np.linalg.solve(M, J.T), -J @ v).reshape(-1, 3)
        assert impulse == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
        axes = pin.exp3(np.arccos(normal_of(SLOPE)[2]) * unit(np.cross([0, 0, 1], normal_of(SLOPE))))
        own = expected @ axes
        faces = np.array([[c, 0.7 * c - a, 0.7 * c + a, 0.7 * c - b, 0.7 * c + b] for a, b, c in own]).ravel()
        scale = natural.impulse(body)  # a tenth of the mass, but for ANYmal C
        assert g == pytest.approx(faces / scale, rel=1e-8, abs=1e-8 * np.abs(faces / scale).max())


def unit(vector):
    return vector / np.linalg.norm(vector)


def pin_state(x):
    from piaffe.models.robot import to_pinocchio

    return to_pinocchio(x)


# ---- derivatives


@pytest.mark.parametrize("name", ["slope", "block"])
def test_derivatives_hold_on_terrain(robot, name):
    problem = problem_of(robot, GROUNDS[name])
    found = ocp.check_derivatives(ocp.compile_problem(problem))
    assert found
    assert all(each.agrees for each in found), [each for each in found if not each.agrees]


# ---- rigid body


def test_the_rigid_body_pushes_along_the_planes_of_its_footholds():
    robot = models.load("go2")
    ground = terrain.incline(0.25, start=-inf)
    body = models.SingleRigidBody(robot, terrain=ground)
    trot = models.gaits.trot(0.3)
    x = body.state((0.0, 0.0, robot.base_height("stand")))
    objective = ocp.Objective(ocp.track(base.height, weight=1.0), ocp.track(feet.force, weight=1e-3))
    problem = ocp.Problem(
        trot, body.over(0.6, dt=0.05), objective, ocp.Constraints(models.friction_cone(0.5)), initial=x
    )
    compiled = ocp.compile_problem(problem)
    phase = compiled.phases[0]
    slots = phase.mode.layout.slots
    n = 3 * len(robot.feet)
    for row in phase.p:
        normals = row[slots["normals"]][:n].reshape(-1, 3)
        assert normals == pytest.approx(np.tile([-np.sin(0.25), 0, np.cos(0.25)], (4, 1)), abs=1e-12)
        on = row[slots["contact"]] > 0
        holds = row[slots["footholds"]].reshape(-1, 3)[on]
        assert holds[:, 2] == pytest.approx(ground.standing(holds[:, :2], robot.foot_radius)[:, 2], abs=1e-9)


# ---- level ground


@pytest.mark.parametrize("model", [models.WholeBody, models.SingleRigidBody])
def test_level_ground_adds_nothing(model):
    robot = models.load("go2")
    plain, flat, raised = model(robot), model(robot, terrain=terrain.flat()), model(robot, terrain=terrain.flat(0.1))
    assert plain.slots == flat.slots
    assert dict(plain.slots_of_ground) == {}
    assert raised.numbers()["terrain"] == [0.1]
    key = plain.mode_key(stance(roles="all"))
    functions = []
    for each in (plain, flat):
        x, u = cs.SX.sym("x", each.state.nx), cs.SX.sym("u", each.control.nx)
        z, p = cs.SX.sym("z", each.implicit_size(key)), each.symbols()
        made = each.dynamics(key, x, u, z, p)
        own = made.quantities.bind(feet.contact_force).value
        functions.append(cs.Function("f", [x, u, z, *p.values()], [made.next_state, own]).serialize())
    assert functions[0] == functions[1]


# ---- what is refused


def test_a_terrain_that_is_none_is_refused():
    with pytest.raises(ModelError, match=r"models\.WholeBody: terrain is unusable - got 0\.1, expected a Terrain"):
        models.WholeBody(models.load("go2"), terrain=0.1)


def test_models_of_one_schedule_stand_on_one_ground():
    robot = models.load("go2")
    body, rigid = models.WholeBody(robot, terrain=SLOPE), models.SingleRigidBody(robot, terrain=STAIRS)
    motion = models.gaits.trot(0.2)
    objective = ocp.Objective(ocp.track(base.position, weight=1.0), ocp.regularize(joints.torque, weight=0.01))
    problem = ocp.Problem(
        motion, body.over(0.1, dt=0.02) + rigid.over(0.2, dt=0.05), objective + ocp.track(feet.force, weight=0.01),
        initial=body.state(joints="stand"),
    )  # fmt: skip
    with pytest.raises(ProblemError, match="two models of the schedule have different ground"):
        ocp.compile_problem(problem)


def test_a_recipe_is_the_terrain(ground):
    again = terrain.from_recipe(ground.recipe())
    assert again == ground


def test_a_gait_climbs_at_the_slope_of_the_ground():
    robot = models.load("go2")
    body = models.WholeBody(robot, terrain=terrain.incline(0.2, start=-inf))
    start = body.state.unpack(body.state(rpy=(0, -0.2, 0), joints="stand"))
    gait = models.gaits.trot(0.3, ramp=0.0).cycles(4)
    bound = gait.bind((body,), start).placed[0].reference
    t = np.linspace(0.6, 1.8, 50)
    made = bound.samples(t)
    climb = made[base.linear_velocity][:, 2] / made[base.linear_velocity][:, 0]
    assert climb == pytest.approx(np.tan(0.2), abs=1e-5)  # of the fit, see fitted_slope
    pitch = rotation.np_to_rpy(made[base.orientation])[:, 1]
    assert pitch == pytest.approx(-0.2, abs=1e-5)
    assert made[base.ground_normal] == pytest.approx(np.tile([0, 0, 1], (50, 1)), abs=1e-5)


def test_rates_of_a_gait_on_stairs_are_the_derivatives_of_its_values():
    body = models.WholeBody(models.load("solo12"), terrain=terrain.stairs(0.04, 0.25, 3, start=0.35))
    gait = models.gaits.trot(0.3, height=0.25).cycles(6)
    bound = gait.bind((body,), body.state.unpack(body.state(joints="stand"))).placed[0].reference
    t, h = np.linspace(0.1, 2.9, 281) + 0.0037, 1e-6
    before, now, after = (bound.samples(t + shift) for shift in (-h, 0.0, h))
    for value, rate in ((base.position, base.linear_velocity), (feet.position, feet.velocity)):
        assert (after[value] - before[value]) / (2 * h) == pytest.approx(now[rate], abs=2e-5)
    turned = rotation.np_multiply(rotation.np_conjugate(before[base.orientation]), after[base.orientation])
    assert rotation.np_log(turned) / (2 * h) == pytest.approx(now[base.angular_velocity], abs=2e-5)


def test_swings_of_a_gait_pass_above_the_edges_of_stairs():
    robot = models.load("solo12")
    ground = terrain.stairs(0.04, 0.25, 3, start=0.35)
    body = models.WholeBody(robot, terrain=ground)
    gait = models.gaits.trot(0.3, height=0.25, swing_height=0.04).cycles(9)
    bound = gait.bind((body,), body.state.unpack(body.state(joints="stand"))).placed[0].reference
    places = bound.samples(np.arange(0.0, gait.duration, 2e-3))[feet.position].reshape(-1, 3)
    for box in ground.boxes:
        corner = np.maximum(box.side(places[:, :2])[0], 0.0)  # how far beside the block
        depth = places[:, 2] - box.height
        near = np.hypot(corner, np.maximum(depth, 0.0))
        below = (corner > 0) & (depth < 0)
        distance = np.where(below, corner, np.where(corner > 0, near, depth))
        assert distance.min() > robot.foot_radius - 1e-9


def test_a_gait_without_end_has_no_functions_on_a_height_field():
    body = models.WholeBody(models.load("go2"), terrain=BUMPS)
    start = body.state.unpack(body.state(joints="stand"))
    bound, finite = (each.bind((body,), start).placed[0].reference for each in (trot(), trot().cycles(2)))
    with pytest.raises(ProblemError, match="has no functions of time on this ground - got a height field of 8 by 8"):
        bound.functions()
    assert finite.functions() is None


def trot():
    return models.gaits.trot(0.2, stance_time=0.2, intro=0.1)


def test_a_gait_with_an_end_is_a_table_on_a_height_field():
    body = models.WholeBody(models.load("go2"), terrain=BUMPS)
    objective = ocp.Objective(ocp.track(feet.position, weight=1.0), ocp.regularize(joints.torque, weight=0.01))
    problem = ocp.Problem(trot().cycles(2), body.over(0.3, dt=0.02), objective, initial=body.state(joints="stand"))
    made, expected = ocp.Horizon(problem).first, ocp.compile_problem(problem)
    for one, other in zip(made.phases, expected.phases, strict=True):
        assert one.p == pytest.approx(other.p, abs=1e-12)


# ---- a horizon at any time


def hop(ground, **more):
    """Return a hop forward of Go2 with keyframes, for controllers that plan again and again."""
    robot = models.load("go2")
    body = models.WholeBody(robot, terrain=ground)
    x = body.state(joints="stand")
    key = ocp.Keyframe(position=(0.1, 0.0, float(x[2])), joints="stand")
    motion = ocp.Motion(
        ocp.Phase("push", stance(roles="all"), 0.2, ocp.Keyframe(position=tuple(x[:3]), joints="stand")),
        ocp.Phase("flight", stance(""), 0.1, key),
        ocp.Phase("land", stance(roles="all"), 0.4, key),
        **more,
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=1.0), ocp.track(joints.position, weight=1.0),
        ocp.regularize(joints.torque, weight=0.01),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(0.6), models.foot_clearance())
    return ocp.Problem(motion, body.over(0.3, dt=0.02), objective, limits, initial=x)


def test_a_horizon_has_the_planes_of_the_compiled_problem():
    problem = hop(SLOPE)
    horizon = ocp.Horizon(problem)
    for t in (0.0, 0.1, 0.2, 0.26, 0.4):
        expected, x = ocp.compile_problem(problem, t), problem.initial.copy()
        x[:3] = expected.path.sample(t, expected.path.interval_at(t))[base.position]
        made = horizon.at(horizon.begin(x, t), problem.initial)
        for one, other in zip(made.phases, expected.phases, strict=True):
            assert one.p == pytest.approx(other.p, abs=1e-12)
            assert one.p_end == pytest.approx(other.p_end, abs=1e-12)


def elsewhere(x, yaw, shift):
    """Return a state moved in the plane."""
    turned, (c, s) = x.copy(), (np.cos(yaw), np.sin(yaw))
    turned[:2] = shift + np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]])
    turned[3:7] = rotation.np_multiply(np.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]), x[3:7])
    return turned


@pytest.mark.parametrize("ground", [SLOPE, STAIRS, BUMPS, terrain.incline(0.2, start=0.1)], ids=str)
def test_planes_of_a_horizon_are_those_of_the_world_wherever_the_motion_begins(ground):
    """A motion with keyframes moves with the robot; the ground does not."""
    problem, yaw, shift = hop(ground), 0.6, np.array([0.3, -0.2])
    horizon = ocp.Horizon(problem)
    course = horizon.begin(elsewhere(problem.initial, yaw, shift), 0.0)
    assert course.anchor == pytest.approx((*shift, yaw), abs=1e-12)
    phases = horizon.at(course, problem.initial).phases
    declared = ocp.compile_problem(problem, checks=False).phases
    back = ocp.relative(ocp.ORIGIN, course.anchor)
    layout = phases[0].mode.layout.slots
    for row, own in ((phases[0].p[0], declared[0].p[0]), (phases[1].p_end, declared[1].p_end)):  # standing, landing
        points, normals = (row[layout[name]][:12].reshape(4, 3) for name in ("surfaces", "normals"))
        steps = own[layout["surfaces"]][:12].reshape(4, 3)  # where the feet are declared
        places, upward = ground.surface(elsewhere_points(steps, course.anchor)[:, :2])
        assert points == pytest.approx(elsewhere_points(places, back), abs=1e-12)
        assert normals == pytest.approx(elsewhere_points(upward, (0.0, 0.0, -yaw)), abs=1e-12)
    # the targets of the base and the feet go with the ground
    rise = places[:, 2] - steps[:, 2]
    assert np.abs(rise).max() > 0.003
    assert (phases[1].guess_states[-1] - declared[1].guess_states[-1])[2] == pytest.approx(rise.mean(), abs=1e-12)


def elsewhere_points(points, motion):
    c, s = np.cos(motion[2]), np.sin(motion[2])
    x, y, z = np.asarray(points).T
    return np.column_stack([motion[0] + c * x - s * y, motion[1] + s * x + c * y, z])


def test_motions_without_end_of_keyframes_are_refused_in_a_horizon():
    with pytest.raises(ProblemError, match="repeats where the ground does not"):
        ocp.Horizon(hop(SLOPE, cyclic=True))


@pytest.mark.parametrize("ground", [SLOPE, STAIRS], ids=["slope", "stairs"])
def test_the_horizon_of_a_gait_without_end_is_the_compiled_problem(ground):
    """In the frame of a plan, which is elsewhere."""
    robot = models.load("go2")
    body, rigid = models.WholeBody(robot, terrain=ground), models.SingleRigidBody(robot, terrain=ground)
    x = elsewhere(models.WholeBody(robot).state(joints="stand"), 0.4, np.array([0.2, -0.1]))
    x[2] += np.mean(ground.height(*body.foot_positions(x)[:, :2].T))
    objective = ocp.Objective(
        ocp.track(base.position, weight=1.0), ocp.track(feet.position, weight=1.0), ocp.track(feet.height, weight=1.0),
        ocp.track(feet.force, weight=0.01), ocp.regularize(joints.torque, weight=0.01),
    )  # fmt: skip
    limits = ocp.Constraints(models.friction_cone(0.6), models.foot_clearance())
    schedule = body.over(0.3, dt=0.02).without(objective.terms[3]) + rigid.over(0.4, dt=0.05).without(limits)
    trot = models.gaits.trot(0.3, stance_time=0.2, intro=0.1)
    problem = ocp.Problem(trot, schedule, objective, limits, initial=x)
    horizon, expected = ocp.Horizon(problem), ocp.compile_problem(problem)
    course = horizon.begin(x, 0.0)
    made = horizon.at(course, horizon.local(course, x))
    assert course.anchor == pytest.approx((0.2, -0.1, 0.4))
    for one, other in zip(made.phases, expected.phases, strict=True):
        states = horizon.courses.moved(one.guess_states, course.anchor) if one.mode.model is body else None
        if states is not None:
            assert states == pytest.approx(other.guess_states, abs=2e-7)  # angles are iterated
        slots = one.mode.layout.slots
        for mine, theirs in zip(one.p, other.p, strict=True):
            points, normals = (each[slots[name]].reshape(-1, 3) for each in (mine,) for name in ("surfaces", "normals"))
            wanted, upward = (theirs[slots[name]].reshape(-1, 3) for name in ("surfaces", "normals"))
            normals = elsewhere_points(normals, (0.0, 0.0, course.anchor[2]))
            assert normals == pytest.approx(upward, abs=1e-9)
            points = elsewhere_points(points, course.anchor)
            assert np.sum(points * normals, axis=1) == pytest.approx(np.sum(wanted * upward, axis=1), abs=1e-9)


def test_both_backends_walk_the_same_iterates_on_terrain():
    problem = problem_of(models.load("go2"), STAIRS)
    options = solvers.Options(max_iterations=8)
    native, reference = (solvers.MSiLQR(problem, options, backend=name).solve() for name in ("native", "numpy"))
    for one, other in zip(native.history, reference.history, strict=True):
        assert one.cost == pytest.approx(other.cost, rel=1e-9)
        assert one.max_defect == pytest.approx(other.max_defect, rel=1e-6, abs=1e-12)


# ---- warnings and reports


def test_feet_off_the_terrain_are_reported():
    robot = models.load("go2")
    body = models.WholeBody(robot, terrain=SLOPE)
    level = models.WholeBody(robot).state(joints="stand")
    key = ocp.Keyframe(position=tuple(level[:3]), joints="stand")
    motion = ocp.Motion(ocp.Phase("stand", stance(roles="all"), 0.2, key))
    objective = ocp.Objective(ocp.track(base.position, weight=1.0), ocp.regularize(joints.torque, weight=0.01))
    problem = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=level)
    texts = [str(each) for each in problem.warnings()]
    assert any("initial state: standing foot is not on the ground" in text for text in texts)
    assert any("keyframe: stance foot is not on the ground" in text for text in texts)
    x = body.state(rpy=(0, 0, 0), joints="stand")
    raised = ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=x)
    heights = x[2] - level[2]
    assert heights == pytest.approx(max(SLOPE.height(*body.foot_positions(x)[:, :2].T)), abs=2e-3)
    assert raised.initial[2] > level[2]


def test_a_foot_beside_the_surface_of_its_reference_is_found():
    """The plane of the reference goes on beyond the block; the ground does not."""
    robot = models.load("go2")
    ground = terrain.boxes(terrain.Box((0.0, 0.0), (1.0, 1.0), 0.1))
    body = models.WholeBody(robot, terrain=ground)
    x = body.state(joints="stand")
    motion = ocp.Motion(ocp.Phase("stand", stance(roles="all"), 0.1, ocp.Keyframe(position=tuple(x[:3]))))
    objective = ocp.Objective(ocp.track(base.position, weight=1.0), ocp.regularize(joints.torque, weight=0.01))
    compiled = ocp.compile_problem(ocp.Problem(motion, body.until_end(dt=0.02), objective, initial=x))
    trajectory = solvers.MSiLQR(compiled, backend="numpy").solve().raise_if_failed().trajectory
    found = ocp.verify(compiled, trajectory)
    assert found.max_height < 1e-3
    part = trajectory.phases[0]
    part.states[:, 0] += 0.4  # the front feet hang in the air
    assert ocp.verify(compiled, trajectory).max_height == pytest.approx(0.1, abs=1e-3)
