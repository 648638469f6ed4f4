"""What random cases have shown, and the form of errors."""

from __future__ import annotations

from dataclasses import dataclass

from piaffe.errors import PiaffeError


@dataclass
class Found:
    """What random cases have shown: how many of each kind, and the largest differences.

    Args:
        refused: problems that are refused by name.
        compiled: horizons that are compared with the compiler.
        ticks: plans in C that are compared with those in NumPy; ``wild`` ones by their numbers alone.
        numbers: difference of parameters, masks, times, guesses.
        shift: difference of a plan that is only shifted, relative to 1 + its largest number.
        iteration: difference after an iteration from equal inputs, relative likewise.
    """

    refused: int = 0
    compiled: int = 0
    ticks: int = 0
    wild: int = 0
    numbers: float = 0.0
    shift: float = 0.0
    iteration: float = 0.0


def assert_form(error: PiaffeError, seed: int) -> None:
    """Raise unless the message of an error has the usual form: where, what is wrong, got, expected, what to do."""
    text = str(error)
    parts = [": ", " - got ", ", expected ", "; "]
    places = [text.find(part) for part in parts]
    assert min(places) > 0, f"seed {seed}: {text}"
