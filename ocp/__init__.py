"""Optimal-control problems: models, phases, motions, terms, schedules, and the compiler to CasADi functions."""

from piaffe.errors import renamed as _renamed

from .compiler import CompiledPhase as CompiledPhase
from .compiler import CompiledProblem as CompiledProblem
from .compiler import LoweredMode as LoweredMode
from .compiler import LoweredTransition as LoweredTransition
from .compiler import NodeNumbers as NodeNumbers
from .compiler import Nodes as Nodes
from .compiler import Parameters as Parameters
from .compiler import Row as Row
from .compiler import Vectorised as Vectorised
from .compiler import check_guess as check_guess
from .compiler import check_numbers as check_numbers
from .compiler import compile_problem as compile_problem
from .compiler import instance as instance
from .compiler import owner_of as owner_of
from .compiler import require_derivatives as require_derivatives
from .compiler import solve_implicit as solve_implicit
from .compiler import whole_steps as whole_steps
from .horizon import Course as Course
from .horizon import Horizon as Horizon
from .horizon import Place as Place
from .horizon import Span as Span
from .horizon import moved_symbols as moved_symbols
from .language import ORIGIN as ORIGIN
from .language import SAME_TIME as SAME_TIME
from .language import TIME_STEP as TIME_STEP
from .language import AddedTargets as AddedTargets
from .language import BallisticPoint as BallisticPoint
from .language import Block as Block
from .language import Bound as Bound
from .language import BoundReference as BoundReference
from .language import Constraint as Constraint
from .language import Constraints as Constraints
from .language import ContactPoint as ContactPoint
from .language import Cost as Cost
from .language import Dynamics as Dynamics
from .language import Free as Free
from .language import FromArrays as FromArrays
from .language import FromTrajectory as FromTrajectory
from .language import Invariants as Invariants
from .language import Keyframe as Keyframe
from .language import Keyframes as Keyframes
from .language import Manifold as Manifold
from .language import Model as Model
from .language import ModelBase as ModelBase
from .language import Motion as Motion
from .language import Node as Node
from .language import NodeView as NodeView
from .language import Objective as Objective
from .language import OverPhase as OverPhase
from .language import Parameter as Parameter
from .language import ParameterKey as ParameterKey
from .language import Path as Path
from .language import Phase as Phase
from .language import PhaseTime as PhaseTime
from .language import PhaseTrajectory as PhaseTrajectory
from .language import Piece as Piece
from .language import PlacedPhase as PlacedPhase
from .language import PlanarFrame as PlanarFrame
from .language import Policy as Policy
from .language import Problem as Problem
from .language import ProblemWarning as ProblemWarning
from .language import Quantities as Quantities
from .language import Quantity as Quantity
from .language import QuantityGroup as QuantityGroup
from .language import Reference as Reference
from .language import ReferenceFunctions as ReferenceFunctions
from .language import Reset as Reset
from .language import ResetRows as ResetRows
from .language import Sample as Sample
from .language import Schedule as Schedule
from .language import Segment as Segment
from .language import Sizes as Sizes
from .language import Slot as Slot
from .language import SolutionLike as SolutionLike
from .language import Source as Source
from .language import SplitStep as SplitStep
from .language import Trajectory as Trajectory
from .language import Values as Values
from .language import When as When
from .language import by_phase as by_phase
from .language import call as call
from .language import caller as caller
from .language import column as column
from .language import composed as composed
from .language import equality as equality
from .language import file_error as file_error
from .language import find_parameter as find_parameter
from .language import group as group
from .language import inequality as inequality
from .language import initial_state as initial_state
from .language import interpolate as interpolate
from .language import is_same_time as is_same_time
from .language import load_problem as load_problem
from .language import load_problem_file as load_problem_file
from .language import load_problems_file as load_problems_file
from .language import match_labels as match_labels
from .language import model_of as model_of
from .language import node_before as node_before
from .language import numbers_of as numbers_of
from .language import over_phase as over_phase
from .language import parameter as parameter
from .language import phase_index as phase_index
from .language import placed_phases as placed_phases
from .language import problem_names as problem_names
from .language import regularize as regularize
from .language import relative as relative
from .language import require_entries as require_entries
from .language import reset as reset
from .language import residual as residual
from .language import rotation as rotation
from .language import run_file as run_file
from .language import split_entries as split_entries
from .language import split_spec as split_spec
from .language import track as track
from .language import transform_state as transform_state
from .reports import BOUNDS as BOUNDS
from .reports import ConstraintReport as ConstraintReport
from .reports import CostReport as CostReport
from .reports import DerivativeCheck as DerivativeCheck
from .reports import Kind as Kind
from .reports import Verification as Verification
from .reports import Violation as Violation
from .reports import check_derivatives as check_derivatives
from .reports import check_fits as check_fits
from .reports import describe as describe
from .reports import early_warnings as early_warnings
from .reports import find_warnings as find_warnings
from .reports import half_turns as half_turns
from .reports import quantity_values as quantity_values
from .reports import report as report
from .reports import verify as verify

__getattr__ = _renamed(
    __name__,
    {
        "Batch": "piaffe.ocp.Vectorised",
        "Finding": "piaffe.ocp.DerivativeCheck",
        "Miss": "piaffe.ocp.Violation",
        "NamedNumber": "piaffe.ocp.Parameters",
        "Notice": "piaffe.ocp.ProblemWarning",
        "check_value": "piaffe.ocp.Parameters.check",
        "find_number": "piaffe.ocp.Parameters.key",
        "named_numbers": "piaffe.ocp.CompiledProblem.parameters",
        "notices": "piaffe.ocp.find_warnings",
    },
)
