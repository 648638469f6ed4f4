import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from piaffe import models, ocp
from piaffe.errors import FileFormatError, SamplingError, UnknownNameError
from piaffe.ocp.compiler.nodes import Nodes
from piaffe.sampling import Options, Reward
from piaffe.sampling.value.fingerprint import differences, fingerprint, plain
from piaffe.sampling.value.inputs import ValueInputs
from piaffe.sampling.value.network import Network
from piaffe.sampling.value.store import Value, digest, load_value

from .test_value_network import make
from .value_problem import trot_problem


def controller(reward: Reward | None = None, options: Options | None = None, **problem: Any) -> Any:
    """Return what a value asks of a controller."""
    return SimpleNamespace(
        nodes=Nodes(trot_problem(**problem)), reward=reward or Reward(0.5), options=options or Options()
    )


@pytest.fixture(scope="module")
def trot() -> Any:
    return controller()


@pytest.fixture(scope="module")
def value(trot: Any) -> Value:
    inputs = ValueInputs()
    network = make((49, 64, 32))
    network = Network(np.zeros(49, np.float32), np.ones(49, np.float32), network.layers, network.head, 0.25)
    entries = json.loads(json.dumps(fingerprint(trot.nodes, trot.reward, trot.options, inputs)))
    return Value(network, inputs, entries, {"command": "test", "c_max": [0.1]}, {"tilt": 0.5, "height": 0.15})


def states_of(trot: Any) -> np.ndarray:
    rng = np.random.default_rng(0)
    states = trot.nodes.problem.initial + 0.02 * rng.standard_normal((30, 37))
    return trot.nodes.model.state.np_normalise(states)


def test_value_is_the_networks_of_its_inputs(value: Value, trot: Any) -> None:
    states = states_of(trot)
    seen = ValueInputs().bind(trot.nodes, "numpy")(states, 60)
    np.testing.assert_allclose(value(states, 60, trot.nodes), value.network(seen), rtol=1e-5)
    assert value.discount == 0.9


def test_a_robot_that_has_fallen_has_no_value(value: Value, trot: Any) -> None:
    states = states_of(trot)
    states[3, 2] -= 0.15
    states[5, 3:7] = [np.cos(0.3), np.sin(0.3), 0.0, 0.0]
    values = value(states, 60, trot.nodes)
    np.testing.assert_array_equal(values[[3, 5]], 0.0)
    np.testing.assert_array_equal(values == 0.0, trot.nodes.model.fallen(states))


def test_saved_value_is_loaded_as_it_was(value: Value, trot: Any, tmp_path: Path) -> None:
    path = value.save(tmp_path / "some")
    assert path.name == "some.value"
    again = load_value(path, trot)
    states = states_of(trot)
    np.testing.assert_array_equal(again(states, 60, trot.nodes), value(states, 60, trot.nodes))
    assert again.record == value.record
    assert again.made_for == value.made_for
    assert again.fall == value.fall
    assert path.read_bytes() == value.save(tmp_path / "other").read_bytes()
    assert [file.name for file in tmp_path.iterdir() if file.suffix != ".value"] == []


def test_digest_tells_values_apart_and_not_how_they_came_about(value: Value, tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.value" for name in ("one", "two", "other")]
    value.save(files[0])
    replace(value, record={"command": "another"}).save(files[1])
    replace(value, network=replace(value.network, head_bias=value.network.head_bias + 1.0)).save(files[2])
    assert digest(files[0]) == digest(files[1])
    assert digest(files[0]) != digest(files[2])


def test_half_precision_halves_the_file_and_hardly_changes_values(value: Value, trot: Any, tmp_path: Path) -> None:
    whole, half = value.save(tmp_path / "whole"), value.save(tmp_path / "half", "half")
    states = states_of(trot)
    np.testing.assert_allclose(load_value(half)(states, 60, trot.nodes), value(states, 60, trot.nodes), rtol=2e-3)
    assert half.stat().st_size < 0.6 * whole.stat().st_size


def test_value_loads_without_jax(value: Value, tmp_path: Path) -> None:
    path = value.save(tmp_path / "some")
    code = (
        "import sys; sys.modules['jax'] = sys.modules['flax'] = None\n"
        f"from piaffe.sampling.value import load_value; print(load_value({str(path)!r}).network.hidden)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "(64, 32)"


@pytest.mark.parametrize(
    ("changed", "entry"),
    [
        ({"reward": Reward(0.6)}, "'reward.scale' 0.6, expected 0.5"),
        ({"options": Options(discount=0.95)}, "'discount' 0.95, expected 0.9"),
        ({"options": Options(p_max={"HAA range": 0.5})}, "'p_max'"),
        ({"weight": 1.5}, r"'objective.track base.linear_velocity.weights.stand' \[1.5, 1.5, 1.5\]"),
        ({"limit": 0.25}, "'constraints.HAA range."),
        ({"fastest": 21.0}, "'constraints.joint speed.values'"),
        ({"place": 10.0}, "'objective.track base.position', expected null|'objective.track base.position' {"),
        ({"speed": 0.4}, "'motion.commands'"),
        ({"terrain": models.terrain.incline(0.175)}, "'terrain."),
        ({"payload": models.payload(0.5)}, "'payload"),
        ({"action": models.joint_targets(kp=5.0)}, r"'action.kp'"),
    ],
)
def test_value_of_something_else_is_refused_by_the_entry_that_differs(
    changed: dict[str, Any], entry: str, value: Value, tmp_path: Path
) -> None:
    other = controller(**changed)
    with pytest.raises(SamplingError, match=entry):
        load_value(value.save(tmp_path / "some"), other)


def test_entries_may_be_allowed_to_differ(value: Value) -> None:
    other = controller(terrain=models.terrain.incline(0.175), payload=models.payload(0.5))
    value.check(other.nodes, other.reward, other.options, allow=("terrain", "payload"))
    with pytest.raises(SamplingError, match="'payload"):
        value.check(other.nodes, other.reward, other.options, allow=("terrain",))
    value.check(other.nodes, other.reward, other.options, allow="terrain, payload")
    with pytest.raises(SamplingError, match=r"'terrain.*pass allow=\('terrain',\) \(--allow \"terrain\"\)"):
        value.check(other.nodes, other.reward, other.options, allow=("payload",))
    with pytest.raises(UnknownNameError, match="value, allow: no entry 'terr'"):
        value.check(other.nodes, other.reward, other.options, allow=("terr", "payload"))


def test_a_value_prints_as_one_line(value: Value) -> None:
    assert repr(value).startswith("Value(of 'solo12', γ₀ = 0.9, inputs = [")
    assert "\n" not in repr(value)


def test_a_path_that_holds_no_value_says_so(tmp_path: Path) -> None:
    for path, why in ((tmp_path / "none.value", "No such file"), (tmp_path, "Is a directory")):
        with pytest.raises(FileFormatError, match=f"cannot be read - got {why}.*, expected the path of a value"):
            load_value(path)


def test_horizon_samples_and_place_of_the_start_do_not_matter(value: Value) -> None:
    other = controller(horizon=16, options=Options(samples=64, temperature=0.05, seed=3))
    value.check(other.nodes, other.reward, other.options)
    moved = controller()
    start = moved.nodes.problem.initial + np.r_[3.0, 1.0, np.zeros(35)]
    moved.nodes = Nodes(moved.nodes.problem.with_initial(start))
    value.check(moved.nodes, moved.reward, moved.options)


def test_other_robot_is_refused(value: Value) -> None:
    robot = models.load("solo12", foot_radius=0.02)
    other = controller(plant=models.Mujoco(robot, armature=0.01))
    with pytest.raises(SamplingError, match=r"'robot.foot_radius' 0.02, expected 0.0165"):
        value.check(other.nodes, other.reward, other.options)


_PRINT = """
import hashlib, json, sys
sys.path.insert(0, {folder!r})
from value_problem import trot_problem
from piaffe.ocp import Nodes
from piaffe.sampling import Options, Reward
from piaffe.sampling.value import ValueInputs, fingerprint
print(json.dumps(fingerprint(Nodes(trot_problem()), Reward(0.5), Options(), ValueInputs())))
"""


def test_fingerprint_is_the_same_in_another_process(value: Value) -> None:
    code = _PRINT.format(folder=str(Path(__file__).parent))
    environment = {**os.environ, "PYTHONHASHSEED": "12345"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert json.loads(done.stdout) == value.made_for


def test_functions_are_told_apart_by_what_they_say_not_by_how(trot: Any) -> None:
    def entries(function: Any, **options: Any) -> Any:
        problem = trot.nodes.problem
        term = ocp.inequality(function, name="speed", **options)
        own = ocp.Problem(
            problem.motion, problem.schedule, problem.objective, ocp.Constraints(term), initial=problem.initial
        )
        return fingerprint(Nodes(own), trot.reward, trot.options, ValueInputs())["constraints"]["speed"]

    first = entries(lambda s: (s.joints.velocity - 1.0) ** 2)
    assert differences(first, entries(lambda s: 1.0 - 2.0 * s.joints.velocity + s.joints.velocity**2)) == []
    assert [path for path, _, _ in differences(first, entries(lambda s: s.joints.velocity**2))] == ["values"]
    assert differences(first, entries(lambda s: (s.joints.velocity - 1.0) ** 2, upper=4.0, lower=0.0)) != []
    size = ocp.parameter("size", 1.0)
    assert differences(first, entries(lambda s: (s.joints.velocity - size) ** 2)) == []


def test_bounds_over_a_phase_are_compared_by_their_values(trot: Any) -> None:
    def made(function: Any) -> Any:
        problem = trot.nodes.problem
        limits = ocp.Constraints(models.joint_range("HAA", upper=ocp.over_phase(function)))
        own = ocp.Problem(problem.motion, problem.schedule, problem.objective, limits, initial=problem.initial)
        entries = fingerprint(Nodes(own), trot.reward, trot.options, ValueInputs())
        return json.loads(json.dumps(entries))["constraints"]["HAA range"]

    first = made(lambda at: 0.3 + 0.1 * at.share)
    names = {phase.name for phase in trot.nodes.problem.motion.pieces[0].phases}
    assert {name: entry[0] for name, entry in first["upper"].items()} == {name: [0.3] * 4 for name in names}
    assert differences(first, made(lambda at: 0.1 * at.t / at.duration + 0.3)) == []
    assert differences(first, made(lambda at: 0.3 + 0.1 * at.share**2)) != []


@pytest.mark.parametrize(
    ("declared", "names"),
    [
        ({"weight": 2.0}, ["track base.linear_velocity.weight"]),
        ({"fastest": 15.0}, ["joint speed.limit"]),
        ({"limit": 0.3}, ["HAA range.lower", "HAA range.upper"]),
    ],
)
def test_parameters_count_as_if_they_were_declared(declared: Any, names: list[str], trot: Any) -> None:
    other = trot_problem(**declared)
    values = {name: ocp.compile_problem(other).parameters[name] for name in names}
    changed, expected, before = (
        fingerprint(Nodes(problem), trot.reward, trot.options, ValueInputs())
        for problem in (trot_problem().with_parameters(values), other, trot_problem())
    )
    assert differences(changed, expected) == []
    assert differences(changed, before) != []


def test_differences_name_the_leaf() -> None:
    kept = {"a": {"b": [1.0, 2.0], "c": "x"}, "d": 1.0}
    assert differences(kept, {"a": {"b": [1.0, 2.0 + 1e-9], "c": "x"}, "d": 1.0}) == []
    assert differences(kept, {"a": {"b": [1.0, 2.1], "c": "x"}}) == [("a.b", [1.0, 2.0], [1.0, 2.1]), ("d", 1.0, None)]


def test_plain_value_of_something_without_numbers_is_refused() -> None:
    assert plain({"a": np.array([1.0, np.inf]), "b": (True, None)}) == {"a": [1.0, "inf"], "b": [True, None]}
    with pytest.raises(SamplingError, match="has no numbers to compare - got <object"):
        plain(object())


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    text = tmp_path / "text.value"
    text.write_text("hello")
    with pytest.raises(FileFormatError, match="cannot be read"):
        load_value(text)
    other = tmp_path / "other.value"
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("manifest.json", json.dumps({"format": "piaffe-value", "version": 99}))
    with pytest.raises(FileFormatError, match="version 99, expected 'piaffe-value' up to version 1"):
        load_value(other)
