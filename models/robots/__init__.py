"""Robots by name or from URDF files: one module for each known robot."""

from .load import build_model as build_model
from .load import leaf_frames as leaf_frames
from .load import load as load
from .load import locate as locate
from .load import names as names
from .recipes import robot_from_recipe as robot_from_recipe
from .recipes import robot_recipe as robot_recipe
