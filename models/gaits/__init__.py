"""Gaits: cyclic motions that name feet by their roles, with a reference that follows a velocity command."""

from .patterns import bound as bound
from .patterns import flying_pace as flying_pace
from .patterns import flying_trot as flying_trot
from .patterns import gait as gait
from .patterns import pace as pace
from .patterns import pronk as pronk
from .patterns import trot as trot
from .patterns import walk as walk
from .reference import BoundGait as BoundGait
from .reference import GaitReference as GaitReference
