"""Piaffe: declare a motion of a legged robot once; optimise it and sample it from the same declaration."""

from .errors import PiaffeWarning as PiaffeWarning

__version__ = "0.1.0"
