"""Gaits as functions of time and command, against the gaits in NumPy."""

from dataclasses import replace
from pathlib import Path

import casadi as cs
import numpy as np
import pytest

from piaffe import codegen, models, ocp
from piaffe.errors import ProblemError, ShapeError
from piaffe.models import base, feet, gaits, joints, stance
from piaffe.models.gaits.base_path import BasePath
from piaffe.models.gaits.path_expression import PathExpression
from piaffe.ocp import rotation
from tests.gaits import GaitPair, begin_state, disturbed, model_of
from tests.robots import ROBOTS

GAITS = ("bound", "pace", "flying_pace", "trot", "flying_trot", "pronk", "walk")
CASES = [(robot, gait) for robot in ROBOTS for gait in GAITS] + [
    ("biped", gait) for gait in ("pace", "flying_pace", "pronk")
]
KINDS = (models.WholeBody, models.SingleRigidBody)
LARGE = 1e5  # entries of rows above this stand for infinite times


@pytest.mark.parametrize(("robot", "gait"), CASES)
def test_functions_of_a_gait_are_the_gait(robot, gait):
    rng = np.random.default_rng([CASES.index((robot, gait)), 1])
    pair, exact = GaitPair.random(model_of(robot), gait, rng), 0
    for _ in range(30):
        exact += pair.check(*pair.some_time(rng, 0.0, rng.choice([0.5, 3.0, 39.0])))
    assert exact > 22  # the feet are within reach


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("robot", "gait"), [(("mini_cheetah", "go2")[i % 2], gait) for i, gait in enumerate(GAITS)])
def test_a_gait_that_advances_is_the_anchored_gait(robot, gait, kind):
    """Again and again, at ticks, over whole stances, to boundaries; from a stance, from a swing, from flight."""
    rng = np.random.default_rng([GAITS.index(gait), KINDS.index(kind)])
    pair, now, exact = GaitPair.random(model_of(robot, kind), gait, rng), 0.0, 0
    for _ in range(25):
        later, interval = pair.some_time(rng, now, now + rng.choice([0.02, 0.3, 0.9]))
        x, actual = disturbed(pair, later, rng)
        pair.advance(now, later - now, x, interval)
        pair.numpy, now = pair.numpy.anchored(later, actual), later
        for _ in range(3):
            exact += pair.check(*pair.some_time(rng, now, now + 1.5), now)
    assert exact > 50


def test_single_rigid_body_begins_on_the_feet_of_the_standing_robot():
    rng = np.random.default_rng(0)
    model = model_of("go2", models.SingleRigidBody)
    pair = GaitPair.random(model, "trot", rng, intro=0.05)
    x, start = (
        begin_state(model, np.random.default_rng(0)),
        pair.functions.start(begin_state(model, np.random.default_rng(0))),
    )
    standing = pair.numpy.kinematics.world_feet(x[:3], x[3:7], model.robot.pose("stand"))
    assert start.full().ravel()[13:] == pytest.approx(standing.ravel(), abs=1e-12)
    for _ in range(20):
        pair.check(*pair.some_time(rng, 0.0, 3.0))


def test_legs_may_have_a_sliding_joint(tmp_path):
    """A biped with telescopic shanks."""
    text = (Path(__file__).parents[2] / "examples" / "biped.urdf").read_text()
    for side in "LR":
        head, joint = text.split(f'<joint name="{side}_KFE" type="revolute">')
        joint, rest = joint.split("</joint>", 1)
        joint = joint.replace('axis xyz="0 1 0"', 'axis xyz="0 0 1"')
        text = f'{head}<joint name="{side}_KFE" type="prismatic">{joint}</joint>{rest}'
    (tmp_path / "telescope.urdf").write_text(text)
    robot = models.load(tmp_path / "telescope.urdf", feet="L_FOOT R_FOOT")
    pair = GaitPair.random(models.SingleRigidBody(robot), "pace", np.random.default_rng(0), speed=0.1, yaw_rate=0.1)
    assert not pair.numpy.kinematics.groups[0].revolute.all()
    rng = np.random.default_rng(1)
    assert sum(pair.check(*pair.some_time(rng, 0.0, 5.0)) for _ in range(20)) > 15


# ---- rows


@pytest.mark.parametrize("gait", GAITS)
def test_rows_repeat_from_the_second_repetition_on(gait):
    pair = GaitPair.random(model_of("mini_cheetah"), gait, np.random.default_rng(0))
    once, cycle = len(pair.motion.pieces[0].once), len(pair.motion.pieces[0].cycle)
    rows = [pair.functions.schedule(i) for i in range(once + 6 * cycle)]
    for i in range(once + 2 * cycle, len(rows) - cycle):
        assert np.array_equal(rows[i], rows[i + cycle])
    assert np.array_equal(pair.functions.schedule(once + 100_000 * cycle), rows[once + 2 * cycle])
    assert np.isfinite(rows).all()
    steady = np.array(rows[once + 2 * cycle :])
    assert np.abs(steady).max() < LARGE  # no stance is infinitely long ago


SWINGS_ONCE = {"once": [("FR HL", 0.1)], "cycle": [("FL FR HL", 0.2), ("FR HL HR", 0.2)]}
STANDS_ONCE = {"once": [("FL FR HL HR", 0.1)], "cycle": [("FL HL", 0.2), ("FR HL", 0.2)]}
HOPS_ONCE = {"once": [("FL FR HL HR", 0.15), ("", 0.2), ("FL FR HL HR", 0.1), ("FL HR", 0.2), ("", 0.1)], "cycle": []}


@pytest.mark.parametrize(
    "phases", [SWINGS_ONCE, STANDS_ONCE, HOPS_ONCE], ids=["swings once", "stands once", "no cycle"]
)
def test_feet_that_stand_or_fly_for_ever(phases):
    once, cycle = (
        tuple(ocp.Phase(f"{i}", stance(names), duration) for i, (names, duration) in enumerate(phases[key]))
        for key in ("once", "cycle")
    )
    reference = models.gaits.GaitReference(speed=0.0, yaw_rate=0.0, ramp=0.3, height=0.24)
    motion = ocp.Motion(*(cycle or once), cyclic=bool(cycle), once=once if cycle else (), reference=reference)
    rng = np.random.default_rng(0)
    pair = GaitPair(model_of("mini_cheetah"), motion, rng)
    end = 0.75 if not cycle else 0.85
    for _ in range(40):
        t, interval = pair.some_time(rng, 0.0, end)
        pair.check(t, interval)
    now, places = 0.0, None
    for _ in range(40 if cycle else 6):
        interval = pair.phase(now + 0.11)
        x, actual = disturbed(pair, now + 0.11, rng)
        pair.advance(now, 0.11, x, interval)
        pair.numpy, now = pair.numpy.anchored(now + 0.11, actual), now + 0.11
        pair.check(now, interval, now)
        if cycle:
            pair.check(now + 0.3, pair.phase(now + 0.3), now)
        places = pair.sample(now, interval, now)[feet.position]
        assert np.isfinite(pair.functions.schedule(interval.index)).all()
    standing = pair.model.flags(interval.phase.mode) > 0
    measured = actual[feet.position].reshape(4, 3)
    measured[:, 2] = pair.model.robot.foot_radius
    assert places.reshape(4, 3)[standing] == pytest.approx(measured[standing], abs=1e-9)


# ---- moving, hours, commands


def test_the_memory_moves_with_a_planar_motion():
    rng = np.random.default_rng(3)
    pair = GaitPair.random(model_of("mini_cheetah"), "flying_trot", rng)
    now, motion = 0.37, (0.4, -1.3, 2.1)
    x, _ = disturbed(pair, now, rng)
    pair.advance(0.0, now, x, pair.phase(now))
    kept = pair.memory
    frame = pair.functions.pose(0.2, kept).full().ravel()
    for _ in range(20):
        t, interval = pair.some_time(rng, now, now + 1.5)
        pair.memory = kept
        expected = pair.sample(t, interval, now)
        pair.memory = pair.functions.move(kept, motion)
        got = pair.sample(t, interval, now)
        moved = pair.model.planar_frame(expected), pair.functions.pose(t - now, pair.memory).full().ravel()
        turned = np.array([[np.cos(2.1), -np.sin(2.1)], [np.sin(2.1), np.cos(2.1)]])
        assert moved[1][:2] == pytest.approx(turned @ moved[0][:2] + motion[:2], abs=1e-12)
        for quantity, value in expected.items():
            points = value.reshape(-1, 3) if quantity.kind in ("point", "direction") else value
            if quantity.kind == "rotation":
                wanted = rotation.np_multiply(rotation.np_from_rpy(np.array([0, 0, 2.1])), value)
                wanted *= np.sign(wanted @ got[quantity])
            elif quantity.kind == "vector":
                wanted = value
            else:
                wanted = np.column_stack([points[:, :2] @ turned.T, points[:, 2]])
                wanted[:, :2] += motion[:2] if quantity.kind == "point" else 0.0
            assert got[quantity] == pytest.approx(np.ravel(wanted), abs=1e-12), str(quantity)
    # a state that moves with the memory is the same to it
    other = np.array(x)
    other[:2] = turned @ x[:2] + motion[:2]
    other[3:7] = rotation.np_multiply(rotation.np_from_rpy(np.array([0, 0, 2.1])), x[3:7])
    other[7 + 12 : 9 + 12] = turned @ x[7 + 12 : 9 + 12]
    row, command = pair.row(pair.phase(now), now), pair.functions.command
    first = pair.functions.move(pair.functions.advance(kept, 0.0, x, command, *row), motion)
    second = pair.functions.advance(pair.functions.move(kept, motion), 0.0, other, command, *row)
    assert first.full() == pytest.approx(second.full(), abs=1e-12)
    back = pair.functions.pose(0.2, pair.functions.move(kept, (-frame[0], -frame[1], 0.0))).full().ravel()
    assert back == pytest.approx([0.0, 0.0, frame[2]], abs=1e-12)


def test_an_hour_has_the_numbers_of_a_second():
    """In the frame of the base, a steady gait comes back to the same memory; turning, yaw stays within half a turn."""
    rng, options = np.random.default_rng(5), {"ramp": 1.0, "intro": 0.0, "yaw_rate": 0.7}
    pair = GaitPair.random(model_of("mini_cheetah"), "trot", rng, **options)
    functions, dt, turns = pair.functions, 0.25, pair.functions.command[2] * 0.25
    pair.memory = functions.move(pair.memory, (0.0, 0.0, -float(pair.memory[2])))
    at = pair.model.state(joints="stand")
    seen, yaws = [], []
    for tick in range(1, 14401):
        x, (px, py, yaw) = at.copy(), functions.pose(dt, pair.memory).full().ravel()
        row = functions.schedule(tick)
        s = functions.sample(dt, pair.memory, 0.0 + dt, row).full().ravel()
        x[:7], x[7:19], x[19:22] = s[:7], s[17:29], s[7:10]
        pair.memory = functions.advance(pair.memory, dt, x, functions.command, 0.0, row)
        c, sine = np.cos(yaw), np.sin(yaw)
        if tick % 2:  # turns at every second tick only: a heading may be negative or positive
            pair.memory = functions.move(pair.memory, (-px, -py, 0.0))
        else:
            pair.memory = functions.move(pair.memory, (-(c * px + sine * py), sine * px - c * py, -yaw))
        seen.append(pair.memory.full().ravel())
        yaws.append(yaw)
    seen = np.array(seen)
    assert np.isfinite(seen).all()
    assert np.abs(seen).max() < 1.0
    assert seen[-1] == pytest.approx(seen[39], abs=1e-9)
    assert seen[-2] == pytest.approx(seen[38], abs=1e-9)
    assert np.array(yaws[40:42]) == pytest.approx([turns, 2 * turns], abs=1e-9)


def test_full_turns_do_not_pile_up():
    rng, options = np.random.default_rng(5), {"ramp": 0.0, "intro": 0.0, "yaw_rate": 1.0}
    pair = GaitPair.random(model_of("mini_cheetah"), "trot", rng, **options)
    functions, x = pair.functions, pair.model.state(joints="stand")
    for tick in range(1, 100):
        _, _, yaw = functions.pose(0.25, pair.memory).full().ravel()
        x[3:7] = rotation.np_from_rpy(np.array([0.0, 0.0, yaw]))
        pair.memory = functions.advance(pair.memory, 0.25, x, functions.command, 0.0, functions.schedule(tick))
        assert abs(float(pair.memory[2])) <= np.pi
        assert np.sin(float(pair.memory[2]) - yaw) == pytest.approx(0.0, abs=1e-12)


@pytest.fixture
def changed():
    """A trot in whose ramp the command changes at a measured state on the path; before the change, after it."""
    rng = np.random.default_rng(2)
    pair = GaitPair.random(model_of("mini_cheetah"), "trot", rng, speed=0.4, yaw_rate=0.5, ramp=1.2, height=0.25)
    now, state = 0.61, pair.model.state
    sample = pair.numpy.samples(np.array([now]))
    x = state.pack({block.quantity: sample[block.quantity][0] for block in state.blocks})
    return pair, now, x


@pytest.mark.parametrize("command", [(0.8, -0.1, -0.4, 0.27), (0.4, 0.1, 0.5, 0.2), (-0.3, 0.0, 0.0, 0.25)])
def test_a_changed_command_ramps_without_a_jump(changed, command):
    pair, now, x = changed
    before = pair.sample(now, pair.phase(now))
    pair.advance(0.0, now, x, pair.phase(now), command)
    after = pair.sample(now, pair.phase(now), now)
    for quantity in (base.position, base.linear_velocity, base.angular_velocity, base.height):
        assert after[quantity] == pytest.approx(before[quantity], abs=1e-9), str(quantity)
    times = np.linspace(now, now + 2.0, 2001)
    samples = [pair.sample(t, pair.phase(t), now) for t in times]
    place, speed = (np.array([s[q] for s in samples]) for q in (base.position, base.linear_velocity))
    assert np.diff(place, axis=0) / 1e-3 == pytest.approx((speed[1:] + speed[:-1]) / 2, abs=1e-5)
    assert np.abs(np.diff(speed, axis=0)).max() < 0.01  # no jump: 10 m/s² at most
    end = samples[-1]
    yaw = rotation.np_to_rpy(end[base.orientation])[2]
    assert end[base.linear_velocity][:2] == pytest.approx(
        [np.cos(yaw) * command[0] - np.sin(yaw) * command[1], np.sin(yaw) * command[0] + np.cos(yaw) * command[1]]
    )
    assert end[base.angular_velocity][2] == pytest.approx(command[2])
    assert end[base.position][2] == pytest.approx(command[3])
    within = pair.sample(now + 1.19, pair.phase(now + 1.19), now)[base.angular_velocity][2]
    assert command[2] == 0.5 or within != pytest.approx(command[2], abs=1e-4)  # the ramp has its whole length


def test_a_gait_with_another_command_is_a_gait_bound_there(changed):
    """Once height, roll and pitch are at rest, path and footholds are those of a gait that begins with the command."""
    pair, _, _ = changed
    now, command = 1.55, (0.7, 0.05, -0.3, 0.25)
    interval = pair.phase(now)
    sample = {quantity: values[0] for quantity, values in pair.numpy.samples(np.array([now])).items()}
    x = pair.model.state.pack({block.quantity: sample[block.quantity] for block in pair.model.state.blocks})
    pair.advance(0.0, now, x, interval, command)
    rest = ocp.Phase("rest", interval.phase.mode, interval.end - now)
    following = [i.phase for i in pair.intervals[interval.index + 1 : interval.index + 9]]
    other = ocp.Motion(
        rest, *following,
        reference=gaits.GaitReference(
            speed=command[0], lateral_speed=command[1], yaw_rate=command[2], height=command[3], ramp=1.2
        ),
    ).bind((pair.model,), sample).placed[0].reference  # fmt: skip
    for t in np.linspace(now, now + 1.6, 23):  # after that, a stance of the other gait has no end
        got, expected = pair.sample(t, pair.phase(t), now), other.samples(np.array([t - now]))
        for quantity in (base.position, base.orientation, base.linear_velocity, base.angular_velocity):
            assert got[quantity] == pytest.approx(expected[quantity][0], abs=1e-9), str(quantity)
        lifted = pair.model.flags(interval.phase.mode) > 0  # the others were in the air: bound gaits begin on all feet
        places = (np.ravel(value).reshape(4, 3)[lifted] for value in (got[feet.position], expected[feet.position]))
        assert next(places) == pytest.approx(next(places), abs=1e-9)


def test_without_a_ramp_a_command_counts_at_once():
    pair = GaitPair.random(model_of("mini_cheetah"), "trot", np.random.default_rng(1), ramp=0.0, heading_limit=0.0)
    x = pair.model.state(joints="stand")
    pair.advance(0.0, 0.2, x, pair.phase(0.2), (0.3, 0.0, 0.2, 0.22))
    s = pair.sample(0.2, pair.phase(0.2), 0.2)
    assert s[base.linear_velocity] == pytest.approx([0.3, 0.0, 0.0], abs=1e-12)
    assert (s[base.position][2], s[base.angular_velocity][2]) == pytest.approx((0.22, 0.2), abs=1e-12)


def test_functions_stay_finite_whatever_they_are_given():
    pair = GaitPair.random(model_of("mini_cheetah"), "bound", np.random.default_rng(1))
    functions, rng = pair.functions, np.random.default_rng(0)
    for scale in (0.0, 1.0, 30.0):
        m, x = scale * rng.normal(size=functions.num_memory), scale * rng.normal(size=pair.model.state.nx)
        c, row = scale * rng.normal(size=4), scale * rng.normal(size=functions.num_schedule)
        start = scale * rng.normal(size=functions.num_start)
        for result in (
            functions.start(x), functions.begin(start, c), functions.advance(m, scale, x, c, -scale, row),
            functions.move(m, c[:3]), functions.sample(scale, m, -scale, row), functions.pose(scale, m),
        ):  # fmt: skip
            assert np.isfinite(result.full()).all()


# ---- where a gait begins


def test_a_gait_begins_at_the_end_of_another_reference():
    body, rng = model_of("mini_cheetah"), np.random.default_rng(0)
    motion = gaits.pace(0.4, yaw_rate=0.2).cycles(2) + gaits.trot(0.3)
    path = motion.bind((body,), body.state.unpack(begin_state(body, rng)))
    first, second = (placed.reference for placed in path.placed)
    end = np.concatenate([np.ravel(v) for v in first.sample(1.05, 4).values()])
    functions = second.functions()
    memory = functions.begin(functions.pick(first.functions().quantities)(end), functions.command)
    got = functions.sample(0.6, memory, 0.55, functions.schedule(3)).full().ravel()
    at = [quantity for quantity, _ in functions.quantities].index(feet.position)
    begin = sum(size for _, size in functions.quantities[:at])
    expected = second.samples(np.array([0.6]))
    assert got[:3] == pytest.approx(expected[base.position][0], abs=1e-9)
    assert got[begin : begin + 12] == pytest.approx(expected[feet.position][0], abs=1e-9)


@pytest.mark.parametrize("known", [feet.position, joints.position, None])
def test_feet_that_are_not_given_follow_from_the_joints_or_the_standing_pose(known):
    pair, rng = GaitPair.random(model_of("go2"), "trot", np.random.default_rng(1)), np.random.default_rng(7)
    crouch = pair.model.robot.pose("crouch")
    sample = {
        joints.position: crouch, base.orientation: rotation.np_from_rpy(np.array([0.1, 0.2, 0.3])),
        feet.position: rng.normal(size=12), base.position: rng.normal(size=3), base.linear_velocity: rng.normal(size=3),
    }  # fmt: skip
    if known is not feet.position:
        del sample[feet.position]
        if known is None:
            del sample[joints.position]
    pick = pair.functions.pick(tuple((quantity, len(value)) for quantity, value in sample.items()))
    start = pick(np.concatenate(list(sample.values()))).full().ravel()
    pose = [sample[base.position], sample[base.orientation]]
    assert start[:13] == pytest.approx(np.concatenate([*pose, sample[base.linear_velocity], np.zeros(3)]))
    angles = crouch if known is joints.position else pair.model.robot.pose("stand")
    wanted = (
        sample[feet.position] if known is feet.position else pair.numpy.kinematics.world_feet(*pose, angles).ravel()
    )
    assert start[13:] == pytest.approx(wanted, abs=1e-12)


def test_a_start_without_a_base_is_an_error():
    functions = GaitPair.random(model_of("go2"), "trot", np.random.default_rng(1)).functions
    with pytest.raises(
        ProblemError, match=r"gait: cannot begin at the end .* - got one without 'base.orientation', exp"
    ):
        functions.pick(((base.position, 3),))


# ---- the parts


def test_the_way_is_the_integral_of_the_velocity_for_up_to_half_a_turn_in_the_ramp():
    rng, symbols = (
        np.random.default_rng(0),
        [cs.SX.sym(name, size) for name, size in zip("pflrt", (3, 3, 3, 1, 1), strict=True)],
    )
    position = cs.Function("position", symbols, [PathExpression(*symbols[:4]).position(symbols[4])])
    for _ in range(100):
        ramp, pose = rng.uniform(0.05, 3.0), rng.normal(size=3)
        first, last = (np.array([*rng.uniform(-1, 1, 2), rate]) for rate in rng.permutation([0.0, 2 * np.pi / ramp]))
        t = rng.uniform(0.0, 1.3 * ramp)
        expected = BasePath(tuple(pose), first, last, ramp).position(np.array(t))
        assert position(pose, first, last, ramp, t).full().ravel() == pytest.approx(expected, abs=1e-10)


def test_functions_have_a_form_in_c():
    functions = GaitPair.random(model_of("anymal_c"), "walk", np.random.default_rng(1)).functions
    names = ("start", "begin", "advance", "move", "sample", "pose")
    units = codegen.generate({f"gait_{name}": getattr(functions, name) for name in names})
    assert set(units.work) == {f"gait_{name}" for name in names}
    assert functions.sample.n_instructions() < 15_000


def test_functions_that_do_not_fit_each_other_are_refused():
    functions = GaitPair.random(model_of("go2"), "trot", np.random.default_rng(1)).functions
    with pytest.raises(ShapeError, match=r"'pose': wrong sizes - got inputs \(3,\) and output 3, expected \(1, 34\)"):
        replace(functions, pose=cs.Function("pose", [cs.SX.sym("t", 3)], [cs.SX.zeros(3)]))
    with pytest.raises(ShapeError, match=r"command: wrong size - got shape \(2,\), expected \(4,\)"):
        replace(functions, command=np.zeros(2))


def test_references_have_tables_unless_they_say_otherwise():
    body = model_of("mini_cheetah")
    motion = ocp.Motion(ocp.Phase("stand", stance("FL FR HL HR"), 0.1, ocp.Keyframe(joints="stand")))
    assert motion.bind((body,), body.state.unpack(body.state())).placed[0].reference.functions() is None
