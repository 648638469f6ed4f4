"""The native backend: the functions of a problem and the C template of the solver, compiled into one library."""

from .backend import STATUS as STATUS
from .backend import Backend as Backend
from .backend import native_memory as native_memory
from .backend import native_scale as native_scale
from .backend import read_iterate as read_iterate
from .backend import read_outer as read_outer
from .backend import read_search as read_search
from .backend import run_native as run_native
from .backend import write as write
from .library import Library as Library
from .library import library_of as library_of
from .memory import SolverMemory as SolverMemory
from .program import TEMPLATES as TEMPLATES
from .program import constants_header as constants_header
from .program import sizes_header as sizes_header
from .structs import OPTIONS as OPTIONS
from .structs import OptionsStruct as OptionsStruct
from .structs import structs_of as structs_of
