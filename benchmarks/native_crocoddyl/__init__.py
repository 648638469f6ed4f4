"""Crocoddyl built from its source distribution for a given processor, and a program that times it."""
