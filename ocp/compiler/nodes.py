"""Numbers of the nodes along a motion, for sampling controllers, which use some of them at every step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError
from piaffe.interrupts import interruptible

from ..language import At, ParameterKey, PlacedPhase, Problem, Sample, model_of
from .compile import RUNNING, Compilation, nowhere
from .lowering import LEFT_OUT
from .mode import LoweredMode
from .timeline import HorizonPhase

Array = NDArray[np.float64]

_ENDING = frozenset[At]({"running", "end"})
_KEPT = 500  # number of nodes before the last requested ones whose numbers are kept


@dataclass(frozen=True)
class NodeNumbers:
    """Numbers of S consecutive nodes.

    Args:
        p: parameters (S, np).
        weight: residual weights times their masks (S, nr).
        g_mask: 0 or 1 per inequality row (S, ng).
        h_mask: the same for equalities (S, nh).
    """

    p: Array
    weight: Array
    g_mask: Array
    h_mask: Array


class Nodes:
    """The nodes of a problem with one model that has one phase for all modes; their numbers are computed on use.

    Numbers of the last horizons are kept, so that memory does not grow with the motion.

    Node k is at time ``k dt`` since the motion's start. Node 0 has the problem's initial state.

    Args:
        problem: the declaration.

    Raises:
        ProblemError: the schedule has several models, or a model with a phase per mode, or a term needs a quantity that
            the model cannot supply, or applies at phases' ends.
    """

    @interruptible()
    def __init__(self, problem: Problem) -> None:
        segment = problem.schedule.segments[0]
        if len(problem.schedule.segments) > 1 or model_of(segment).cut_by_modes:
            names = " + ".join(s.model.name for s in problem.schedule.segments)
            raise ProblemError(
                f"problem ({problem.source}): its schedule cannot be sampled - got {names}, expected one model that "
                "has one phase for all modes; schedule only models.Mujoco(robot).over(duration, dt)"
            )
        self.problem, self.model, self.dt = problem, model_of(segment), segment.dt
        self._compilation = Compilation(problem)
        self._path = self._compilation.path
        self.terms = self._compilation.terms
        first = self._path.interval_at(0.0)
        self._horizon_phase = HorizonPhase(segment, first, 0.0, 1, False, None)
        self.mode: LoweredMode = self._compilation.mode(self._horizon_phase)
        for k, why in self.mode.unbound.items():
            if why != LEFT_OUT:
                raise nowhere(self.terms[k], [why])
        self._check_phase_ends(segment.excluded)
        self._weights = self._compilation.weights(self.mode)
        self._rows: dict[int, tuple[Array, Array, Array, Array]] = {}
        self._samples: dict[int, Sample] = {}
        self._fill(0, 1)  # so that errors in weights and bounds are raised here

    @property
    def duration(self) -> float:
        """Length of the motion [s]; infinite if cyclic."""
        return self.problem.motion.duration

    def running(self, first: int, count: int) -> NodeNumbers:
        """Return the numbers of ``count`` nodes as stages, from node ``first``; the last node repeats at the end."""
        self._fill(first, count)
        rows = [self._rows[k] for k in range(first, first + count)]
        p, weight, g_mask, h_mask = (np.array(part) for part in zip(*rows, strict=True))
        return NodeNumbers(p, weight, g_mask, h_mask)

    def end(self, k: int) -> NodeNumbers:
        """Return the numbers of node k as the last of the horizon, with terms ``at="end"``; S = 1."""
        p = self._of_node(k, _ENDING)[None]
        weight, g_mask, h_mask = self._weights[1](p)
        return NodeNumbers(p, weight, g_mask, h_mask)

    def sample(self, k: int) -> Sample:
        """Return the motion's targets at node k."""
        self._fill(k, 1)
        return self._samples[k]

    def interval(self, k: int) -> PlacedPhase:
        """Return the phase at node k; the later one on a boundary, the last one beyond the motion's end."""
        return self._path.interval_at(self._time(k))

    @property
    def replaced(self) -> Mapping[ParameterKey, Array]:
        """The parameters whose values replace declared ones."""
        return {key: value for key, (_, value) in self._compilation.numbers.replaced.items()}

    def weights(self, k: int, phase: str, labels: tuple[str, ...]) -> Array:
        """Return the weights of cost k in a phase of this name, one per row."""
        return self._compilation.numbers.weights(k, phase, labels)

    # ---- filling

    def _fill(self, first: int, count: int) -> None:
        """Compute the numbers of ``count`` nodes from node ``first`` on, as far as missing; forget distant ones."""
        missing = [k for k in range(first, first + count) if k not in self._rows]
        if not missing:
            return
        for k in missing:
            self._samples[k] = self._sample(k)
        p = np.array([self._of_node(k, RUNNING) for k in missing])
        self._rows |= dict(zip(missing, zip(p, *self._weights[0](p), strict=True), strict=True))
        if len(self._rows) > 2 * _KEPT + count:
            near = range(first - _KEPT, first + count)
            self._rows = {k: row for k, row in self._rows.items() if k in near}
            self._samples = {k: sample for k, sample in self._samples.items() if k in near}

    def _sample(self, k: int) -> Sample:
        t = self._time(k)
        return self._path.sample(t, self._path.interval_at(t))

    def _time(self, k: int) -> float:
        return min(k * self.dt, self.duration)

    def _of_node(self, k: int, here: frozenset[At]) -> Array:
        t = self._time(k)
        interval = self._path.interval_at(t)
        sample = self._samples[k] if k in self._samples else self._path.sample(t, interval)
        node = self._compilation.node(self._horizon_phase, t, interval, sample, is_end=False)
        row: Array = self._compilation.numbers.of_nodes(self.mode, self.dt, [node], interval.phase, here)[0]
        return row

    def _check_phase_ends(self, excluded: tuple[object, ...]) -> None:
        for k in self.mode.bound:
            term = self._compilation.terms[k]
            if term.at == "phase_end" and term not in excluded:
                raise ProblemError(
                    f"term '{term.name}' ({term.source}): applies nowhere along a sampled motion - got "
                    "at='phase_end', expected 'running' or 'end'; leave it out with .without(term)"
                )
