"""The command line: ``piaffe COMMAND``."""

from .app import main as main
