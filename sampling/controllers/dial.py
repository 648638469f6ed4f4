"""DIAL-MPC: MPPI whose perturbations shrink from stage to stage and towards the horizon's start."""

from __future__ import annotations

from typing import ClassVar

from ..options import Options
from .mppi import MPPI


class DIAL(MPPI):
    """Diffusion-inspired annealing [DIAL-MPC]: MPPI with the annealing schedule of ``Options.noise``.

    What differs from :class:`MPPI` is in its defaults alone: deviations fall by β₂ per node towards the horizon's
    start and by β₁ per stage, and the first plan takes ten stages.
    """

    title: ClassVar[str] = "DIAL-MPC"
    defaults: ClassVar[Options] = Options()
