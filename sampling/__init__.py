"""Sampling controllers on MuJoCo roll-outs of a declared problem: MPPI, DIAL-MPC, TD-CD-MPPI, and your own."""

from piaffe.errors import renamed as _renamed
from piaffe.simulation import Episode as Episode
from piaffe.simulation import Spread as Spread
from piaffe.simulation import run_episode as run_episode

from .controllers import CONTROLLERS as CONTROLLERS
from .controllers import DIAL as DIAL
from .controllers import MPPI as MPPI
from .controllers import TDCDMPPI as TDCDMPPI
from .controllers import Memory as Memory
from .controllers import Plan as Plan
from .controllers import Rolled as Rolled
from .controllers import Sampler as Sampler
from .controllers import Stage as Stage
from .engines import NativeEngine as NativeEngine
from .learning import CollectOptions as CollectOptions
from .learning import LearnOptions as LearnOptions
from .learning import train_value as train_value
from .options import Options as Options
from .reward import Reward as Reward
from .study import Case as Case
from .study import FileTask as FileTask
from .study import Runner as Runner
from .study import Study as Study
from .study import StudyFile as StudyFile
from .study import Trial as Trial
from .study import cells as cells
from .study import complete as complete
from .study import executor_of as executor_of
from .study import listed as listed
from .study import load_declared as load_declared
from .study import load_episodes as load_episodes
from .study import prepare as prepare
from .study import read_study as read_study
from .study import require_executor as require_executor
from .study import require_pyarrow as require_pyarrow
from .study import save_episodes as save_episodes
from .study import text_of as text_of
from .study import try_controllers as try_controllers
from .study import varied as varied
from .study import write_parquet as write_parquet
from .study import write_tables as write_tables
from .value import Value as Value
from .value import load_value as load_value

__getattr__ = _renamed(__name__, {"TITLES": "piaffe.sampling.CONTROLLERS[name].title"})
