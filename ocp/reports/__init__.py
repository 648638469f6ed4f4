"""Reports on a compiled problem: descriptions, warnings, units, derivative checks, verification."""

from .derivative_check import DerivativeCheck as DerivativeCheck
from .derivative_check import check_derivatives as check_derivatives
from .describe import describe as describe
from .grid import early_warnings as early_warnings
from .units import ConstraintReport as ConstraintReport
from .units import CostReport as CostReport
from .units import report as report
from .verify import Verification as Verification
from .verify import check_fits as check_fits
from .verify import quantity_values as quantity_values
from .verify import verify as verify
from .violation import BOUNDS as BOUNDS
from .violation import Kind as Kind
from .violation import Violation as Violation
from .warnings import find_warnings as find_warnings
from .warnings import half_turns as half_turns
