"""``python -m piaffe.cli``: the command line without its script."""

import sys

from .app import main

sys.exit(main())
