"""The array namespace, with which one function works on arrays of NumPy and of JAX."""

from __future__ import annotations

from typing import Any

import numpy as np


def namespace(array: Any) -> Any:
    """Return the module with an array's functions: ``jax.numpy`` for arrays of JAX and within ``jit``, else ``numpy``.

    Args:
        array: an array, or anything that NumPy can convert to an array.
    """
    return array.__array_namespace__() if hasattr(array, "__array_namespace__") else np
