"""Low-level controllers that follow a plan: ``control(x, t)`` is the control of a measured state at a time."""

from .baselines import FeedforwardPD as FeedforwardPD
from .baselines import Riccati as Riccati
from .low_level import JointPD as JointPD
from .low_level import LowLevel as LowLevel
from .plan import PlanPhase as PlanPhase
from .plan import PlanStage as PlanStage
from .plan import SolvedPlan as SolvedPlan
from .plan import StagedPlan as StagedPlan
from .plan import modes_of as modes_of
from .plan import stage_at as stage_at
from .rows import ControlRows as ControlRows
from .vwbc import Vwbc as Vwbc
from .vwbc import VwbcTick as VwbcTick
