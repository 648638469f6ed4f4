"""Sampling controllers: a base class, and its subclasses MPPI, DIAL-MPC and TD-CD-MPPI."""

from .base import Sampler as Sampler
from .dial import DIAL as DIAL
from .discount import ConstraintDiscount as ConstraintDiscount
from .mppi import MPPI as MPPI
from .plan import Plan as Plan
from .registry import CONTROLLERS as CONTROLLERS
from .stage import Memory as Memory
from .stage import Rolled as Rolled
from .stage import Stage as Stage
from .td_cd import TDCDMPPI as TDCDMPPI
