"""Low-level controllers that follow a plan: ``control(x, t)`` is the control of a measured state at a time."""

from .baselines import FeedforwardPD as FeedforwardPD
from .baselines import Riccati as Riccati
from .contacts import MeasuredContacts as MeasuredContacts
from .gains import JointPD as JointPD
from .low_level import LowLevel as LowLevel
from .memory import NativeTick as NativeTick
from .plan import CONTACT as CONTACT
from .plan import PlanPhase as PlanPhase
from .plan import PlanStage as PlanStage
from .plan import StagedPlan as StagedPlan
from .plan import contacts_at as contacts_at
from .plan import modes_of as modes_of
from .plan import stage_at as stage_at
from .plan_memory import PHASE_BYTES as PHASE_BYTES
from .plan_memory import PLAN_HEADER as PLAN_HEADER
from .plan_memory import PlanMemory as PlanMemory
from .plan_memory import PlanStruct as PlanStruct
from .program import VwbcTick as VwbcTick
from .rows import ControlRows as ControlRows
from .solved_plan import SolvedPlan as SolvedPlan
from .vwbc import Vwbc as Vwbc
