"""Errors cross from process to process, as those of a study do."""

import pickle

from piaffe.errors import UnknownNameError


def test_an_unknown_name_survives_pickling() -> None:
    error = UnknownNameError("robot 'go2'", "joint", "hip", ["FL_hip_joint", "FL_calf_joint"])
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.known, again.hint) == (str(error), error.known, error.hint)
