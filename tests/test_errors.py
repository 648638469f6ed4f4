"""Errors cross from process to process, as those of a study do."""

import pickle

import pytest

from piaffe.codegen.processes import CompileError
from piaffe.errors import ModelError, PiaffeError, UnknownNameError


def test_an_unknown_name_survives_pickling() -> None:
    error = UnknownNameError("robot 'go2'", "joint", "hip", ["FL_hip_joint", "FL_calf_joint"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.known, again.hint) == (str(error), error.known, error.hint)


@pytest.mark.parametrize(
    "error",
    [
        ModelError("text"),
        UnknownNameError("where", "frame", "FL", ["FR", "HL"]),
        CompileError("text", "unit", "output"),
    ],
)
def test_errors_survive_the_way_between_processes(error: PiaffeError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)
