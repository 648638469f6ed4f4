"""The native backend: problems as C, compiled for this machine."""

from .build import Built as Built
from .build import build as build
from .build import load as load
from .cache import Cache as Cache
from .compilers import NoCompilerError as NoCompilerError
from .cpu import available_cores as available_cores
from .drive import drive as drive
from .library import library_for as library_for
from .machine import Machine as Machine
from .processes import CompileError as CompileError
from .start import Backend as Backend
from .start import NoCompilerWarning as NoCompilerWarning
from .start import native_machine as native_machine
