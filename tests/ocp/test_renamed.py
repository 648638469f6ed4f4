"""Names that were renamed say their new name."""

import re

import pytest

from piaffe import ocp


@pytest.mark.parametrize(
    ("old", "new"),
    [("Finding", "piaffe.ocp.DerivativeCheck"), ("Miss", "piaffe.ocp.Violation"), ("Batch", "piaffe.ocp.Vectorised")],
)
def test_a_renamed_name_of_the_language_says_the_new_one(old: str, new: str) -> None:
    told = f"module 'piaffe.ocp': '{old}' was renamed - got '{old}', expected '{new}'; use that"
    with pytest.raises(AttributeError, match=re.escape(told)):
        getattr(ocp, old)


def test_the_violations_of_a_verification_were_misses() -> None:
    verification = ocp.Verification(())
    with pytest.raises(AttributeError, match="'misses' was renamed - got 'misses', expected 'violations'"):
        verification.misses  # noqa: B018 (it must raise)
    with pytest.raises(AttributeError, match="'Verification' object has no attribute 'mises'"):
        verification.mises  # noqa: B018 (it must raise)
    assert not hasattr(verification, "misses")
