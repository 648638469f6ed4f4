"""The highest bar under a motion, against closed forms."""

import mujoco
import numpy as np
import pytest

from piaffe import models, simulation
from piaffe.errors import ModelError, ShapeError


def flying(geom, quat=None):
    """Return a model of one free body with a geom."""
    turn = "" if quat is None else f'quat="{" ".join(map(str, quat))}"'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="plane" size="1 1 1"/><body><freejoint/>'
        f'<geom {geom} {turn} mass="1"/></body></worldbody></mujoco>'
    )


def path(heights, across, along=0.0, turn=None):
    """Return positions (T, 7) of a body on a path across a line."""
    across, heights = np.asarray(across), np.asarray(heights)
    places = np.column_stack([-np.sin(along) * across, np.cos(along) * across, heights])
    turn = np.tile([1.0, 0, 0, 0], (len(across), 1)) if turn is None else turn
    return np.column_stack([places, turn])


S = np.linspace(-0.6, 0.6, 1201)  # every millimetre


@pytest.mark.parametrize("along", [0.0, 0.7, np.pi / 2])
def test_ball_on_a_parabola_passes_over_its_radius_below_the_apex_or_less_where_the_path_is_steep(along):
    # At s = 0 the ball's lower side is at z0 - k y² - sqrt(r² - y²) while its centre is at y: least at y = 0 if
    # 2 k r < 1, else at sqrt(r² - y²) = 1 / (2 k), where it is z0 - k r² - 1 / (4 k).
    r, z0 = 0.1, 0.6
    model = flying(f'type="sphere" size="{r}"')
    for k, expected in ((0.5, z0 - r), (8.0, z0 - 8 * r**2 - 1 / 32)):
        bar = simulation.highest_bar(model, path(z0 - k * S**2, S, along), along=along, step=0.001)
        assert bar.height == pytest.approx(expected, abs=2e-4)
        assert bar.height <= expected + 1e-6
        assert bar.place == pytest.approx(0.0, abs=2e-3)


def test_box_that_turns_over_the_bar_passes_with_its_corner_or_its_side():
    # A level box passes over its lower side; a box that has turned by 45° over its corner.
    a, b, z0 = 0.2, 0.05, 0.7
    model = flying(f'type="box" size="0.3 {a} {b}"')
    flat = simulation.highest_bar(model, path(np.full(len(S), z0), S))
    assert flat.height == pytest.approx(z0 - b, abs=1e-6)
    half = np.pi / 8
    turned = np.tile([np.cos(half), np.sin(half), 0, 0], (len(S), 1))
    tilted = simulation.highest_bar(model, path(np.full(len(S), z0), S, turn=turned))
    corner = z0 - (a + b) / np.sqrt(2)
    assert 0 <= tilted.height - corner <= 5e-4  # the nearest state has it within half a millimetre of the bar


@pytest.mark.parametrize(
    ("geom", "below"),
    [
        ('type="capsule" size="0.03 0.1"', 0.13),
        ('type="cylinder" size="0.03 0.1"', 0.10),
        ('type="ellipsoid" size="0.03 0.05 0.2"', 0.20),
    ],
)
def test_upright_geoms_reach_as_far_down_as_their_size_says(geom, below):
    bar = simulation.highest_bar(flying(geom), path(np.full(len(S), 0.5), S))
    assert bar.height == pytest.approx(0.5 - below, abs=1e-4)


def test_mesh_counts_with_its_vertices():
    corners = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.2, 0.2) for z in (-0.05, 0.05))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="m" vertex="{corners}"/></asset><worldbody><body><freejoint/>'
        '<geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    bar = simulation.highest_bar(model, path(np.full(len(S), 0.5), S))
    assert bar.height == pytest.approx(0.45, abs=1e-5)


def test_state_in_which_the_bar_is_nearest_is_named():
    model = flying('type="sphere" size="0.1"')
    heights = np.full(len(S), 0.5)
    heights[600] = 0.45  # one state, at s = 0, is lower
    bar = simulation.highest_bar(model, path(heights, S), step=0.001)
    assert abs(bar.place) > 0.08  # the best bar avoids what is below this ball
    assert bar.height == pytest.approx(0.4, abs=1e-4)


def test_motion_that_stays_on_one_side_has_no_bar():
    model = flying('type="sphere" size="0.1"')
    bar = simulation.highest_bar(model, path([0.5, 0.5], [0.0, 0.15]))
    assert (bar.height, bar.lowest) == (0.0, -1)
    assert np.isnan(bar.place)


def test_robot_on_its_feet_passes_over_nothing():
    robot = models.load("mini_cheetah")
    model = models.mujoco_model(robot, hull=True)
    body = models.WholeBody(robot)
    x = np.tile(body.state(joints="stand"), (200, 1))
    x[:, 1] = np.linspace(0, 1, 200)
    assert simulation.highest_bar(model, x).height < 1e-3


def test_wrong_positions_and_models_are_refused():
    model = flying('type="sphere" size="0.1"')
    with pytest.raises(ShapeError, match=r"^bar: positions have the wrong size - got shape \(1, 7\), expected"):
        simulation.highest_bar(model, np.zeros((1, 7)))
    fixed = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom type="sphere" size="1"/></worldbody></mujoco>')
    with pytest.raises(ModelError, match=r"^silhouette: geoms are unusable - got none that moves, expected"):
        simulation.highest_bar(fixed, np.zeros((2, 0)))
