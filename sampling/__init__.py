"""Sampling controllers on MuJoCo rollouts of a declared problem; empty until the first of them is written."""
