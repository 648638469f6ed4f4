"""The receding horizon: plans again and again from measured states."""

from .adapting import Adapting as Adapting
from .keeper import Keeper as Keeper
from .loop import Loop as Loop
from .loop_parts import ActingPlan as ActingPlan
from .memory import RecedingMemory as RecedingMemory
from .motions import Motions as Motions
from .motions_tick import MotionsTick as MotionsTick
from .native_tick import NativeTick as NativeTick
from .plan import Plan as Plan
from .plan import PlannedPhase as PlannedPhase
from .plan_memory import HEADER as HEADER
from .plan_memory import NUM_FIGURES as NUM_FIGURES
from .plan_memory import PART as PART
from .receding_horizon import RecedingHorizon as RecedingHorizon
from .retiming import Retiming as Retiming
