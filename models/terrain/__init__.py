"""Terrains: the height of the ground as CasADi expressions and NumPy arrays, and the same ground as MuJoCo geoms."""

from .base import Terrain as Terrain
from .base import fitted_slope as fitted_slope
from .blocks import Boxes as Boxes
from .blocks import Stairs as Stairs
from .box import Box as Box
from .expressions import SurfaceExpression as SurfaceExpression
from .expressions import clear_expression as clear_expression
from .expressions import side_expression as side_expression
from .expressions import standing_expression as standing_expression
from .expressions import surface_expression as surface_expression
from .heightfield import HeightField as HeightField
from .make import boxes as boxes
from .make import checked_terrain as checked_terrain
from .make import flat as flat
from .make import from_recipe as from_recipe
from .make import heightfield as heightfield
from .make import incline as incline
from .make import stairs as stairs
from .numbers import FLOOR as FLOOR
from .planes import Flat as Flat
from .planes import Incline as Incline
