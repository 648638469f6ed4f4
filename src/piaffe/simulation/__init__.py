"""Closed-loop episodes of a controller on a MuJoCo plant."""

from piaffe.ocp import Policy as Policy
from piaffe.ocp import interpolate as interpolate
from piaffe.ocp import node_before as node_before
from piaffe.ocp import phase_index as phase_index

from .closed_loop import Progress as Progress
from .closed_loop import run_episode as run_episode
from .controller import Controller as Controller
from .controller import Judgement as Judgement
from .controller import Plan as Plan
from .controller import TickingController as TickingController
from .deviation import Deviation as Deviation
from .episode import Episode as Episode
from .execution import Execution as Execution
from .execution import Trial as Trial
from .execution import declared_friction as declared_friction
from .execution import execute as execute
from .forces import foot_forces as foot_forces
from .perturbation import Perturbation as Perturbation
from .plant import MAX_SPEED as MAX_SPEED
from .plant import Plant as Plant
from .policy_controller import PolicyController as PolicyController
from .policy_controller import PolicyPlan as PolicyPlan
from .policy_run import Control as Control
from .policy_run import PolicyRun as PolicyRun
from .policy_run import run_policy as run_policy
from .policy_run import torque_plant as torque_plant
from .spread import Spread as Spread
