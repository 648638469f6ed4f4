"""The compiler: from a problem to flat phases, CasADi functions and their numbers."""

from .checks import Guess as Guess
from .checks import check_guess as check_guess
from .checks import owner_of as owner_of
from .checks import require_derivatives as require_derivatives
from .checks import solve_implicit as solve_implicit
from .compile import compile_problem as compile_problem
from .compiled import CompiledPhase as CompiledPhase
from .compiled import CompiledProblem as CompiledProblem
from .finite import check_numbers as check_numbers
from .mode import LoweredMode as LoweredMode
from .mode import Row as Row
from .named_numbers import NamedNumber as NamedNumber
from .named_numbers import check_value as check_value
from .named_numbers import find_number as find_number
from .named_numbers import initial_state as initial_state
from .named_numbers import instance as instance
from .named_numbers import named_numbers as named_numbers
from .nodes import NodeNumbers as NodeNumbers
from .nodes import Nodes as Nodes
from .timeline import whole_steps as whole_steps
from .transition import LoweredTransition as LoweredTransition
from .vectorised import Vectorised as Vectorised
