"""Multiple-shooting iLQR: the algorithm in NumPy, and the same in C in ``native``."""

from .cause import with_cause as with_cause
from .iterate import Iterate as Iterate
from .iterate import ProblemFunctions as ProblemFunctions
from .ms_ilqr import MSiLQR as MSiLQR
from .native import STATUS as STATUS
from .native import Backend as Backend
from .native import SolverMemory as SolverMemory
from .native import native_memory as native_memory
from .native import read_iterate as read_iterate
from .native import read_outer as read_outer
from .native import read_search as read_search
from .native import write as write
from .options import Fixed as Fixed
from .options import Options as Options
from .outer import Outer as Outer
from .result import assemble as assemble
from .result import sweeps_of as sweeps_of
from .riccati import LqPhase as LqPhase
from .riccati import Sweep as Sweep
from .run import Run as Run
from .warm_start import WarmStart as WarmStart
from .warm_start import first_iterate as first_iterate
from .warm_start import iterate_from as iterate_from
