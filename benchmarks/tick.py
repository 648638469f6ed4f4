"""Time a tick of the low level on a bound: in C, called from Python, and in NumPy.

Mini Cheetah bounds; states are off the plan at random. The time includes the call from Python and the result's copy.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
from common import arguments, surroundings, tell
from qp import bound, states

from piaffe import solvers

TICKS = {"native": 5000, "numpy": 200}


def main(repeats: int = 5, json: bool = False, save: bool = False) -> dict[str, Any]:
    """Print and return median and 99th percentile of a tick [µs]."""
    plan = bound()
    results: dict[str, Any] = {"benchmark": "tick", "ticks": TICKS, "repeats": repeats, "us": {}}
    for backend in ("native", "numpy"):
        controller = solvers.Vwbc(plan, backend=backend)
        told = states(plan, TICKS[controller.backend])
        least = np.full(len(told), np.inf)
        for _ in range(repeats):
            for i, (x, t) in enumerate(told):
                began = perf_counter()
                controller.control(x, t)
                least[i] = min(least[i], perf_counter() - began)
        middle, high = np.percentile(1e6 * least, [50, 99])
        results["us"][controller.backend] = {"median": round(float(middle), 2), "p99": round(float(high), 2)}
    results |= surroundings()
    lines = [f"a tick of Vwbc; µs\n{'':8}{'median':>8}{'99 %':>8}"]
    lines += [f"{name:8}{each['median']:8.1f}{each['p99']:8.1f}" for name, each in results["us"].items()]
    tell(results, lines, json=json, save=save)
    return results


if __name__ == "__main__":
    options = arguments(__doc__ or "", 5).parse_args()
    main(**vars(options))
