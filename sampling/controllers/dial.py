"""DIAL-MPC: MPPI with perturbations that decrease from stage to stage and towards the start of the horizon."""

from __future__ import annotations

from typing import ClassVar

from ..options import Options
from .mppi import MPPI


class DIAL(MPPI):
    """Diffusion-inspired annealing [DIAL-MPC]: MPPI with the annealing schedule of ``Options.noise``.

    It differs from :class:`MPPI` only in its defaults: deviations are multiplied by β₂ per node towards the start of
    the horizon and by β₁ per stage, and the first plan has ten stages.
    """

    title: ClassVar[str] = "DIAL-MPC"
    defaults: ClassVar[Options] = Options()
