"""The shipped examples have no mistake: their only warnings are keyframes that lift feet of a stance, as meant."""

from pathlib import Path

import pytest

from piaffe import ocp

EXAMPLES = Path(__file__).parents[2] / "examples"
LIFTED = {"barrel_roll": 3, "backflip": 2}


@pytest.mark.parametrize(
    "name",
    [
        "barrel_roll",
        "backflip",
        "biped",
        "cascade",
        "gaits",
        "own_dynamics",
        "own_terms",
        "own_model_mpc",
        "short_horizon",
        "sideways_hop",
    ],
)
def test_an_example_has_no_warning_that_is_wrong(name):
    found = ocp.load_problem(str(EXAMPLES / f"{name}.py")).warnings()
    assert len(found) == LIFTED.get(name, 0), found
    for warning in found:  # the base is turned while all feet stand: true of these keyframes, which are only targets
        assert "foot is not on the ground" in warning.text
        assert f"({name}.py:" in warning.where
