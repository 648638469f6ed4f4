"""Trajectories: states, controls and outputs of a motion, phase by phase; files store them and references read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from piaffe.html import html_table

from .manifold import Manifold
from .quantity import Quantity
from .time import SAME_TIME

if TYPE_CHECKING:
    from .model import ModelBase

Array = NDArray[np.float64]

SCHEDULED = "scheduled"
"""Mode of a phase of a model that has one phase for all modes (``cut_by_modes`` is False)."""


@dataclass(frozen=True, eq=False, repr=False)
class PhaseTrajectory:
    """One phase of one model.

    Args:
        name: the motion phase's name.
        mode: its mode as text, e.g. ``"FL HR"``.
        model: the model's name.
        times: node times (N+1,) [s].
        states: (N+1, nx).
        controls: (N, nu).
        outputs: quantity → (N, size), e.g. contact forces.
        state: layout of the states.
        control: layout of the controls.
        ends_phase: whether the motion's phase ends at the last node; if not, the segment or the horizon ends there.
        reset_outputs: quantity → (size,), e.g. the impulses of the feet in the impact after the last node; empty if
            there is no impact.
        output_labels: quantity → one label per component of an output, e.g. ``"FL x"``; empty if they are not known.
    """

    name: str
    mode: str
    model: str
    times: Array
    states: Array
    controls: Array
    outputs: Mapping[Quantity, Array]
    state: Manifold
    control: Manifold
    ends_phase: bool = True
    reset_outputs: Mapping[Quantity, Array] = field(default_factory=dict)
    output_labels: Mapping[Quantity, tuple[str, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"PhaseTrajectory('{self.name}' of '{self.model}', {self.times[0]:g} to {self.times[-1]:g} s, "
            f"states {self.states.shape}, controls {self.controls.shape})"
        )

    @property
    def duration(self) -> float:
        """Length [s]."""
        return float(self.times[-1] - self.times[0])

    def sample(self, t: float) -> dict[Quantity, Array]:
        """Return state (interpolated on the manifold), control and outputs (held) at time t, clamped to the phase."""
        t = float(np.clip(t, self.times[0], self.times[-1]))
        i = int(np.clip(np.searchsorted(self.times, t + SAME_TIME, side="right") - 1, 0, len(self.times) - 2))
        share = float(np.clip((t - self.times[i]) / (self.times[i + 1] - self.times[i]), 0.0, 1.0))
        x0, x1 = self.states[i], self.states[i + 1]
        sample = self.state.unpack(self.state.np_plus(x0, share * self.state.np_minus(x1, x0)))
        sample.update(self.control.unpack(self.controls[i]))
        sample.update({quantity: values[i] for quantity, values in self.outputs.items()})
        return sample


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
        from .csv_file import write_csv

        return write_csv(self, Path(path))

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
        from .csv_file import read_csv

        return read_csv(Path(path), models)

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with the columns of :meth:`to_csv`; missing numbers are NaN.

        Raises:
            ImportError: pandas is not installed.
        """
        import pandas

        from .columns import columns_of

        return pandas.DataFrame(columns_of(self))
