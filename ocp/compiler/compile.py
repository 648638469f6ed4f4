"""The compiler: from a declaration to flat phases of numbers and functions.

Generated functions depend only on the structure of the declaration: its models, modes and terms. All numbers, times and
contact sets are parameters, so declarations of equal structure share the generated functions.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError, ProblemError, UnknownNameError
from piaffe.interrupts import check_interrupt, interruptible

from ..language import (
    SCHEDULED,
    At,
    Constraint,
    Cost,
    ModelBase,
    Node,
    ParameterKey,
    Path,
    Phase,
    PlacedPhase,
    Problem,
    ResetMap,
    Sample,
    Segment,
    find_key,
    model_of,
    parameter_names,
)
from .added import with_added
from .checks import check_columns, check_last, check_models, check_names, check_targets
from .compiled import CompiledProblem
from .compiled_phase import CompiledPhase
from .finite import check_numbers
from .guess import guess_controls, guess_states
from .guess_checks import check_guess
from .lowering import LEFT_OUT, lower_mode
from .mode import LoweredMode
from .numbers import Numbers
from .stages import stages_of
from .timeline import HorizonPhase, check_phase_ends, covers, horizon_phases
from .transition import LoweredTransition, lower_transition
from .vectorised import Vectorised

Array = NDArray[np.float64]
Term = Cost | Constraint

RUNNING = frozenset[At]({"running"})
"""The values of ``at`` of terms that apply at a stage."""
RESETTING = frozenset[At]({"running", "phase_end"})
"""The values of ``at`` of terms that apply at the model's own reset."""
NOWHERE = frozenset[At]()
_MODES_KEPT = 500
_LINE = re.compile(r"\w:\d+\)")  # of a declaration, in a message


@dataclass(frozen=True)
class _Structure:
    """Everything that the functions of a mode depend on; equal structures share them, also if ``terms`` differ."""

    model: ModelBase
    key: str
    shape: tuple[Hashable, ...]
    excluded: frozenset[int]
    terms: tuple[Term, ...] = field(compare=False)


@lru_cache(maxsize=32)
def _lower(structure: _Structure) -> LoweredMode:
    check_interrupt()
    return lower_mode(structure.model, structure.key, structure.terms, structure.excluded)


@dataclass(frozen=True)
class _Transition:
    """Everything that the functions of a transition depend on; equal ones share them."""

    source: ModelBase
    key: str
    target: ModelBase
    user: ResetMap | None
    at_reset: tuple[tuple[int, Hashable], ...]
    where: str = field(compare=False)
    terms: tuple[Term, ...] = field(compare=False)


@lru_cache(maxsize=64)
def _lower_transition(of: _Transition) -> LoweredTransition:
    indices = tuple(k for k, _ in of.at_reset)
    return lower_transition(of.source, of.key, of.target, of.user, of.where, of.terms, indices)


@interruptible()
def compile_problem(
    problem: Problem,
    t0: float = 0.0,
    *,
    checks: bool = True,
    progress: Callable[[int, int, str], None] | None = None,
) -> CompiledProblem:
    """Compile a problem into flat phases.

    Args:
        problem: the declaration.
        t0: start of the horizon in the motion's time [s], rounded to a multiple of the first model's dt.
        checks: whether to evaluate all functions at the initial guess, and to raise for NaN and for controls without
            cost.
        progress: called before each phase with the number of compiled phases, of all phases, and the phase's name.

    Raises:
        ProblemError: the declaration is inconsistent; the message names the place in the user's file.
    """
    began = time.perf_counter()
    misses = _lower.cache_info().misses + _lower_transition.cache_info().misses
    compilation = Compilation(problem)
    spans = horizon_phases(compilation.path, problem.schedule, t0)
    made = []
    for i, span in enumerate(spans):
        if progress is not None:
            progress(i, len(spans), span.interval.phase.name)
        made.append(compilation.phase(i, spans))
    phases = tuple(made)
    compilation.check_bound(phases, complete=covers(problem.motion, spans))
    built = _lower.cache_info().misses + _lower_transition.cache_info().misses - misses
    compiled = CompiledProblem(
        phases=phases,
        initial=problem.initial,
        terms=compilation.terms,
        scopes=compilation.scopes,
        path=compilation.path,
        unbound=compilation.unbound,
        changing=frozenset(compilation.numbers.changing),
        lowered=built,
        compile_s=time.perf_counter() - began,
        source=problem.source,
    )
    check_numbers(compiled)
    if checks:
        check_guess(compiled)
    return compiled


def _placed(problem: Problem, models: tuple[ModelBase, ...], start: Sample) -> Path:
    """Return a problem's path; an error of its references names the motion's line if it names none."""
    try:
        return problem.motion.bind(models, start)
    except ProblemError as error:
        if type(error) is not ProblemError or _LINE.search(str(error)):
            raise
        raise ProblemError(f"motion ({problem.motion.source}): {error}") from error


class Compilation:
    """One run of the compiler over a problem: its path, its terms and their numbers."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        models = list(dict.fromkeys(model_of(segment) for segment in problem.schedule.segments))
        self.head = models[0]
        self.start: Sample = self.head.state.unpack(problem.initial)
        check_targets(problem.motion, models)
        check_last(problem.motion)
        check_models(problem.schedule)
        self.path: Path = with_added(_placed(problem, tuple(models), self.start), models, problem.where)
        self.models = models
        scoped = problem.scoped_terms()
        self.terms = tuple(term for term, _ in scoped)
        self.scopes = tuple(scope for _, scope in scoped)
        check_columns(problem.motion, models, self.terms)
        self.unbound: dict[tuple[str, int], str] = {}
        self.names: dict[str, ParameterKey] = parameter_names(self.terms, models) if problem.parameters else {}
        replaced = {
            find_key(self.names, name, problem.where): (name, value) for name, value in problem.parameters.items()
        }
        self.numbers = Numbers(self.terms, self.scopes, replaced, problem.where)
        self._lowered: dict[tuple[Segment, str], LoweredMode] = {}
        self._weights: dict[LoweredMode, tuple[Vectorised, Vectorised]] = {}
        self._reset_weights: dict[LoweredTransition, Vectorised] = {}
        self._modes: dict[tuple[ModelBase, int, int], tuple[Hashable, Hashable | None]] = {}
        check_names(problem, self.terms)

    # ---- one phase

    def phase(self, i: int, spans: list[HorizonPhase]) -> CompiledPhase:
        """Return the i-th flat phase."""
        check_interrupt()
        span = spans[i]
        segment, model = span.segment, span.model
        follower = spans[i + 1] if i + 1 < len(spans) else None
        mode_now, mode = self.resolve(model, span.interval.phase), self.mode(span)
        n = span.num_stages
        times: Array = span.start + segment.dt * np.arange(n + 1.0)
        placed = self.path.intervals(span.end)
        check_phase_ends(span, placed)
        stages = stages_of(span, times, placed, self.path)
        inside, samples = stages.intervals, stages.samples
        ending: set[At] = {"running"}
        if span.ends_phase:
            ending.add("phase_end")
        if follower is None:
            ending.add("end")
        nodes = [
            self.node(span, t, interval, sample, is_end=k == n, tracked=tracked, acts=acts)
            for k, (t, interval, sample, tracked, acts) in enumerate(
                zip(times, inside, stages.acting, stages.tracked, stages.acts, strict=True)
            )
        ]
        p, applies = np.empty((n + 1, mode.layout.size)), np.empty((n + 1, len(self.terms)), dtype=bool)
        for interval, run in groupby(range(n), key=lambda k: inside[k]):
            first, *rest = run
            part = slice(first, first + 1 + len(rest))
            p[part] = self.numbers.of_nodes(mode, segment.dt, nodes[part], interval.phase, RUNNING)
            applies[part] = self.numbers.counts(mode, interval.phase, RUNNING)
        p[n:] = self.numbers.of_nodes(mode, segment.dt, nodes[n:], inside[n].phase, frozenset(ending))
        applies[n] = self.numbers.counts(mode, inside[n].phase, frozenset(ending))
        stage_w, terminal_w = self.weights(mode)
        stage, end = stage_w(p[:-1]), terminal_w(p[-1:])
        transition, p_transition, resets, lands = self.transition(
            span, follower, mode, samples[-1], self.path.interval_before(span.end)
        )
        at_end = list(end)
        if transition is not None:
            here = RESETTING if lands else NOWHERE
            applies[n] |= self.numbers.counts(transition, inside[n].phase, here)
            rows = self.reset_weights(transition)(p_transition[None])
            at_end = [np.concatenate(both, axis=1) for both in zip(end, rows, strict=True)]
        states = guess_states(model, samples, self.start)
        if i == 0:
            states[0] = self.problem.initial
        acting = guess_states(model, stages.acting, self.start) if model.acting else states
        controls = guess_controls(model, nodes[:-1], acting, mode.layout, p[:-1])
        return CompiledPhase(
            name=span.interval.phase.name,
            label=str(mode_now) if model.cut_by_modes else SCHEDULED,
            interval=span.interval, mode=mode, dt=segment.dt, times=times, p=p[:-1], p_end=p[-1], applies=applies,
            weight=stage[0], g_mask=stage[1], h_mask=stage[2],
            end_weight=at_end[0][0], end_g_mask=at_end[1][0], end_h_mask=at_end[2][0],
            ends_phase=span.ends_phase, transition=transition, p_transition=p_transition, resets=resets, lands=lands,
            guess_states=states, guess_controls=controls,
        )  # fmt: skip

    def mode(self, span: HorizonPhase) -> LoweredMode:
        """Return the lowered mode of a part of the horizon."""
        segment, model = span.segment, span.model
        key = model.mode_key(self.resolve(model, span.interval.phase))
        if (segment, key) not in self._lowered:
            excluded = frozenset(k for k, term in enumerate(self.terms) if term in segment.excluded)
            lowered = _lower(_Structure(model, key, self._shape, excluded, self.terms))
            self.unbound.update({(model.name, k): why for k, why in lowered.unbound.items()})
            self._lowered[segment, key] = lowered
        return self._lowered[segment, key]

    @cached_property
    def _shape(self) -> tuple[Hashable, ...]:
        return tuple(term.structure() for term in self.terms)

    def weights(self, mode: LoweredMode) -> tuple[Vectorised, Vectorised]:
        """Return the functions of weights and masks: that of a mode's stages, and that of its last nodes."""
        if mode not in self._weights:
            self._weights[mode] = Vectorised(mode.functions["stage_w"]), Vectorised(mode.functions["terminal_w"])
        return self._weights[mode]

    def reset_weights(self, transition: LoweredTransition) -> Vectorised:
        """Return the function of the weights and masks of a transition's rows."""
        if transition not in self._reset_weights:
            self._reset_weights[transition] = Vectorised(transition.functions["rows_w"])
        return self._reset_weights[transition]

    def resolve(self, model: ModelBase, phase: Phase) -> Hashable:
        """Return a phase's mode in the model's own form; errors name the phase."""
        try:
            return model.resolve(phase.mode)
        except (ModelError, ProblemError) as error:
            raise ProblemError(f"phase '{phase.name}' ({phase.source}): {error}") from error

    def neighbour(self, model: ModelBase, interval: PlacedPhase | None) -> Hashable | None:
        """Return the mode of a phase before or after, in the model's own form; None if the model has no such mode."""
        try:
            return None if interval is None else model.resolve(interval.phase.mode)
        except (ModelError, ProblemError):
            return None

    def node(
        self, span: HorizonPhase, t: float, interval: PlacedPhase, sample: Sample, *, is_end: bool,
        tracked: Sample | None = None, acts: float | None = None,
    ) -> Node:  # fmt: skip
        """Return the node for which a model returns the values of its slots; ``acts`` is the time that counts for it.

        That is the middle of a stage during which quantities act, and else the node's time. Times within a phase are
        rounded to 1e-9 s, so that they are the same in every cycle.
        """
        model = span.model
        key = (model, interval.piece, interval.index)
        if key not in self._modes:
            if len(self._modes) > _MODES_KEPT:  # a controller plans along an endless motion
                self._modes.clear()
            earlier = self.path.interval_before(interval.start) if interval.start > 0 else None
            self._modes[key] = self.resolve(model, interval.phase), self.neighbour(model, earlier)
        now, before = self._modes[key]
        after = self.neighbour(model, span.following) if is_end else None
        steps = round((t - interval.start) / span.segment.dt)
        since = round(float(t if acts is None else acts) - interval.start, 9)
        phase_time = min(max(since, 0.0), interval.phase.duration)
        return Node(t, now, after, sample, before, steps, span.segment.dt, tracked, phase_time)

    def plain_node(self, model: ModelBase, interval: PlacedPhase, sample: Sample) -> Node:
        """Return a node at the start of a phase, for slots that depend on the sample alone."""
        return Node(interval.start, self.resolve(model, interval.phase), None, sample)

    # ---- between phases

    def transition(
        self, span: HorizonPhase, follower: HorizonPhase | None, mode: LoweredMode, sample: Sample, ending: PlacedPhase
    ) -> tuple[LoweredTransition | None, Array, bool, bool]:
        """Return the transition to the next phase, its parameters, whether it changes the state, and by an impact.

        Args:
            span: the part of the horizon before it.
            follower: the part after it; None at the horizon's end.
            mode: the mode before it.
            sample: the targets at its time.
            ending: the motion phase that ends at its time, or contains it.
        """
        if follower is None:
            return None, np.zeros(0), False, False
        model = span.model
        phase = ending.phase
        user = phase.reset if span.ends_phase else None
        where = f"phases '{phase.name}' → '{follower.interval.phase.name}' ({phase.source})"
        at_reset = tuple((k, self._shape[k]) for k in mode.at_reset)
        lowered = _lower_transition(_Transition(model, mode.key, follower.model, user, at_reset, where, self.terms))
        self.unbound.update({(model.name, k): why for k, why in lowered.unbound.items()})
        node = self.node(span, span.end, ending, sample, is_end=True)
        lands = model.lands(node)
        p = self.numbers.of_nodes(lowered, span.segment.dt, [node], phase, RESETTING if lands else NOWHERE)[0]
        return lowered, p, user is not None or model is not follower.model or lands, lands

    # ---- terms and parameters that apply nowhere

    def check_bound(self, phases: tuple[CompiledPhase, ...], *, complete: bool) -> None:
        """Raise for terms and parameters that apply nowhere.

        Args:
            phases: the horizon.
            complete: whether the horizon covers the whole motion; if not, a term may apply in another part of it.
        """
        modes = dict.fromkeys(phase.mode for phase in phases)
        transitions = dict.fromkeys(phase.transition for phase in phases if phase.transition is not None)
        for k, term in enumerate(self.terms):
            whys = [mode.unbound[k] for mode in modes if k in mode.unbound]
            whys = list(dict.fromkeys([each.unbound[k] for each in transitions if k in each.unbound] or whys))
            binds = any(k in mode.bound or k in mode.at_reset for mode in modes)
            if k in self.numbers.applied or LEFT_OUT in whys or (binds and not complete):
                continue
            if binds:
                names = ", ".join(dict.fromkeys(f"'{phase.name}'" for phase in phases))
                whys.append(
                    f"it is declared for {_phases_of(term)} at '{term.at}', and no such phase among {names} has a "
                    "model that supplies it"
                )
            raise nowhere(term, whys)
        for key, (name, _) in self.numbers.replaced.items():
            if complete and key not in self.numbers.used and name not in self.names:
                own = [each.name for each in self.numbers.used if each.kind == "parameter" and each.term is None]
                raise UnknownNameError(self.problem.where, "parameter", name, [*sorted(own), *self.names])


def nowhere(term: Term, whys: Iterable[str]) -> ProblemError:
    """Return the error of a term that applies nowhere, with the reasons."""
    return ProblemError(
        f"term '{term.name}' ({term.source}): applies nowhere - got {'; '.join(whys)}, expected at least one model and "
        "phase; correct it or remove it"
    )


def _phases_of(term: Term) -> str:
    if term.when is None:
        return "every phase"
    if callable(term.when):
        return "phases that its when= selects"
    names = (term.when,) if isinstance(term.when, str) else term.when
    return "phase " + " or ".join(f"'{name}'" for name in names)
