"""The native backend: a problem's functions and the C template of the solver, compiled together."""

from .backend import STATUS as STATUS
from .backend import Backend as Backend
from .backend import drive as drive
from .backend import native_memory as native_memory
from .backend import read_iterate as read_iterate
from .backend import read_outer as read_outer
from .backend import read_search as read_search
from .backend import write as write
from .memory import SolverMemory as SolverMemory
