"""Robots by name or from URDF files: one module for each known robot."""

from .description import build_model as build_model
from .description import leaf_frames as leaf_frames
from .description import locate as locate
from .feet import crossed_feet as crossed_feet
from .known import KnownRobot as KnownRobot
from .known import names as names
from .load import load as load
from .load import unclear_base as unclear_base
from .recipes import robot_from_recipe as robot_from_recipe
from .recipes import robot_recipe as robot_recipe
