"""Value functions: learnt from what a controller did, used where its horizon ends."""

from .collect import CollectOptions as CollectOptions
from .collect import collect as collect
from .dataset import Dataset as Dataset
from .dataset import Records as Records
from .fingerprint import fingerprint as fingerprint
from .inputs import FEATURES as FEATURES
from .inputs import Feature as Feature
from .inputs import ValueInputs as ValueInputs
from .network import Layer as Layer
from .network import Network as Network
from .options import LearnOptions as LearnOptions
from .store import Value as Value
from .store import load_value as load_value
from .train import train_value as train_value
from .transitions import Transitions as Transitions
