"""Keep the checkout off ``sys.path``, so that ``import ocp`` cannot load a second copy of ``piaffe.ocp``.

``python -m pytest`` puts the working directory there; ``pytest`` alone does not.
"""

import sys
from pathlib import Path

_CHECKOUT = Path(__file__).resolve().parent

sys.path[:] = [entry for entry in sys.path if Path(entry or ".").resolve() != _CHECKOUT]
