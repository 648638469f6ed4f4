"""Whether a plan executes: its policy plays on MuJoCo from perturbed starts, and where it departs is told by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import Robot
from piaffe.ocp import CompiledPhase, CompiledProblem, Policy, Problem, SolutionLike, check_fits, compile_problem

from .declared_plant import declared_ground, declared_robot
from .deviation import Deviation, deviations
from .perturbation import Perturbation
from .policy_run import Control, PolicyRun, Steps, play, sampled, torque_plant

Array = NDArray[np.float64]

FRICTION = 0.6
"""Friction coefficient of the ground if the problem declares none."""

_Key = tuple[str, str, str]  # what, name, phase
_LOADED = 0.01  # a foot is on the ground if its normal force exceeds this share of the robot's weight


@dataclass(frozen=True)
class Trial:
    """One simulation of a plan's policy.

    Args:
        seed: seed of the perturbed start.
        lost_at: time at which the plan was lost [s]; None if it was followed to its end.
        position: last position error of the base [m]. orientation: its last orientation error [rad]; with a fixed base,
            the largest last error of a joint.
        saturated: fraction of the steps at which a torque was at its limit.
        deviations: departures from the plan, in the order of time.
    """

    seed: int
    lost_at: float | None
    position: float
    orientation: float
    saturated: float
    deviations: tuple[Deviation, ...]

    @property
    def followed(self) -> bool:
        """Whether the plan was followed to its end."""
        return self.lost_at is None

    def reasons(self, count: int = 4) -> tuple[Deviation, ...]:
        """Return the largest deviations, relative to the smallest ones that are reported, in the order of time."""
        largest = sorted(self.deviations, key=lambda each: -each.size)[:count]
        return tuple(sorted(largest, key=lambda each: each.time))

    def __str__(self) -> str:
        end = "followed" if self.lost_at is None else f"lost at {self.lost_at:.2f} s"
        why = "; ".join(f"{each.time:.2f} s, {each.phase}: {each}" for each in self.reasons())
        return f"seed {self.seed}: {end}, base off by {self.position:.3f} m, {self.orientation:.3f} rad. {why}".rstrip()


@dataclass(frozen=True)
class Execution:
    """Simulations of a plan's policy from perturbed starts.

    Args:
        trials: one per seed.
        duration: duration of the plan [s].
        friction: friction coefficient of the robot on the ground.
        perturbation: standard deviations of the starts.
        fixed: whether the base is fixed; errors are then those of joints.
    """

    trials: tuple[Trial, ...]
    duration: float
    friction: float
    perturbation: Perturbation
    fixed: bool = False

    @property
    def followed(self) -> int:
        """Number of trials that followed the plan to its end."""
        return sum(trial.followed for trial in self.trials)

    @property
    def holds(self) -> bool:
        """Whether all trials followed the plan to its end."""
        return self.followed == len(self.trials)

    @property
    def median_error(self) -> float:
        """Median over all trials of the last position error of the base [m]."""
        return float(np.median([trial.position for trial in self.trials]))

    @property
    def worst_error(self) -> float:
        """Largest last position error of the base [m]."""
        return max(trial.position for trial in self.trials)

    def frequent(self, count: int = 6) -> tuple[tuple[Deviation, int], ...]:
        """Return the deviations that most trials have, each with its number of trials, and its largest amount."""
        seen: dict[_Key, list[Deviation]] = {}
        for trial in self.trials:
            own: dict[_Key, Deviation] = {}
            for each in trial.deviations:
                key: _Key = (each.what, each.name, each.phase)
                own[key] = max(own.get(key, each), each, key=lambda found: found.amount)
            for key, each in own.items():
                seen.setdefault(key, []).append(each)
        groups = [(max(group, key=lambda each: each.amount), len(group)) for group in seen.values()]
        return tuple(sorted(groups, key=lambda each: (-each[1], -each[0].size))[:count])

    def __str__(self) -> str:
        if self.fixed:
            errors = [trial.orientation for trial in self.trials]
            last = f"a joint {np.median(errors):.4f} rad in the median, {max(errors):.4f} rad"
        else:
            last = f"the base {self.median_error:.3f} m in the median, {self.worst_error:.3f} m"
        return (
            f"{self.followed} of {len(self.trials)} starts followed to the end, {self.duration:.2f} s, at friction "
            f"{self.friction:.3g}; last error of {last} in the worst case"
        )


def execute(
    solution: SolutionLike,
    problem: Problem | CompiledProblem,
    *,
    seeds: int | Iterable[int] = 10,
    perturbation: Perturbation | None = None,
    friction: float | None = None,
    timestep: float = 1e-3,
    control: Control | None = None,
    progress: Callable[[Trial], None] | None = None,
) -> Execution:
    """Play the policy of a solution, ū + K (x ⊖ x̄), on MuJoCo from perturbed starts.

    MuJoCo simulates the contacts; the robot's feet, base and knees collide with the ground. Gravity, masses, inertias
    and the height of the ground are the problem's. The plan is lost if the base is more than 0.3 m or 1 rad from it.

    Args:
        solution: a solution of the problem. Phases from the first one without a whole body on are left out.
        problem: the problem.
        seeds: number of starts, with seeds 0, 1, …, or the seeds.
        perturbation: standard deviations of the starts; ``Perturbation()`` by default.
        friction: friction coefficient; by default the smallest that a friction cone of the problem declares, else 0.6.
        timestep: step of the simulator and of the policy [s].
        control: a low-level controller of the same plan, as ``solvers.Vwbc(...).control``, in place of the policy.
        progress: called with every trial.

    Raises:
        ModelError: the problem does not begin with a whole body, there is no seed, or the friction is not positive.
        ProblemError: the solution is not of this problem.
    """
    compiled = problem if isinstance(problem, CompiledProblem) else compile_problem(problem, checks=False)
    check_fits(compiled, solution.trajectory)
    chosen = tuple(range(seeds)) if isinstance(seeds, int) else tuple(seeds)
    mu = declared_friction(compiled) if friction is None else float(friction)
    if not chosen or not 0 < mu < np.inf:
        what, got, expected = (
            ("friction", mu, "a positive number") if chosen else ("seeds", len(chosen), "at least one")
        )
        raise ModelError(f"execution: {what} out of range - got {got}, expected {expected}; change it")
    robot, ground = declared_robot(compiled), declared_ground(compiled)
    plant = torque_plant(robot, timestep=timestep, friction=mu, ground=ground)
    policy = Policy.of(solution, plant.state.nx)
    steps, starts = sampled(policy, timestep), perturbation or Perturbation()
    stances = _stances(compiled, steps, robot)
    trials = []
    for seed in chosen:
        run = play(steps, plant, starts.around(plant, policy.initial, seed), control)
        trials.append(_trial(seed, run, stances, policy, robot))
        if progress is not None:
            progress(trials[-1])
    return Execution(tuple(trials), policy.end - policy.start, mu, starts, robot.base == "fixed")


def declared_friction(compiled: CompiledProblem) -> float:
    """Return the smallest friction coefficient of the problem's friction cones, 0.6 without any."""
    values = compiled.parameters
    cones = [
        float(np.min(values[name]))
        for name in values
        if name.startswith("friction") and name.rpartition(".")[2] == "mu"
    ]
    return min(cones, default=FRICTION)


def _trial(seed: int, run: PolicyRun, stances: NDArray[np.bool_], policy: Policy, robot: Robot) -> Trial:
    names = [part.name for part in policy.trajectory.phases]
    weight = robot.mass * float(np.linalg.norm(robot.model.gravity.linear))
    found = deviations(run, stances[: len(run.times)], names, robot.foot_names, robot.motor_names, _LOADED * weight)
    return Trial(seed, run.lost_at, float(run.position[-1]), float(run.orientation[-1]), run.saturated, found)


def _stances(compiled: CompiledProblem, steps: Steps, robot: Robot) -> NDArray[np.bool_]:
    """Return which feet are on the ground in the plan, (T, nf)."""
    return np.array([
        _contact(compiled.phases[phase], stage) for phase, stage in zip(steps.phases, steps.stages, strict=True)
    ]).reshape(len(steps.phases), len(robot.feet))  # fmt: skip


def _contact(phase: CompiledPhase, stage: int) -> NDArray[np.bool_]:
    return np.asarray(phase.p[stage, phase.mode.layout.slots["contact"]] > 0.5)
