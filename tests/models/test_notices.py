"""Warnings about a motion's targets."""

import pytest

from piaffe import models


@pytest.mark.parametrize("gait", ["bound", "pronk"])
def test_motions_without_keyframes_have_no_warnings(gait: str) -> None:
    body = models.WholeBody(models.load("mini_cheetah"))
    motion = getattr(models.gaits, gait)(0.5)
    assert body.notices(motion.bind((body,), body.state.unpack(body.state()))) == []
