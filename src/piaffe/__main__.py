"""``python -m piaffe``: the command line without its script."""

import sys

from piaffe.cli.app import main

sys.exit(main())
