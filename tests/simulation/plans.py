"""Plans written down by hand: no solver is needed to play a policy."""

import numpy as np

from piaffe import models
from piaffe.ocp import PhaseTrajectory, Trajectory

ROBOT = models.load("solo12")
BODY = models.WholeBody(ROBOT)
KP, KD = 3.0, 0.1  # [Nm/rad], [Nm s/rad]


def bow(seed: int = 0) -> tuple[Trajectory, list[np.ndarray]]:
    """Return a plan of two phases of 0.1 s in which Solo12 bends its knees and turns a little, and gains about it.

    The gains hold the joints at the plan and react to the base; they differ from stage to stage.
    """
    rng = np.random.default_rng(seed)
    first = BODY.state(joints="stand")
    parts, gains = [], []
    for i, name in enumerate(("bend", "turn")):
        times = 0.1 * i + np.linspace(0.0, 0.1, 6)
        rates = np.zeros((6, 36))
        rates[:, 2], rates[:, 5] = -0.3 * (times - 0.1 * i), 0.4 * times
        rates[:, 6:18] = np.outer(times, np.tile([0.0, 0.8, -1.6], 4) * np.repeat([1, -1], 6))
        states = np.array([BODY.state.np_plus(first, row) for row in rates])
        controls = np.tile([0.0, 0.0, 0.7, 0.0, 0.0, 0.7, 0.0, 0.0, -0.7, 0.0, 0.0, -0.7], (5, 1))
        controls = controls + 0.05 * rng.normal(size=controls.shape)
        parts.append(
            PhaseTrajectory(name, "FL FR HL HR", BODY.name, times, states, controls, {}, BODY.state, BODY.control)
        )
        table = 0.1 * rng.normal(size=(5, 12, 36))
        table[:, :, 6:18] -= KP * np.eye(12)
        table[:, :, 24:36] -= KD * np.eye(12)
        gains.append(table)
    return Trajectory(tuple(parts)), gains
