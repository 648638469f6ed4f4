"""Small quadratic programs: a dual active-set method in C and in NumPy, and other packages for comparison."""

from .compiled import QpMemory as QpMemory
from .compiled import qp_library as qp_library
from .elastic import solve_elastic as solve_elastic
from .result import QpResult as QpResult
from .result import QpStatus as QpStatus
from .solve import QP_METHODS as QP_METHODS
from .solve import QpMethod as QpMethod
from .solve import qp_method as qp_method
from .solve import solve_qp as solve_qp
