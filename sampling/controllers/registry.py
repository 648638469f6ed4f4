"""The controllers by the names that the command line, studies and files know them by."""

from __future__ import annotations

from collections.abc import Mapping

from .base import Sampler
from .dial import DIAL
from .mppi import MPPI
from .td_cd import TDCDMPPI

CONTROLLERS: Mapping[str, type[Sampler]] = {"td-cd": TDCDMPPI, "dial": DIAL, "mppi": MPPI}
"""Every controller of Piaffe by name; a file may declare more, in its own ``controllers``."""
