"""The handover of plans between two threads of C: nothing is torn, nothing is overwritten while it is used."""

import ctypes as ct
from importlib.resources import files
from pathlib import Path

from piaffe.codegen import build, load


def test_two_threads_hand_over_thousands_of_arrays_and_none_is_torn():
    header = files("piaffe.solvers.receding").joinpath("template", "handover.h").read_text(encoding="utf-8")
    text = Path(__file__).with_name("handover_stress.c").read_text(encoding="utf-8")
    library = load(build([("stress", text)], headers={"handover.h": header}, link=("-pthread",), width=1))
    library.stress.restype, library.stress.argtypes = ct.c_long, (ct.c_uint64, ct.c_void_p)
    seen = ct.c_long()
    assert library.stress(50_000, ct.byref(seen)) == 0
    assert 1 <= seen.value <= 50_000
