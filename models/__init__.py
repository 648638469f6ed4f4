"""Robots, their dynamics as CasADi models, gaits and the constraints that go with legs."""

from . import gaits as gaits
from .constraints import base_height as base_height
from .constraints import foot_clearance as foot_clearance
from .constraints import friction_cone as friction_cone
from .constraints import joint_limits as joint_limits
from .constraints import joint_speed_limits as joint_speed_limits
from .constraints import torque_limits as torque_limits
from .doctor import diagnose as diagnose
from .doctor_urdf import Finding as Finding
from .kinematics import Kinematics as Kinematics
from .loaders import load as load
from .mujoco_scene import mujoco_model as mujoco_model
from .mujoco_scene import mujoco_spec as mujoco_spec
from .quantities import base as base
from .quantities import com as com
from .quantities import feet as feet
from .quantities import frames as frames
from .quantities import joints as joints
from .quantities import momentum as momentum
from .recipes import robot_from_recipe as robot_from_recipe
from .robot import Foot as Foot
from .robot import Robot as Robot
from .single_rigid_body import SingleRigidBody as SingleRigidBody
from .stance import Stance as Stance
from .stance import stance as stance
from .whole_body import WholeBody as WholeBody
