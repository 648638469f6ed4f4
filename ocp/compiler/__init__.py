"""The compiler: from a problem to flat phases, CasADi functions and their numbers."""

from .checks import require_derivatives as require_derivatives
from .compile import compile_problem as compile_problem
from .compiled import CompiledProblem as CompiledProblem
from .compiled import instance as instance
from .compiled_phase import CompiledPhase as CompiledPhase
from .finite import check_numbers as check_numbers
from .guess_checks import Guess as Guess
from .guess_checks import check_guess as check_guess
from .guess_checks import end_values as end_values
from .guess_checks import owner_of as owner_of
from .guess_checks import solve_implicit as solve_implicit
from .invariants import bound_invariants as bound_invariants
from .mode import LoweredMode as LoweredMode
from .mode import Row as Row
from .nodes import NodeNumbers as NodeNumbers
from .nodes import Nodes as Nodes
from .parameters import Parameters as Parameters
from .timeline import whole_steps as whole_steps
from .transition import LoweredTransition as LoweredTransition
from .vectorised import Vectorised as Vectorised
