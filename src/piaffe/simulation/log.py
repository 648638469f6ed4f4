"""What is recorded at every tick and every plan of an episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Log:
    """Tables with a row per tick, whose memory is there from the start.

    Args:
        rows: largest number of rows.
        shapes: shape of a row of each table.
        every: one tick of so many is recorded.
    """

    def __init__(self, rows: int, shapes: Mapping[str, tuple[int, ...]], every: int) -> None:
        self._tables = {name: np.full((rows // every + 1, *shape), np.nan) for name, shape in shapes.items()}
        self._every, self._ticks, self._rows = every, 0, 0

    @property
    def due(self) -> bool:
        """Whether the next tick is recorded."""
        return self._ticks % self._every == 0

    def skip(self) -> None:
        """Count a tick that is not recorded."""
        self._ticks += 1

    def add(self, **values: Any) -> None:
        """Record a tick."""
        for name, value in values.items():
            self._tables[name][self._rows] = value
        self._rows += 1
        self._ticks += 1

    def complete(self, **values: Any) -> None:
        """Set values of the last recorded tick, which only the following steps tell."""
        if self._rows:
            for name, value in values.items():
                self._tables[name][self._rows - 1] = value

    def __getitem__(self, name: str) -> Array:
        return self._tables[name][: self._rows]
