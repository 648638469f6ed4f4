"""Solvers: multi-phase multiple-shooting iLQR with augmented Lagrangian and relaxed barrier."""

from .batch import solve_batch as solve_batch
from .batch_solution import BatchPhase as BatchPhase
from .batch_solution import BatchSolution as BatchSolution
from .ms_ilqr import MSiLQR as MSiLQR
from .options import Options as Options
from .record import Record as Record
from .riccati import LqPhase as LqPhase
from .solution import PhaseSolution as PhaseSolution
from .solution import Solution as Solution
from .solution import Violation as Violation
from .status import Status as Status
