"""Gaits: contact patterns, and references that are consistent with themselves and start where the robot is."""

from functools import cache
from math import pi
from pathlib import Path

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import ModelError, ProblemError
from piaffe.models import base, feet, gaits, joints
from piaffe.models.gaits.base_path import BasePath
from piaffe.models.gaits.footsteps import Known
from piaffe.ocp import rotation

GAITS = ("bound", "pace", "flying_pace", "trot", "flying_trot", "pronk", "walk")
# contact sets of the cycle, from the files published with CAFE-MPC (but for the walk); names of Mini Cheetah's feet
CYCLES = {
    "pace": [("FR HR", 0.25), ("FL HL", 0.25)],
    "flying_pace": [("FR HR", 0.15), ("", 0.10), ("FL HL", 0.15), ("", 0.10)],
    "trot": [("FL HR", 0.25), ("FR HL", 0.25)],
    "flying_trot": [("FL HR", 0.15), ("", 0.10), ("FR HL", 0.15), ("", 0.10)],
    "bound": [("FL FR", 0.10), ("", 0.10), ("HL HR", 0.10), ("", 0.10)],
    "pronk": [("FL FR HL HR", 0.10), ("", 0.20)],
    "walk": [
        ("FL FR HR", 0.20),
        ("FL FR HL HR", 0.05),
        ("FR HL HR", 0.20),
        ("FL FR HL HR", 0.05),
        ("FL FR HL", 0.20),
        ("FL FR HL HR", 0.05),
        ("FL HL HR", 0.20),
        ("FL FR HL HR", 0.05),
    ],
}
TIMES = np.arange(0.0, 3.0, 0.005)


@cache
def whole_body(name):
    return models.WholeBody(models.load(name))


@pytest.fixture(scope="module")
def body():
    return whole_body("mini_cheetah")


def bind(body, motion, **state):
    return motion.bind((body,), body.state.unpack(body.state(**state))).placed[0].reference


def stacked(samples, quantity):
    return samples[quantity].reshape(len(TIMES), -1, 3)


@pytest.mark.parametrize("name", GAITS)
def test_contact_patterns_are_the_expected_ones(body, name):
    intervals = getattr(gaits, name)().intervals()
    assert str(body.resolve(next(intervals).phase.mode)) == "FL FR HL HR"
    for (contacts, duration), interval in zip(CYCLES[name] * 2, intervals, strict=False):
        assert str(body.resolve(interval.phase.mode)) == contacts
        assert interval.phase.duration == duration


@pytest.mark.parametrize("name", GAITS)
def test_gaits_bind_for_robots_with_other_names(name):
    for robot in ("go2", "solo12", "anymal_c"):
        sample = bind(whole_body(robot), getattr(gaits, name)(0.4)).sample(1.03, 5)
        assert sample[feet.position].shape == (12,)


def test_a_biped_paces_on_its_two_feet():
    urdf = Path(__file__).parents[2] / "examples" / "biped.urdf"
    biped = models.WholeBody(models.load(urdf, feet="L_FOOT R_FOOT"))
    contacts = [str(biped.resolve(i.phase.mode)) for i, _ in zip(gaits.pace(0.2).intervals(), range(3), strict=False)]
    assert contacts == ["L R", "R", "L"]
    assert bind(biped, gaits.pace(0.2)).sample(0.4, 2)[feet.position].shape == (6,)


def test_roles_that_are_none_are_flight(body):
    assert models.stance(roles="") == models.stance("")
    assert str(body.resolve(models.stance(roles="all"))) == "FL FR HL HR"


@pytest.mark.parametrize("name", GAITS)
def test_velocities_are_the_derivatives_of_positions(body, name):
    """On a finer grid; the acceleration of a swing jumps, so the difference errs by half a jump there."""
    reference = bind(body, getattr(gaits, name)(0.5, yaw_rate=0.6, lateral_speed=0.1))
    step = 1e-5
    here, there = (reference.samples(TIMES + shift) for shift in (-step, step))
    now = reference.samples(TIMES)
    pairs = ((base.position, base.linear_velocity), (feet.position, feet.velocity), (joints.position, joints.velocity))
    for position, velocity in pairs:
        assert (there[position] - here[position]) / (2 * step) == pytest.approx(now[velocity], abs=5e-3)
    turned = rotation.np_log(
        rotation.np_multiply(rotation.np_conjugate(here[base.orientation]), there[base.orientation])
    ) / (2 * step)
    assert turned == pytest.approx(now[base.angular_velocity], abs=1e-5)


def test_position_is_the_true_integral_of_the_ramped_velocity(body):
    reference = bind(body, gaits.trot(0.5, ramp=2.5))
    x = reference.samples(np.array([0.0, 2.5, 3.5]))[base.position][:, 0]
    assert x == pytest.approx([0.0, 0.5 * 2.5 / 2, 0.5 * 2.5 / 2 + 0.5], abs=1e-9)


def test_the_path_of_a_steady_turn_is_a_circle():
    path = BasePath((1.0, 2.0, 0.3), np.array([0.5, 0.0, 0.5]), np.array([0.5, 0.0, 0.5]), 0.0)
    t = np.linspace(0, 4 * pi, 50)
    centre = np.array([1.0, 2.0]) + (0.5 / 0.5) * np.array([-np.sin(0.3), np.cos(0.3)])
    assert np.linalg.norm(path.position(t) - centre, axis=-1) == pytest.approx(1.0, abs=1e-12)
    assert path.position(np.array(4 * pi)) == pytest.approx([1.0, 2.0], abs=1e-12)


def test_the_path_of_a_turning_ramp_is_the_integral_of_its_velocity():
    path = BasePath((0.0, 0.0, 0.0), np.array([0.1, 0.2, -0.5]), np.array([1.0, -0.3, 1.5]), 1.5)
    t = np.linspace(0, 2.5, 20001)
    velocity = path.velocity(t)
    integral = np.sum((velocity[1:] + velocity[:-1]) / 2, axis=0) * (t[1] - t[0])
    assert path.position(np.array(2.5)) == pytest.approx(integral, abs=1e-8)


@pytest.mark.parametrize("name", GAITS)
def test_feet_stand_still_on_the_ground_and_swing_above_it(body, name):
    reference = bind(body, getattr(gaits, name)(0.5, swing_height=0.08))
    samples = reference.samples(TIMES)
    place, moving = stacked(samples, feet.position), stacked(samples, feet.velocity)
    for i, t in enumerate(TIMES):
        interval = next(k for k in getattr(gaits, name)().intervals() if k.start <= t + 1e-12 < k.end)
        on = body.flags(interval.phase.mode) > 0
        assert place[i, on, 2] == pytest.approx(body.robot.foot_radius, abs=1e-12)
        assert np.abs(moving[i, on]).max(initial=0.0) < 1e-9
    assert place[..., 2].min() >= body.robot.foot_radius - 1e-12
    assert place[..., 2].max() == pytest.approx(body.robot.foot_radius + 0.08, abs=2e-3)


@pytest.mark.parametrize("name", GAITS)
def test_joints_put_the_feet_where_the_reference_has_them(body, name):
    speed = 0.8 if name != "walk" else 0.3  # a foot of the walk stands three times as long
    reference = bind(body, getattr(gaits, name)(speed, yaw_rate=0.5))
    samples = reference.samples(TIMES)
    reached = reference.kinematics.world_feet(
        samples[base.position], samples[base.orientation], samples[joints.position]
    )
    assert reached == pytest.approx(stacked(samples, feet.position), abs=1e-8)
    assert np.all(np.abs(samples[joints.position]) <= body.robot.joint_upper)


def test_a_steady_stance_is_centred_about_its_hip(body):
    """Raibert: the foot lands v T / 2 ahead of the place below its hip."""
    reference = bind(body, gaits.trot(0.6, ramp=0.5, intro=0.0))
    home = reference.kinematics.feet(body.robot.pose("stand"))
    samples = reference.samples(np.array([2.0, 2.25]))  # touchdown and lift-off of the left diagonal
    for i, lead in ((0, 0.6 * 0.25 / 2), (1, -0.6 * 0.25 / 2)):
        offset = samples[feet.position][i].reshape(4, 3)[0, :2] - samples[base.position][i, :2]
        assert offset == pytest.approx(home[0, :2] + [lead, 0.0], abs=1e-9)


def test_feet_stand_back_while_the_base_speeds_up_and_outside_while_it_turns(body):
    home = models.Kinematics(body.robot).feet(body.robot.pose("stand"))
    ramping = bind(body, gaits.trot(1.0, ramp=2.0, intro=0.0, height=0.25))
    middle = ramping.samples(np.array([1.125]))  # mid-stance
    offset = middle[feet.position].reshape(4, 3)[0, 0] - middle[base.position][0, 0]
    assert offset - home[0, 0] == pytest.approx(-0.25 / 9.81 * 0.5, abs=1e-6)
    turning = bind(body, gaits.trot(0.5, yaw_rate=1.0, ramp=0.5, intro=0.0, height=0.25))
    middle = turning.samples(np.array([2.125]))
    yaw = rotation.np_to_rpy(middle[base.orientation])[0, 2]
    arm = middle[feet.position].reshape(4, 3)[0, :2] - middle[base.position][0, :2]
    c, s = np.cos(yaw), np.sin(yaw)
    inward = np.array([c * arm[0] + s * arm[1], -s * arm[0] + c * arm[1]])
    assert inward[1] - home[0, 1] == pytest.approx(-0.25 / 9.81 * 0.5, abs=1e-6)


@pytest.mark.parametrize("speed", [1.6, -1.6])
def test_footholds_are_clamped_on_both_sides(body, speed):
    reference = bind(body, gaits.trot(speed, ramp=0.5, intro=0.0, stance_time=0.2))
    box = 0.5 * reference.kinematics.reach[0]
    reference._error = np.array([10 * speed, 0.0])
    reference._anchor = 0.9  # the next foothold makes up for a push
    home = reference.kinematics.feet(body.robot.pose("stand"))
    reference.footsteps._known = Known()
    samples = reference.samples(np.array([1.2]))
    offset = samples[feet.position].reshape(4, 3)[0, 0] - samples[base.position][0, 0] - home[0, 0]
    assert offset == pytest.approx(np.sign(speed) * box, abs=1e-9)


def test_forces_share_the_weight_and_carry_it_over_a_cycle(body):
    trot, bound = bind(body, gaits.trot()), bind(body, gaits.bound())
    weight = body.robot.mass * 9.81
    assert trot.sample(0.1, 1)[feet.force].reshape(4, 3) == pytest.approx(
        np.array([[0, 0, weight / 2], [0, 0, 0], [0, 0, 0], [0, 0, weight / 2]])
    )
    assert bound.sample(0.1, 1)[feet.force].sum() == pytest.approx(2 * weight)  # half the time in the air
    assert not bound.sample(0.2, 2)[feet.force].any()


def test_a_boundary_belongs_to_the_phase_that_asks(body):
    reference = bind(body, gaits.bound())
    assert reference.sample(0.15, 1)[feet.force].any()
    assert not reference.sample(0.15, 2)[feet.force].any()


def test_a_gait_begins_where_the_robot_is(body):
    state = {"position": (3.0, -1.0, 0.2), "rpy": (0.1, -0.05, 2.0), "linear_velocity": (0.2, 0.1, 0.0)}
    reference = bind(body, gaits.pace(0.5, yaw_rate=0.3), **state, joints="crouch")
    sample = reference.sample(0.0, 0)
    assert sample[base.position] == pytest.approx([3.0, -1.0, 0.2])
    assert rotation.np_to_rpy(sample[base.orientation]) == pytest.approx([0.1, -0.05, 2.0])
    assert sample[base.linear_velocity][:2] == pytest.approx([0.2, 0.1])
    actual = reference.kinematics.world_feet(sample[base.position], sample[base.orientation], body.robot.pose("crouch"))
    assert sample[feet.position].reshape(4, 3)[:, :2] == pytest.approx(actual[:, :2])


def test_gaits_follow_one_another_without_a_jump(body):
    motion = gaits.pace(0.6).cycles(3) + gaits.bound(0.4, yaw_rate=0.2).cycles(2)
    path = motion.bind((body,), body.state.unpack(body.state()))
    intervals = list(motion.intervals())
    seam = next(i for i in intervals if i.piece == 1)
    before, after = path.sample(seam.start, intervals[intervals.index(seam) - 1]), path.sample(seam.start, seam)
    for quantity in (base.position, base.orientation, base.linear_velocity, feet.position, joints.position):
        assert after[quantity] == pytest.approx(before[quantity], abs=1e-6), str(quantity)


def test_an_anchored_gait_goes_on_from_where_the_robot_really_is(body):
    reference = bind(body, gaits.trot(0.5, ramp=0.0, intro=0.0))
    actual = dict(reference.sample(1.1, 4))
    actual[base.position] = actual[base.position] + [0.03, -0.02, 0.0]
    actual[base.linear_velocity] = actual[base.linear_velocity] + [0.0, 0.2, 0.0]
    moved = reference.anchored(1.1, actual)
    assert moved.sample(1.1, 4)[base.position] == pytest.approx(actual[base.position])
    standing = body.flags("FL HR") > 0
    places = moved.sample(1.1, 4)[feet.position], actual[feet.position]
    assert places[0].reshape(4, 3)[standing] == pytest.approx(places[1].reshape(4, 3)[standing])
    step = moved.sample(1.3, 5)[feet.position].reshape(4, 3)[1] - moved.sample(1.3, 5)[base.position]
    lead = reference.sample(1.3, 5)[feet.position].reshape(4, 3)[1] - reference.sample(1.3, 5)[base.position]
    gain = np.sqrt(body.robot.base_height() / 9.81)
    assert (step - lead)[:2] == pytest.approx([0.0, 0.2 * gain], abs=1e-9)


def test_a_gait_that_is_anchored_at_a_touchdown_corrects_the_foothold_after_it(body):
    """The times of boundaries are sums of durations; a touchdown just after the anchor by rounding is at the anchor."""
    reference = bind(body, gaits.trot(0.5, ramp=0.0, intro=0.0))
    t = float(reference.footsteps.schedule.stances(1, 2.0)[2, 0]) - 1e-9  # FR
    actual = dict(reference.sample(t, 2))
    actual[base.linear_velocity] = actual[base.linear_velocity] + [0.0, 0.2, 0.0]
    moved = reference.anchored(t, actual)
    for later, change in ((t + 0.1, 0.0), (t + 0.6, 0.2 * np.sqrt(body.robot.base_height() / 9.81))):
        before, after = (r.samples(np.array([later]))[feet.position][0].reshape(4, 3)[1] for r in (reference, moved))
        assert after - before == pytest.approx([0.0, change, 0.0], abs=1e-7)


def test_a_gait_that_does_not_repeat_may_end_before_its_feet_are_out_of_reach(body):
    phases = [ocp.Phase(f"{i}", models.stance(feet), 0.2) for i, feet in enumerate(("FL HR", "FR HL", "FL FR HL HR"))]
    motion = ocp.Motion(*phases, reference=gaits.GaitReference(speed=0.5, ramp=0.2))
    end = bind(body, motion).sample(0.6, 2)
    assert end[base.position][0] == pytest.approx(0.05 + 0.5 * 0.4)
    with pytest.raises(ProblemError, match=r"out of reach - got \d\.\d+ m too far at speed 0\.5 m/s"):
        bind(
            body, ocp.Motion(ocp.Phase("lean", models.stance("FL FR HL HR"), 1.5), reference=motion.pieces[0].reference)
        )


def test_sampling_a_gait_is_cheap_and_repeatable(body):
    reference = bind(body, gaits.flying_trot(0.5))
    one, again = reference.sample(0.37, 3), reference.sample(0.37, 3)
    fresh = bind(body, gaits.flying_trot(0.5)).samples(np.array([0.37]))
    for quantity, values in fresh.items():
        assert one[quantity] == pytest.approx(values[0], abs=1e-12)
        assert one[quantity] is again[quantity]


def test_an_own_gait_takes_three_lines(body):
    gallop = gaits.gait(
        ("lead", "front left", 0.08), ("second", "front right", 0.08), ("flight", (), 0.06), ("hind", "hind", 0.12),
        speed=0.8,
    )  # fmt: skip
    assert [str(body.resolve(k.phase.mode)) for k, _ in zip(gallop.intervals(), range(4), strict=False)][1] == "FL"
    assert bind(body, gallop).sample(2.0, 9)[base.linear_velocity][0] == pytest.approx(0.8)


def test_gait_errors_say_what_to_change(body):
    with pytest.raises(ProblemError, match=r"gait: ramp is out of range - got -1.0, expected seconds ≥ 0"):
        gaits.trot(ramp=-1.0)
    with pytest.raises(ProblemError, match=r"gait: speed is out of range - got nan, expected a finite number"):
        gaits.trot(float("nan"))
    with pytest.raises(ProblemError, match=r"gait: heading_limit is out of range - got -0.1, expected 0 to π rad"):
        gaits.trot(heading_limit=-0.1)
    with pytest.raises(ProblemError, match=r"gait: heading_limit is out of range - got nan"):
        gaits.trot(heading_limit=float("nan"))
    with pytest.raises(ProblemError, match=r"gait: no phases - got none, expected at least one"):
        gaits.gait()
    with pytest.raises(ProblemError, match=r"out of reach - got \d\.\d+ m too far at speed 4\.0 m/s.*lower the speed"):
        bind(body, gaits.trot(4.0))
    ball = ocp.Model("ball", state={"z": 1}, control={"f": 1}, modes={"fall": lambda s: {"z": s.f}})
    with pytest.raises(ModelError, match=r"gait: model 'ball' has no feet - got Model, expected"):
        gaits.trot().bind((ball,), {})
