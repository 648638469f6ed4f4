"""Export: a receding horizon and its low level as C that runs without Python."""

from .export import Exported as Exported
from .export import export_controller as export_controller
from .measure import Measured as Measured
