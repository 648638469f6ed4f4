"""Solvers: multi-phase multiple-shooting iLQR with augmented Lagrangian and relaxed barrier."""

from piaffe.codegen import NoCompilerWarning as NoCompilerWarning
from piaffe.ocp import Violation as Violation

from .batch import BatchPhase as BatchPhase
from .batch import BatchSolution as BatchSolution
from .batch import solve_batch as solve_batch
from .export import Exported as Exported
from .export import export_controller as export_controller
from .ilqr import Fixed as Fixed
from .ilqr import LqPhase as LqPhase
from .ilqr import MSiLQR as MSiLQR
from .ilqr import Options as Options
from .qp import QpResult as QpResult
from .qp import QpStatus as QpStatus
from .qp import solve_qp as solve_qp
from .receding import ActingPlan as ActingPlan
from .receding import Adapting as Adapting
from .receding import Loop as Loop
from .receding import Plan as Plan
from .receding import PlannedPhase as PlannedPhase
from .receding import RecedingHorizon as RecedingHorizon
from .receding import Retiming as Retiming
from .solution import PhaseSolution as PhaseSolution
from .solution import Record as Record
from .solution import Solution as Solution
from .solution import Status as Status
from .tracking import FeedforwardPD as FeedforwardPD
from .tracking import JointPD as JointPD
from .tracking import LowLevel as LowLevel
from .tracking import MeasuredContacts as MeasuredContacts
from .tracking import PlanPhase as PlanPhase
from .tracking import Riccati as Riccati
from .tracking import SolvedPlan as SolvedPlan
from .tracking import StagedPlan as StagedPlan
from .tracking import Vwbc as Vwbc
from .tracking import VwbcTick as VwbcTick
