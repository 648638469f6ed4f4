"""The controllers by their names in the command line, in studies and in files."""

from __future__ import annotations

from collections.abc import Mapping

from .base import Sampler
from .dial import DIAL
from .mppi import MPPI
from .td_cd import TDCDMPPI

CONTROLLERS: Mapping[str, type[Sampler]] = {"td-cd": TDCDMPPI, "dial": DIAL, "mppi": MPPI}
"""All controllers of Piaffe by name; a user's file can add others in its ``controllers``."""
