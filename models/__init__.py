"""Robots, their dynamics as CasADi models, gaits and the constraints that go with legs."""

from .loaders import load as load
from .robot import Foot as Foot
from .robot import Robot as Robot
