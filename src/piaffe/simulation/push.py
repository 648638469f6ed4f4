"""Pushes on the base of a simulated robot, and their text form."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError

from .numbers import finite_number, vector

Array = NDArray[np.float64]
Frame = Literal["body", "world"]

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TEXT = re.compile(rf"(?P<size>{_NUMBER})(?P<unit>N?)@(?P<time>{_NUMBER}):(?P<axis>[xyz])(?:/(?P<duration>{_NUMBER}))?")
_FORM = "a push as '1.5@2.7:y' (m/s, s, axis), '60N@2.7:x' (a force), '1.5@2.7:y/0.1' (with its duration [s])"


@dataclass(frozen=True, kw_only=True)
class Push:
    """A change of the base's velocity, or a force on the base, that is spread evenly over a duration.

    A change of velocity is added in equal parts at every step of the simulator; joint speeds do not change, so the
    whole robot gets it. This is the published test [Li2025CafeMpc]: 1.5 m/s in 50 ms, in body axes.
    A force acts at the centre of mass of the base link.

    Args:
        time: of the first step with the push, since the motion's start [s].
        velocity: change of the base's linear velocity (3,) [m/s].
        force: on the base (3,) [N]; either a force or a velocity is given.
        duration: [s].
        frame: axes of the vector: ``"body"``, those of the base at every step, or ``"world"``.

    Raises:
        ModelError: a number is missing or out of range.
    """

    time: float
    velocity: tuple[float, float, float] | None = None
    force: tuple[float, float, float] | None = None
    duration: float = 0.05
    frame: Frame = "body"

    def __post_init__(self) -> None:
        if finite_number("push", "time", self.time) < 0 or finite_number("push", "duration", self.duration) <= 0:
            raise ModelError(
                f"push: time or duration is out of range - got {self.time!r} and {self.duration!r}, expected a time ≥ "
                "0 s and a duration > 0 s; change it"
            )
        if (self.velocity is None) == (self.force is None):
            raise ModelError(
                f"push at {self.time:g} s: it is not one thing - got velocity={self.velocity!r} and force="
                f"{self.force!r}, expected one of them; give Push(time=..., velocity=(0, 1.5, 0))"
            )
        if self.frame not in ("body", "world"):
            raise ModelError(f"push: frame is unknown - got {self.frame!r}, expected 'body' or 'world'; choose one")
        vector("push", "velocity or force", self.velocity if self.force is None else self.force)

    def in_world(self, to_world: Array) -> Array:
        """Return the vector in world axes, (3,).

        Args:
            to_world: rotation matrix of the base (3, 3).
        """
        given = np.array(self.velocity if self.force is None else self.force, dtype=float)
        return to_world @ given if self.frame == "body" else given


def parse_pushes(texts: str | Iterable[str]) -> tuple[Push, ...]:
    """Return the pushes of a text with spaces between them, or of several texts.

    ``1.5@2.7:y`` is a change of velocity by 1.5 m/s along the base's y axis within 0.05 s from 2.7 s on;
    ``-60N@2.7:x/0.1`` a force of −60 N for 0.1 s.

    Raises:
        ModelError: a text is not a push.
    """
    words = [word for text in ([texts] if isinstance(texts, str) else texts) for word in text.split()]
    return tuple(_parsed(word) for word in words)


def _parsed(word: str) -> Push:
    found = _TEXT.fullmatch(word)
    if found is None:
        raise ModelError(f"push: text is unusable - got {word!r}, expected {_FORM}; change it")
    along = np.zeros(3)
    along["xyz".index(found["axis"])] = float(found["size"])
    what: dict[str, Any] = {"force" if found["unit"] else "velocity": tuple(along.tolist())}
    if found["duration"]:
        what["duration"] = float(found["duration"])
    return Push(time=float(found["time"]), **what)
