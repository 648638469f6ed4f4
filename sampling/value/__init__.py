"""Value functions: the expected return after the end of a controller's horizon."""

from piaffe.errors import renamed as _renamed

from .fingerprint import Entries as Entries
from .fingerprint import differences as differences
from .fingerprint import fingerprint as fingerprint
from .fingerprint import plain as plain
from .inputs import FEATURES as FEATURES
from .inputs import Feature as Feature
from .inputs import ValueInputs as ValueInputs
from .network import EPSILON as EPSILON
from .network import HIDDEN as HIDDEN
from .network import Layer as Layer
from .network import Network as Network
from .network import Single as Single
from .store import Precision as Precision
from .store import Served as Served
from .store import Value as Value
from .store import digest as digest
from .store import load_value as load_value
from .traced import numbers_of as numbers_of
from .traced import traced_value as traced_value

__getattr__ = _renamed(
    __name__,
    {
        "train_value": "piaffe.sampling.train_value",
        "CollectOptions": "piaffe.sampling.CollectOptions",
        "LearnOptions": "piaffe.sampling.LearnOptions",
        "collect": "piaffe.sampling.learning.collect.collect",
        "Dataset": "piaffe.sampling.learning.dataset.Dataset",
        "Records": "piaffe.sampling.learning.dataset.Records",
        "Transitions": "piaffe.sampling.learning.transitions.Transitions",
    },
)
