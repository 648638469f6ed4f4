"""Robots in MuJoCo: scenes, and MuJoCo as a model of a problem's schedule."""

from .action import BoundAction as BoundAction
from .action import joint_targets as joint_targets
from .action import torques as torques
from .contact import SoftContact as SoftContact
from .model import Fall as Fall
from .model import Mujoco as Mujoco
from .payload import Payload as Payload
from .payload import payload as payload
from .scene import body_names as body_names
from .scene import mujoco_model as mujoco_model
from .scene import mujoco_spec as mujoco_spec
from .scene import restore_inertias as restore_inertias
