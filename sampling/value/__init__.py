"""Value functions: learnt from what a controller did, used where its horizon ends."""

from .network import Layer as Layer
from .network import Network as Network
from .options import LearnOptions as LearnOptions
from .transitions import Transitions as Transitions
