"""Compiled C from CasADi functions: SIMD code generator, build, cache, compilers; for any problem and any robot."""

from . import simd as simd
from .build import SOLVER_FLAGS as SOLVER_FLAGS
from .build import Built as Built
from .build import build as build
from .build import load as load
from .cache import Cache as Cache
from .cache import fault_of as fault_of
from .compilers import NoCompilerError as NoCompilerError
from .compilers import NoCompilerWarning as NoCompilerWarning
from .cpu import available_cores as available_cores
from .cpu import this_cpu as this_cpu
from .memory import AlignedMemory as AlignedMemory
from .memory import aligned_zeros as aligned_zeros
from .memory import shares as shares
from .simd import generate as generate
from .snippets import c_library as c_library
from .snippets import pointer as pointer
from .snippets import run_in_parallel as run_in_parallel
from .sources import LazySources as LazySources
from .sources import Sources as Sources
from .trust import CacheError as CacheError
from .trust import CacheWarning as CacheWarning
from .trust import NoFolderError as NoFolderError
from .worker import Worker as Worker
