"""What seeds draw of a plant, and which parts of an episode count for its speed."""

import numpy as np
import pytest

from piaffe.errors import ModelError
from piaffe.simulation import Plant, SensorNoise, Variation, stretches
from tests.simulation import other_go2
from tests.simulation.plans import ROBOT

LINKS = Plant(ROBOT).links


def test_links_begin_with_the_base_and_name_every_body() -> None:
    compiled = Plant(ROBOT).scene.compiled
    assert LINKS[0] == compiled.body(1).name
    assert len(LINKS) == ROBOT.num_joints + 1


def test_masses_of_base_and_legs_and_friction_are_uniform_in_their_ranges() -> None:
    drawn = [Variation().numbers(LINKS, seed) for seed in range(2000)]
    base, leg, friction = (
        np.array([value(each) for each in drawn])
        for value in (
            lambda each: each["mass_scale"][LINKS[0]],
            lambda each: each["mass_scale"][LINKS[-1]],
            lambda each: each["friction"],
        )
    )
    for values, low, high in ((base, 0.95, 1.05), (leg, 0.95, 1.05), (friction, 0.5, 0.8)):
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.02 * (high - low))  # 3 standard errors
        assert values.std() == pytest.approx((high - low) / np.sqrt(12), rel=0.04)
    assert abs(np.corrcoef([base, leg, friction])[np.triu_indices(3, 1)]).max() < 0.07  # 3 standard errors
    for each in drawn[:3]:
        assert len({each["mass_scale"][name] for name in LINKS[1:]}) == 1


def test_what_is_switched_off_does_not_change_what_else_is_drawn() -> None:
    whole, none = Variation().numbers(LINKS, 7), Variation(mass=0.0, friction=None).numbers(LINKS, 7)
    assert set(none) == {"noise"}
    assert Variation(mass=0.0).numbers(LINKS, 7)["friction"] == whole["friction"]
    assert Variation(friction=None).numbers(LINKS, 7)["mass_scale"] == whole["mass_scale"]
    assert Variation().numbers(LINKS, 7) == whole


def test_a_plant_takes_the_numbers_that_were_drawn() -> None:
    numbers = Variation(noise=SensorNoise(joints=0.01)).numbers(LINKS, 3)
    plain, made = Plant(ROBOT), Plant(ROBOT, **numbers)
    for i, name in enumerate(LINKS):
        b = plain.scene.compiled.body(name).id
        factor = numbers["mass_scale"][name]
        assert made.scene.compiled.body_mass[b] == pytest.approx(factor * plain.scene.compiled.body_mass[b]), i
    assert made.noise.joints == 0.01


def test_masses_of_bodies_without_names_change_too() -> None:
    text = other_go2.text().replace('<body name="front_left_knee"', "<body")
    plain = _plant(text)
    changed = _plant(text, mass_scale=dict.fromkeys(plain.links, 1.1))
    np.testing.assert_allclose(changed.scene.compiled.body_mass, 1.1 * plain.scene.compiled.body_mass)


def _plant(text: str, **changes: object) -> Plant:
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "other.xml"
        path.write_text(text)
        return Plant.from_mjcf(path, other_go2.ROBOT, joints=other_go2.JOINTS, feet=other_go2.FEET, **changes)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass": -0.1}, "variation: mass is out of range - got -0.1"),
        ({"mass": 1.0}, "variation: mass is out of range - got 1.0"),
        ({"friction": (0.8, 0.5)}, "variation: friction is out of range - got 0.8 to 0.5"),
        ({"friction": (-0.1, 0.5)}, "variation: friction is out of range - got -0.1 to 0.5"),
    ],
)
def test_bad_ranges_are_refused(given: dict, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Variation(**given)


def test_noise_is_scaled_in_every_kind() -> None:
    noise = SensorNoise(position=1.0, orientation=2.0, acceleration=3.0).scaled(0.5)
    assert (noise.position, noise.orientation, noise.acceleration, noise.joints) == (0.5, 1.0, 1.5, 0.0)


# ---- what counts for the speed


def test_each_constant_command_counts_without_its_beginning() -> None:
    times = np.arange(0, 6, 0.01)
    commands = np.zeros((600, 3))
    commands[:, 0] = 0.5
    commands[300:, 0] = 0.8
    found = stretches(times, commands, 1.0)
    assert [(part.start, part.stop) for part in found] == [(100, 300), (400, 600)]


def test_what_is_shorter_than_half_a_second_does_not_count() -> None:
    times = np.arange(0, 3, 0.01)
    commands = np.full((300, 3), 0.1)
    commands[160:, 2] = 0.2
    assert [(part.start, part.stop) for part in stretches(times, commands, 1.0)] == [(100, 160)]
    assert stretches(times, commands, 1.2) == []


def test_without_commands_nothing_counts() -> None:
    assert stretches(np.arange(3.0), np.full((3, 3), np.nan), 0.0) == []
    assert stretches(np.zeros(0), np.zeros((0, 3)), 0.0) == []
