"""Names that were renamed say their new name."""

import re

import pytest

from piaffe import ocp
from piaffe.errors import ModelError


@pytest.mark.parametrize(
    ("old", "new"),
    [("Finding", "piaffe.ocp.DerivativeCheck"), ("Miss", "piaffe.ocp.Violation"), ("Batch", "piaffe.ocp.Vectorised")],
)
def test_a_renamed_name_of_the_language_says_the_new_one(old: str, new: str) -> None:
    told = f"module 'piaffe.ocp': '{old}' was renamed - got '{old}', expected '{new}'; use that"
    with pytest.raises(ImportError, match=re.escape(told)):
        getattr(ocp, old)
    with pytest.raises(ImportError, match=re.escape(told)):
        exec(f"from piaffe.ocp import {old}", {})


def test_renamed_names_of_sampling_say_the_new_ones() -> None:
    with pytest.raises(
        ImportError, match="'LanesEngine' was renamed - .* expected 'piaffe.sampling.engines.SimdEngine'"
    ):
        from piaffe.sampling.engines import LanesEngine  # type: ignore[attr-defined]  # noqa: F401
    with pytest.raises(ImportError, match="'train_value' was renamed - .* expected 'piaffe.sampling.train_value'"):
        from piaffe.sampling.value import train_value  # type: ignore[attr-defined]  # noqa: F401


def test_a_model_with_notices_is_refused() -> None:
    with pytest.raises(ModelError, match="model class 'Old': 'notices' was renamed - .* expected 'warnings'"):
        type("Old", (ocp.ModelBase,), {"notices": lambda self, path: []})


def test_a_model_that_guesses_the_control_of_one_sample_is_refused() -> None:
    expected = (
        r"model class 'Old': 'control_guess' has other arguments now - got control_guess\(self, sample\), expected "
        r"control_guess\(self, nodes, states, p\); return a row per stage, from the targets nodes\[k\].sample"
    )
    with pytest.raises(ModelError, match=expected):
        type("Old", (ocp.ModelBase,), {"control_guess": lambda self, sample: {}})
    for guess in (lambda self, nodes, states, p: {}, lambda self, *arguments: {}):
        type("New", (ocp.ModelBase,), {"control_guess": guess})


def test_the_violations_of_a_verification_were_misses() -> None:
    verification = ocp.Verification(())
    with pytest.raises(AttributeError, match="'misses' was renamed - got 'misses', expected 'violations'"):
        verification.misses  # noqa: B018 (it must raise)
    with pytest.raises(AttributeError, match="'Verification' object has no attribute 'mises'"):
        verification.mises  # noqa: B018 (it must raise)
    assert not hasattr(verification, "misses")
