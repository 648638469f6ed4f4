"""Trajectories: states, controls and outputs of a motion, phase by phase; files store them and references read them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.html import html_table

from .columns import columns_of
from .csv_file import read_csv, write_csv
from .mcap_file import write_mcap
from .model import ModelBase
from .phase_trajectory import PhaseTrajectory as PhaseTrajectory
from .quantity import Quantity
from .time import SAME_TIME

Array = NDArray[np.float64]

SCHEDULED = "scheduled"
"""Mode of a phase of a model that has one phase for all modes (``cut_by_modes`` is False)."""


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """Phases in the order of time."""

    phases: tuple[PhaseTrajectory, ...] = field(default=())

    def __repr__(self) -> str:
        if not self.phases:
            return "Trajectory(no phases)"
        names = ", ".join(dict.fromkeys(phase.name for phase in self.phases))
        return f"Trajectory({len(self.phases)} phases, {self.start:g} to {self.end:g} s: {names})"

    def _repr_html_(self) -> str:
        head = ("phase", "mode", "model", "from [s]", "to [s]", "stages")
        rows = [(p.name, p.mode, p.model, f"{p.times[0]:g}", f"{p.times[-1]:g}", len(p.controls)) for p in self.phases]
        return html_table(repr(self), head, rows)

    @property
    def start(self) -> float:
        """Time of the first node [s]."""
        return float(self.phases[0].times[0])

    @property
    def end(self) -> float:
        """Time of the last node [s]."""
        return float(self.phases[-1].times[-1])

    @property
    def duration(self) -> float:
        """Length [s]."""
        return self.end - self.start

    def phase_at(self, t: float) -> PhaseTrajectory:
        """Return the phase at time t; the later one on a boundary."""
        for phase in reversed(self.phases):
            if t >= phase.times[0] - SAME_TIME:
                return phase
        return self.phases[0]

    def sample(self, t: float) -> dict[Quantity, Array]:
        """Return state, control and outputs at time t."""
        return self.phase_at(t).sample(t)

    def to_csv(self, path: str | Path) -> Path:
        """Write a CSV file, atomically: a line of names, then a row per node; return its path.

        Columns are named by quantity, component and unit: ``"base.position x [m]"``; the first ones are ``"time [s]"``,
        ``"phase"``, ``"mode"``, ``"model"`` and ``"ends_phase"``. The last row of a phase has no controls, and a phase
        begins with a row of its own. Numbers are written with all their digits.

        Raises:
            FileWriteError: the file cannot be written.
        """
        return write_csv(self.phases, Path(path))

    def to_mcap(self, path: str | Path) -> Path:
        """Write an MCAP log, atomically, which Foxglove opens; return its path. It needs ``piaffe[log]``.

        Each quantity has a topic, ``"/joints.position"``, whose messages have a number per component; the pose of a
        floating base is a ``foxglove.FrameTransform``. Times are those since the motion's start.

        Raises:
            ProblemError: the package is missing.
        """
        return write_mcap(self.phases, Path(path))

    @staticmethod
    def from_csv(path: str | Path, *models: ModelBase) -> Trajectory:
        """Read a CSV file that :meth:`to_csv` wrote, or one of motion capture or another planner.

        Args:
            path: the file. Needed are ``"time [s]"`` and the columns of the model's state. Velocities may be missing:
                they are then differences. Missing controls are zero. Without the column ``"phase"`` it is one phase.
            models: the models of the phases; one if the file has no column ``"model"``.

        Raises:
            FileFormatError: the file cannot be read, a column is missing, a model is unknown, or times do not increase.
        """
        return Trajectory(read_csv(Path(path), models))

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with the columns of :meth:`to_csv`; missing numbers are NaN.

        Raises:
            ImportError: pandas is not installed.
        """
        import pandas

        return pandas.DataFrame(columns_of(self.phases))
