"""Gaits: cyclic motions in the roles of feet, with references that follow a command."""

from .patterns import bound as bound
from .patterns import flying_pace as flying_pace
from .patterns import flying_trot as flying_trot
from .patterns import gait as gait
from .patterns import pace as pace
from .patterns import pronk as pronk
from .patterns import trot as trot
from .reference import BoundGait as BoundGait
from .reference import GaitReference as GaitReference
