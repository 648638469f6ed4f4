"""The initial guess of the controls: of the path, else of the model, else zero."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from piaffe import ocp
from piaffe.errors import ModelError, ProblemError
from tests.problems import Rope, rope

Guess = Callable[[Sequence[ocp.Node], np.ndarray, Mapping[str, np.ndarray]], dict[Any, Any]]
FORCE = ocp.Quantity("force", "N")
PHASES = (ocp.Phase("throw", "slack", 0.06, {"place": (0.3, 0.0)}), ocp.Phase("swing", "taut", 0.04))


def controls(guess: Guess, *phases: ocp.Phase, **parameters: float) -> list[np.ndarray]:
    """Return the controls of every phase, for a model with this guess."""

    class Guessing(Rope):
        def control_guess(
            self, nodes: Sequence[ocp.Node], states: np.ndarray, p: Mapping[str, np.ndarray]
        ) -> dict[ocp.Quantity, np.ndarray]:
            return guess(nodes, states, p)

    named = {f"rope.{name}": value for name, value in parameters.items()}
    problem = ocp.Problem(
        ocp.Motion(*(phases or PHASES)), Guessing().until_end(dt=0.02), rope().objective,
        initial=[0.2, 0.1, 1.2, 0.0], parameters=named,
    )  # fmt: skip
    return [phase.guess_controls for phase in ocp.compile_problem(problem).phases]


def test_a_model_guesses_the_stages_of_a_phase_in_one_call() -> None:
    calls = []

    def guess(nodes, states, p):  # type: ignore[no-untyped-def]
        calls.append((nodes, states.copy(), dict(p)))
        return {FORCE: np.column_stack([[node.time for node in nodes], p["mass"]])}

    first, second = controls(guess, mass=3.0)
    np.testing.assert_allclose(first, [[0.0, 3.0], [0.02, 3.0], [0.04, 3.0]])
    np.testing.assert_allclose(second, [[0.06, 3.0], [0.08, 3.0]])
    (nodes, states, p), (later, _, p_later) = calls
    assert [node.mode for node in (*nodes, *later)] == ["slack"] * 3 + ["taut"] * 2
    assert states.shape == (4, 4)
    assert states[0].tolist() == [0.2, 0.1, 1.2, 0.0]  # the problem's initial state, not the path's velocity
    np.testing.assert_allclose(states[:, 0], [0.2, 0.2 + 0.1 / 3, 0.3 - 0.1 / 3, 0.3])
    assert {name: value.tolist() for name, value in p.items()} == {
        "taut": [[0.0]] * 3, "tightens": [[0.0]] * 3, "mass": [[3.0]] * 3, "dt": [[0.02]] * 3
    }  # fmt: skip
    assert p_later["taut"].tolist() == [[1.0], [1.0]]


def test_controls_that_a_model_leaves_out_are_zero() -> None:
    assert not np.any(np.concatenate(controls(lambda nodes, states, p: {})))


def test_controls_of_the_path_replace_the_guess() -> None:
    pulled = ocp.Phase("throw", "slack", 0.06, {"force": (0.0, 6.0)})
    first, second = controls(lambda nodes, states, p: {FORCE: np.ones((len(nodes), 2))}, pulled, PHASES[1])
    np.testing.assert_allclose(first, [[0, 0], [0, 2], [0, 4]], atol=1e-12)
    np.testing.assert_allclose(second, [[0, 6], [0, 6]], atol=1e-12)


def test_a_path_with_some_controls_leaves_the_others_to_the_guess() -> None:
    twist = ocp.Quantity("twist", "Nm")

    class Two(Rope):
        def __init__(self) -> None:
            super().__init__()
            both = ocp.Manifold((*self.control.blocks, ocp.Block(twist, ("y",))))
            object.__setattr__(self, "control", both)  # models are frozen

        def dynamics(self, key, x, u, z, p):  # type: ignore[no-untyped-def]
            made = super().dynamics(key, x, u[:2], z, p)
            both = made.quantities.extended(ocp.Bound(twist, u[2], ("y",)))
            return replace(made, quantities=both)

        def control_guess(self, nodes, states, p):  # type: ignore[no-untyped-def]
            return {FORCE: np.ones((len(nodes), 2)), twist: np.full((len(nodes), 1), 7.0)}

    pulled = ocp.Phase("throw", "slack", 0.06, {"force": (0.0, 6.0)})
    objective = rope().objective + ocp.Objective(ocp.regularize("twist"))
    problem = ocp.Problem(ocp.Motion(pulled), Two().until_end(dt=0.02), objective, initial=[0.2, 0.1, 1.2, 0.0])
    (phase,) = ocp.compile_problem(problem).phases
    np.testing.assert_allclose(phase.guess_controls, [[0, 0, 7], [0, 2, 7], [0, 4, 7]], atol=1e-12)


def test_a_path_with_all_controls_needs_no_guess() -> None:
    def guess(nodes, states, p):  # type: ignore[no-untyped-def]
        raise AssertionError("called")

    controls(guess, ocp.Phase("throw", "slack", 0.06, {"force": (0.0, 6.0)}))


def test_guesses_that_do_not_fit_the_control() -> None:
    with pytest.raises(
        ModelError, match=r"model 'rope', control_guess, 'force': wrong shape - got \(2,\), expected \(3, 2\); return"
    ):
        controls(lambda nodes, states, p: {FORCE: np.zeros(2)})
    with pytest.raises(ModelError, match=r"control_guess: contains what is no control - got 'speed', expected .*force"):
        controls(lambda nodes, states, p: {ocp.Quantity("speed", "m/s"): np.zeros((3, 2))})
    with pytest.raises(ProblemError, match="initial guess of the controls"):
        controls(lambda nodes, states, p: {FORCE: np.full((len(nodes), 2), np.nan)})
