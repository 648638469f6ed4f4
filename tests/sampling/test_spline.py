import numpy as np
import pytest

from piaffe.sampling.controllers import spline as module
from piaffe.sampling.controllers.spline import Spline

# Published weights of nodes 0 … 4 on controls 0 … 7 of 16; rows 9 to 16 mirror them.
PUBLISHED = np.array([
    [1, 0, 0, 0, 0],
    [0.6402, 0.4884, -0.15, 0.0241, -0.0027],
    [0.3536, 0.8179, -0.20, 0.0321, -0.0036],
    [0.1402, 0.9884, -0.15, 0.0241, -0.0027],
    [0, 1, 0, 0, 0],
    [-0.067, 0.8527, 0.25, -0.0402, 0.0045],
    [-0.0607, 0.5464, 0.60, -0.0964, 0.0107],
    [-0.0241, 0.217, 0.90, -0.1045, 0.0116],
    [0, 0, 1, 0, 0],
])  # fmt: skip


def test_weights_are_the_published_ones():
    weights = Spline(4, 16).to_controls
    assert weights[:9] == pytest.approx(PUBLISHED, abs=6e-5)
    assert weights[9:] == pytest.approx(PUBLISHED[7::-1, ::-1], abs=6e-5)


def test_a_shorter_horizon_takes_every_other_row():
    assert Spline(4, 8).to_controls == pytest.approx(Spline(4, 16).to_controls[::2], abs=1e-12)


@pytest.mark.parametrize(("knots", "steps"), [(2, 8), (4, 10), (5, 20), (6, 24), (8, 8)])
def test_parabolas_are_kept_and_nodes_are_met(knots, steps):
    spline = Spline(knots, steps)
    nodes, steps_at = np.linspace(0, steps, knots + 1), np.linspace(-1.0, steps + 2.0, 50)
    parabola = np.polynomial.Polynomial([0.3, -0.2, 0.05])
    assert spline.at(steps_at) @ parabola(nodes) == pytest.approx(parabola(steps_at), abs=1e-9)
    assert spline.at(nodes) == pytest.approx(np.eye(knots + 1), abs=1e-12)


def test_nodes_of_controls_are_samples_where_the_horizon_is_divisible():
    assert Spline(4, 16).to_nodes == pytest.approx(np.eye(17)[::4], abs=1e-9)


def test_nodes_of_controls_invert_what_a_parabola_made():
    spline = Spline(4, 10)
    nodes = np.linspace(0, 10, 5) ** 2
    assert spline.to_nodes @ spline.to_controls @ nodes == pytest.approx(nodes, abs=1e-9)


@pytest.mark.parametrize(("knots", "steps"), [(4, 8), (5, 20)])
def test_controls_are_clipped_splines_in_units_in_c_and_in_numpy(knots, steps, monkeypatch):
    rng = np.random.default_rng(0)
    nodes, centre, half = rng.uniform(-1, 1, (7, knots + 1, 3)), rng.normal(size=3), rng.uniform(0.1, 1, 3)
    spline = Spline(knots, steps)
    raw = np.einsum("hj,njc->nhc", spline.to_controls, nodes)
    assert np.abs(raw).max() > 1.0
    controls = []
    for _ in range(2):
        controls.append(spline.controls(nodes, centre, half))
        monkeypatch.setattr(module, "_library", lambda: None)
    for each in controls:
        assert each == pytest.approx(centre + half * np.clip(raw, -1.0, 1.0), abs=1e-14)


def test_controls_of_plans_in_single_precision_are_theirs():
    nodes = np.random.default_rng(1).uniform(-1, 1, (3, 5, 2)).astype(np.float32)
    centre, half = np.array([0.5, -0.5], dtype=np.float32), np.ones(2, dtype=np.float32)
    spline = Spline(4, 8)
    expected = centre + np.clip(np.einsum("hj,njc->nhc", spline.to_controls, nodes), -1.0, 1.0)
    assert spline.controls(nodes, centre, half) == pytest.approx(expected, abs=1e-6)


def test_the_first_control_is_the_first_node_to_the_last_bit():
    nodes = np.random.default_rng(0).uniform(-1, 1, (7, 5, 3))
    nodes[:, 0] = nodes[0, 0]
    controls = Spline(4, 8).controls(nodes, np.array([0.1, 0.2, 0.3]), np.full(3, 0.7))
    assert (controls[:, 0] == controls[0, 0]).all()
