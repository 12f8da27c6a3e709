"""Polychromatic transmission through path lengths, against sums of exponentials in double precision."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from virtual_phantom.physics.beam.transmission import BLOCK, MANY, polychromatic_signal


def close_to(paths, attenuation_per_mm):
    """Whether the relative error is within the docstring's limit."""
    return 2e-7 * (1 + np.einsum("me,m...->e...", attenuation_per_mm, np.abs(paths.astype(np.float64))).max())


def directly(paths, attenuation_per_mm, shares):
    left = np.exp(-np.einsum("me,mvrc->evrc", attenuation_per_mm, paths.astype(np.float64)))
    return np.einsum("serc,evrc->svrc" if shares.ndim > 2 else "se,evrc->svrc", shares, left)


def drawn(random, materials, energies, shape, of_pixels):
    paths = (random.random((materials, *shape)) * 300).astype(np.float32)
    attenuation = random.uniform(0.001, 0.08, (materials, energies))
    shares = random.random((2, energies, *(shape[1:] if of_pixels else ())))
    return paths, attenuation, shares / shares.sum(axis=1, keepdims=True)


@given(
    seed=st.integers(0, 2**32 - 1),
    materials=st.integers(1, 3),
    energies=st.integers(1, 30),
    views=st.integers(1, 3),
    columns=st.integers(1, BLOCK + 70),
    of_pixels=st.booleans(),
)
def test_transmission_is_the_sum_of_exponentials(seed, materials, energies, views, columns, of_pixels):
    """For numbers of rays that fill blocks, and others."""
    paths, attenuation, shares = drawn(np.random.default_rng(seed), materials, energies, (views, 2, columns), of_pixels)
    np.testing.assert_allclose(
        polychromatic_signal(paths, attenuation, shares),
        directly(paths, attenuation, shares),
        rtol=close_to(paths, attenuation),
        atol=1e-37,
    )


def test_weights_of_single_rows_and_columns():
    """A filter that is constant along rows or columns has one weight for all of them."""
    random = np.random.default_rng(1)
    paths, attenuation, shares = drawn(random, 2, 9, (3, 4, 5), of_pixels=True)
    for thin in (shares[..., :1], shares[..., :1, :]):
        whole = np.broadcast_to(thin, shares.shape)
        assert np.array_equal(
            polychromatic_signal(paths, attenuation, thin), polychromatic_signal(paths, attenuation, whole)
        )


@pytest.mark.parametrize("of_pixels", [False, True])
def test_threads_do_not_change_the_result(of_pixels):
    random = np.random.default_rng(2)
    paths, attenuation, shares = drawn(random, 2, 9, (2, 7, MANY * BLOCK // 7), of_pixels)
    one, three = (polychromatic_signal(paths, attenuation, shares, threads) for threads in (1, 3))
    assert np.array_equal(one, three)


@pytest.mark.parametrize("length_mm", [-3.0, 0.0, 1e-4, 870.0, 1e6])
def test_limits_of_path_lengths(length_mm):
    """Extrapolated rays may have slightly negative lengths, and the whole beam may be absorbed."""
    paths, attenuation = np.full((1, 1, 1, 1), length_mm, np.float32), np.array([[0.1]])
    found = polychromatic_signal(paths, attenuation, np.ones((1, 1)))
    np.testing.assert_allclose(found, np.exp(-0.1 * paths.astype(float)), rtol=close_to(paths, attenuation), atol=2e-38)
