"""Sampling controllers on MuJoCo roll-outs of a declared problem: MPPI, DIAL-MPC and TD-CD-MPPI."""

from .dial import DIAL as DIAL
from .episode import Episode as Episode
from .episode import run_episode as run_episode
from .mppi import MPPI as MPPI
from .options import Options as Options
from .plan import Plan as Plan
from .records import load_episodes as load_episodes
from .records import save_episodes as save_episodes
from .reward import Reward as Reward
from .spread import Spread as Spread
from .study import Case as Case
from .study import Study as Study
from .td_cd import TDCDMPPI as TDCDMPPI
from .value import CollectOptions as CollectOptions
from .value import LearnOptions as LearnOptions
from .value import Value as Value
from .value import load_value as load_value
from .value import train_value as train_value
