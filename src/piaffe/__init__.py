"""Piaffe: declare a legged motion once; optimise, control, sample and export it."""

__version__ = "0.1.0"
