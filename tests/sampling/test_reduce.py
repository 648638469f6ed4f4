"""Reductions: the same numbers in C and in NumPy, for every layout, as the formulas read."""

import numpy as np
import pytest

from piaffe.errors import ShapeError
from piaffe.sampling.controllers import reduce

SIZES = [(5, 64, 3), (97, 130, 9), (1, 1, 1), (3, 63, 2), (4, 200, 1)]


@pytest.fixture(params=["C", "NumPy"])
def language(request, monkeypatch):
    if request.param == "NumPy":
        monkeypatch.setattr(reduce, "_library", lambda: None)
    elif reduce._library() is None:
        pytest.skip("no C compiler on this machine")


def violations(rows, samples, steps):
    random = np.random.default_rng(2)
    c = np.maximum(random.normal(size=(rows, steps, samples)), 0).transpose(0, 2, 1)
    c[0] = 0.0
    return c


@pytest.mark.parametrize("sizes", SIZES)
def test_maxima(language, sizes):
    c = violations(*sizes)
    np.testing.assert_array_equal(reduce.maxima(c), c.max(axis=(1, 2)))
    np.testing.assert_array_equal(reduce.maxima(np.ascontiguousarray(c)), c.max(axis=(1, 2)))


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("shares", ["one", "rows", "rows and steps"])
def test_discount(language, sizes, shares):
    c, random = violations(*sizes), np.random.default_rng(4)
    rows, _, steps = sizes
    p = {"one": 0.3, "rows": random.uniform(size=rows), "rows and steps": random.uniform(size=(rows, steps))}[shares]
    largest = random.uniform(0.5, 3.0, size=rows)
    each = np.broadcast_to(p if shares == "rows and steps" else np.reshape(p, (-1, 1)), (rows, steps))
    want = np.max(each[:, None] * np.clip(c / largest[:, None, None], 0, 1), axis=0)
    np.testing.assert_allclose(reduce.discount(c, largest, p), want, rtol=1e-14)
    np.testing.assert_allclose(reduce.discount(np.ascontiguousarray(c), largest, p), want, rtol=1e-14)


def test_a_maximum_of_zero_counts_any_violation_in_full(language):
    c = np.array([[[0.0], [1e-9], [2.0]]])
    np.testing.assert_array_equal(reduce.discount(c, [0.0], 0.25), [[0.0], [0.25], [0.25]])


def test_a_row_without_a_share_counts_for_nothing(language):
    c = np.array([[[5.0]], [[1.0]]])
    np.testing.assert_array_equal(reduce.discount(c, [1.0, 2.0], [0.0, 0.5]), [[0.25]])


def test_no_rows_are_no_discount(language):
    assert reduce.maxima(np.zeros((0, 4, 2))).shape == (0,)
    np.testing.assert_array_equal(reduce.discount(np.zeros((0, 4, 2)), np.zeros(0), 0.5), np.zeros((4, 2)))


def test_a_result_in_given_memory(language):
    memory = np.full((3, 64), np.nan)
    delta = reduce.discount(violations(5, 64, 3), np.ones(5), 0.5, out=memory)
    assert np.shares_memory(delta, memory)
    assert np.isfinite(memory).all()


def test_shapes_are_checked():
    c = np.zeros((5, 4, 2))
    with pytest.raises(ShapeError, match=r"violation does not fit - got \(4, 2\), expected \(nc, n, S\)"):
        reduce.maxima(c[0])
    with pytest.raises(ShapeError, match=r"discount: c_max does not fit - got \(4,\), expected \(5,\)"):
        reduce.discount(c, np.ones(4), 0.5)
    with pytest.raises(ShapeError, match=r"p_max does not fit - got \(2,\), expected \(\) or \(5,\) or \(5, 2\)"):
        reduce.discount(c, np.ones(5), np.ones(2))
    with pytest.raises(ShapeError, match=r"out does not fit - got \(4, 2\), expected \(2, 4\)"):
        reduce.discount(c, np.ones(5), 0.5, out=np.zeros((4, 2)))
