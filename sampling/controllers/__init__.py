"""Sampling controllers: MPPI, DIAL-MPC and TD-CD-MPPI."""

from .dial import DIAL as DIAL
from .discount import ConstraintDiscount as ConstraintDiscount
from .mppi import MPPI as MPPI
from .plan import Plan as Plan
from .td_cd import TDCDMPPI as TDCDMPPI
