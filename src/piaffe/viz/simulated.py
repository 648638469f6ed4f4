"""A simulation of a solution's policy in MuJoCo, for display."""

from __future__ import annotations

from piaffe.simulation import Policy, PolicyRun, run_policy, torque_plant

from .curves import friction
from .playback import Playback, Snapshot

_TOUCHES_N = 1e-3  # a foot with less normal force is drawn in the air
_FRICTION = 0.6  # used if no friction cone is declared


def simulate(
    playback: Playback, *, dt: float = 1e-3, mu: float | None = None
) -> tuple[PolicyRun, tuple[Snapshot, ...]]:
    """Simulate the policy of a solution in MuJoCo; return the run, and a snapshot per step.

    Args:
        playback: the solution. The first phase without a whole-body model, and all later phases, are left out.
        dt: step of the simulator and of the policy [s].
        mu: friction coefficient of the feet; by default that of the declared friction cone, else 0.6.

    Raises:
        ModelError: the solution does not begin with a whole-body model.
    """
    declared = friction(playback.solution) if mu is None else mu
    plant = torque_plant(
        playback.robot, timestep=dt, friction=_FRICTION if declared is None else declared, ground=playback.terrain
    )
    run = run_policy(Policy.of(playback.solution, plant.state.nx), plant)
    return run, tuple(_snapshot(playback, run, i) for i in range(len(run.times)))


def _snapshot(playback: Playback, run: PolicyRun, i: int) -> Snapshot:
    """Return the snapshot of a step; the ghost is the plan."""
    phase = int(run.phases[i])
    part = playback.trajectory.phases[phase]
    contact = tuple(bool(force[2] > _TOUCHES_N) for force in run.forces[i])
    pose, planned = (playback.pose(part, states[i], phase) for states in (run.states, run.planned))
    return Snapshot(float(run.times[i]), pose, run.forces[i], part.name, contact, planned)
