"""Rollout engines: one interface, several simulators."""

from .engine import Engine, Rollouts, Simulated
from .native import NativeEngine

__all__ = ["Engine", "NativeEngine", "Rollouts", "Simulated"]
