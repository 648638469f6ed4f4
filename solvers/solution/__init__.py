"""The result of a solve: solution, status, records of iterations, and its file."""

from .explanation import Relaxation as Relaxation
from .parts import PhaseSolution as PhaseSolution
from .record import Record as Record
from .search_state import SearchState as SearchState
from .search_state import is_same as is_same
from .solution import Solution as Solution
from .status import Status as Status
