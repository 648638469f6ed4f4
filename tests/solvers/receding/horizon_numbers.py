"""Numbers of a horizon at random times, compared with those of the compiler."""

from __future__ import annotations

from math import ceil

import numpy as np

from piaffe import ocp
from piaffe.errors import ProblemError
from piaffe.ocp import CompiledProblem, Horizon

from .found import Found
from .schedules import Rng

COMPILED = ("times", "p", "p_end", "weight", "g_mask", "h_mask", "end_weight", "end_g_mask", "end_h_mask",
            "p_transition", "guess_states", "guess_controls")  # fmt: skip
PLAIN = ("name", "label", "dt", "ends_phase", "resets", "lands", "mode", "transition")


def compare_numbers(horizon: Horizon, rng: Rng, found: Found, cycles: int) -> None:
    """Compare the horizon at random times with the compiler, where the declared path is that of the horizon."""
    calendar, problem = horizon.calendar, horizon.problem
    ahead = sum(w if w is not None else 0 for w in horizon.layout.windows)
    for _ in range(2):
        total = min(calendar.total, cycles * sum(entry.length for entry in calendar.entries)) - ahead
        count = int(total // calendar.steps[0])
        if count < 0:
            return
        t = int(rng.integers(count + 1)) * horizon.dt
        place = calendar.at(horizon.tick_of(t))
        piece = calendar.entries[place.entry].placed.piece
        if horizon.courses.pieces[piece].functions is not None and t > 0:
            continue  # functions go on from the measured state
        x, first = _on_path(horizon, t), ceil(calendar.firsts[piece][1] / calendar.steps[0]) * horizon.dt
        course = horizon.advance(horizon.begin(_on_path(horizon, first), first), x, t)  # frames of later cycles differ
        got = horizon.at(course, horizon.local(course, x))
        try:
            expected = ocp.compile_problem(problem, t, checks=False)
        except ProblemError as error:
            if "applies nowhere" not in str(error):  # a term may, in this part of the motion
                raise
            continue
        found.numbers = max(found.numbers, _difference(got, expected.with_start(x), functions=_has_functions(horizon)))
        found.compiled += 1


def _has_functions(horizon: Horizon) -> bool:
    return any(piece.functions is not None for piece in horizon.courses.pieces)


def _on_path(horizon: Horizon, t: float) -> np.ndarray:
    path, model = horizon._compilation.path, horizon.models[0]
    sample = path.sample(t, path.interval_at(t))
    start = horizon._compilation.start
    blocks = {b.quantity: sample.get(b.quantity, start.get(b.quantity)) for b in model.state.blocks}
    return model.state.np_normalise(model.state.pack(blocks))


def _difference(got: CompiledProblem, expected: CompiledProblem, functions: bool) -> float:
    most = 0.0
    assert len(got.phases) == len(expected.phases)
    for own, other in zip(got.phases, expected.phases, strict=True):
        assert [getattr(own, name) for name in PLAIN] == [getattr(other, name) for name in PLAIN]
        for name in COMPILED:
            a, b = getattr(own, name), getattr(other, name)
            assert a.shape == b.shape, name
            if name == "guess_controls" and functions:
                continue  # a guess of forces looks along the declared path
            difference = float(np.abs(_one_sign(a, own, name) - _one_sign(b, own, name)).max(initial=0.0))
            if name == "guess_controls":  # a least-squares solution
                assert difference < 1e-6 * (1 + np.abs(b).max(initial=0.0)), (own.name, name, difference)
                continue
            difference /= max(1.0, float(np.abs(b).max(initial=0.0)))  # random keyframes ask for 100 m/s
            assert difference < 1e-9, (own.name, name, difference)
            most = max(most, difference)
    return most


def _one_sign(values: np.ndarray, phase: ocp.CompiledPhase, name: str) -> np.ndarray:
    """Return numbers in which quaternions, whose sign means nothing, have their largest entry positive."""
    parts: list[slice] = []
    if name == "guess_states":
        space = phase.mode.state
        parts = [part for quantity, part in space.slices.items() if quantity.kind == "rotation"]
    elif name in ("p", "p_end", "p_transition"):
        layout = phase.mode.layout if name != "p_transition" else phase.transition.layout if phase.transition else None
        parts = [] if layout is None else [p for key, p in layout.slices.items() if key.kind == "target"]
        parts = [part for part in parts if part.stop - part.start == 4]
    out = np.array(np.atleast_2d(values), dtype=float)
    for part in parts:
        own = out[:, part]
        largest = np.take_along_axis(own, np.abs(own).argmax(axis=1)[:, None], axis=1)
        own *= np.where(largest < 0, -1.0, 1.0)
    return out
