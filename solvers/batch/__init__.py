"""Many instances of one problem, solved in parallel."""

from .batch import solve_batch as solve_batch
from .solution import BatchPhase as BatchPhase
from .solution import BatchSolution as BatchSolution
