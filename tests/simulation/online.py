"""A planner and a low level written down by hand: no solver is needed to run a plant."""

from typing import Any

import numpy as np

from tests.simulation.plans import ROBOT

STAND = ROBOT.pose("stand")
KP, KD = 6.0, 0.15  # [Nm/rad], [Nm s/rad]


class Angles:
    """A plan: joint angles, and which feet are on the ground."""

    status, iterations = "CONVERGED", 3

    def __init__(self, target: np.ndarray, flags: np.ndarray | None = None) -> None:
        self.target = target
        if flags is not None:
            self.contacts = lambda t: flags


class Springs:
    """A low level with springs at the joints; it notes when it acts, and on which plan."""

    def __init__(self, plan: Angles | None = None) -> None:
        self.plan = plan
        self.ticks: list[float] = []
        self.seen: list[np.ndarray] = []
        self.spoil: dict[int, Any] = {}

    def follow(self, plan: Angles) -> None:
        self.plan = plan

    def control(self, x: np.ndarray, t: float) -> np.ndarray:
        assert self.plan is not None
        self.ticks.append(t)
        self.seen.append(np.array(x))
        if len(self.ticks) - 1 in self.spoil:
            return np.asarray(self.spoil[len(self.ticks) - 1])
        return KP * (self.plan.target - x[7:19]) - KD * x[25:37]


class Sway:
    """A planner whose target angles depend on the time and on the measured state."""

    period = 0.02

    def __init__(self) -> None:
        self.calls: list[tuple[float, np.ndarray]] = []
        self.told: list[tuple[int, dict[str, float]]] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def command(self, **values: float) -> None:
        self.told.append((len(self.calls), values))

    def target(self, x: np.ndarray, t: float) -> np.ndarray:
        return STAND + 0.08 * np.sin(9 * t) * np.tile([0.0, 1.0, -1.0], 4) + 0.1 * (x[7:19] - STAND)

    def plan(self, x: np.ndarray, t: float) -> Angles:
        self.calls.append((t, np.array(x)))
        return Angles(self.target(x, t))
