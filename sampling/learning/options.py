"""Options of value learning."""

from __future__ import annotations

from dataclasses import dataclass

from piaffe.errors import SamplingError

from ..value import HIDDEN


@dataclass(frozen=True, kw_only=True)
class LearnOptions:
    """Options of :func:`learn`.

    Args:
        discount: γ₀ per step; the planner's must be the same.
        updates: number of minibatches.
        batch: transitions per minibatch.
        learning_rate: learning rate of AdamW.
        weight_decay: weight decay of AdamW, per step in units of the learning rate. Without it, the network overfits
            data of about 10 000 transitions.
        target_rate: τ of the target network, θ' ← τ θ + (1 − τ) θ' after every minibatch. The paper uses 1e-3, with
            which the target needs about 1e5 minibatches.
        hidden: sizes of the hidden layers.
        held_out: share of the episodes that is only used for tests, in [0, 1).
        record_every: minibatches between two points of the learning curves, and between two checkpoints.
        seed: seed of the first parameters, of the minibatches and of the choice of held-out episodes.
    """

    discount: float = 0.9
    updates: int = 20_000
    batch: int = 512
    learning_rate: float = 3e-4
    weight_decay: float = 0.0
    target_rate: float = 5e-3
    hidden: tuple[int, ...] = HIDDEN
    held_out: float = 0.1
    record_every: int = 500
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in {"updates": 1, "batch": 1, "record_every": 1, "seed": 0}.items():
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= least):
                self._refuse(name, f"a whole number, at least {least}")
        for name in ("discount", "target_rate"):
            if not 0 < getattr(self, name) <= 1:
                self._refuse(name, "a number in (0, 1]")
        if not 0 < self.learning_rate < float("inf"):
            self._refuse("learning_rate", "a positive number")
        if not 0 <= self.weight_decay < float("inf"):
            self._refuse("weight_decay", "a number, at least 0")
        if not 0 <= self.held_out < 1:
            self._refuse("held_out", "a number in [0, 1)")
        if not self.hidden or not all(isinstance(n, int) and n > 0 for n in self.hidden):
            self._refuse("hidden", "positive whole numbers, at least one")

    def _refuse(self, name: str, expected: str) -> None:
        raise SamplingError(
            f"learning options: {name} is out of range - got {getattr(self, name)!r}, expected {expected}; change it"
        )
