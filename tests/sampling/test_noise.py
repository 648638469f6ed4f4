from concurrent.futures import ThreadPoolExecutor

import numpy as np

from piaffe.sampling.controllers.noise import Noise


def test_arrays_drawn_ahead_are_those_of_one_generator():
    random = np.random.default_rng(3)
    with ThreadPoolExecutor(1) as pool:
        noise = Noise(3, (5, 4, 2), pool)
        for _ in range(3):
            drawn = noise()
            assert np.array_equal(drawn[:, 1:], random.standard_normal((5, 3, 2)))
            assert np.all(drawn[:, 0] == 0.0)  # node 0 is being applied
            drawn[:] = 0.0  # it is the caller's
