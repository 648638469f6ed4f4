"""Sampling controllers on MuJoCo roll-outs of a declared problem: MPPI, DIAL-MPC and TD-CD-MPPI."""

from .dial import DIAL as DIAL
from .episode import Episode as Episode
from .episode import run_episode as run_episode
from .mppi import MPPI as MPPI
from .options import Options as Options
from .plan import Plan as Plan
from .reward import Reward as Reward
from .td_cd import TDCDMPPI as TDCDMPPI
