"""The receding horizon: plans again and again from measured states."""

from .adapting import Adapting as Adapting
from .loop import Loop as Loop
from .loop_parts import ActingPlan as ActingPlan
from .plan import Plan as Plan
from .plan import PlannedPhase as PlannedPhase
from .receding_horizon import RecedingHorizon as RecedingHorizon
from .retiming import Retiming as Retiming
