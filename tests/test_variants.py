"""Changes of one image property at a time, against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from virtual_phantom.base.errors import InputError
from virtual_phantom.features import variants


def scan(seed=0, repeats=6, shape=(12, 24, 24), sd=10.0):
    """A cube of 100 HU in 20 HU, with white noise."""
    rng = np.random.default_rng(seed)
    truth = np.full(shape, 20.0)
    truth[3:-3, 6:-6, 6:-6] = 100
    return truth, truth + sd * rng.normal(size=(repeats, *shape))


def autocorrelation(noise, distance, axis):
    """Autocorrelation over all repeats [repeat, z, y, x], away from the edges."""
    near = noise.take(range(0, noise.shape[axis] - distance), axis)
    far = noise.take(range(distance, noise.shape[axis]), axis)
    return (near * far).mean() / (noise**2).mean()


def test_mean_and_noise_add_up_to_the_images():
    truth, images = scan()
    for noiseless in (None, truth):
        mean, noise = variants.split(images, noiseless)
        assert np.allclose(mean + noise, images)
    mean, noise = variants.split(images)
    assert np.allclose(noise.mean(axis=0), 0) and np.allclose(mean, images.mean(axis=0))
    assert np.allclose(noise.var(axis=0, ddof=1), images.var(axis=0, ddof=1))


@settings(max_examples=15, deadline=None)
@given(factor=st.floats(0, 5), seed=st.integers(0, 20))
def test_amplitude_scales_the_variance_over_repeats_by_its_square(factor, seed):
    _, images = scan(seed, 3, (4, 6, 6))
    changed = variants.scale_noise(*variants.split(images), factor)
    assert np.allclose(changed.var(axis=0, ddof=1), factor**2 * images.var(axis=0, ddof=1))
    assert np.allclose(changed.mean(axis=0), images.mean(axis=0))


@pytest.mark.parametrize("sigma", [(0, 1.0, 1.0), (0.8, 1.5, 1.5)])
def test_texture_has_a_gaussian_autocorrelation_and_the_same_variance(sigma):
    truth, images = scan(repeats=10, shape=(40, 60, 60))
    mean, noise = variants.split(images, truth)
    changed = variants.filter_noise(mean, noise, sigma) - mean
    assert (changed**2).mean() == pytest.approx((noise**2).mean())
    inside = changed[:, 10:-10, 10:-10, 10:-10]
    for axis, width in enumerate(sigma, start=1):
        for distance in (1, 2, 3):
            # A sampled Gaussian of 0.8 voxels differs by 0.5 % from the closed form.
            expected = np.exp(-(distance**2) / (4 * width**2)) if width else 0.0
            assert autocorrelation(inside, distance, axis) == pytest.approx(expected, abs=0.02)


def test_texture_keeps_the_variance_on_request_and_the_mean_everywhere():
    _, images = scan()
    images[:, :, :12] += 40 * np.random.default_rng(1).normal(size=images[:, :, :12].shape)
    mean, noise = variants.split(images)
    within = np.zeros(mean.shape, bool)
    within[4:8, 16:20, 8:16] = True
    changed = variants.filter_noise(mean, noise, 1.0, within)
    assert (changed - mean)[:, within].var() == pytest.approx(noise[:, within].var(), rel=0.02)
    assert ((changed - mean)[:, within] ** 2).mean() == pytest.approx((noise[:, within] ** 2).mean())
    assert np.allclose(changed.mean(axis=0), mean)
    assert np.allclose(variants.filter_noise(mean, noise, 0), images)


def test_blur_widens_an_edge_and_keeps_the_noise():
    """A step becomes the normal distribution function."""
    from scipy.stats import norm

    truth = np.zeros((3, 5, 41))
    truth[..., 20:] = 100.0
    noise = np.random.default_rng(2).normal(size=(4, *truth.shape))
    changed = variants.blur(truth, noise, (0, 0, 2.5))
    edge = (changed - noise)[0, 1, 2]
    assert edge == pytest.approx(100 * norm.cdf((np.arange(41) - 19.5) / 2.5), abs=0.2)
    assert np.allclose(changed.var(axis=0), noise.var(axis=0))


MEAN, NOISE = variants.split(scan(shape=(3, 4, 5))[1])
ALL = np.ones(MEAN.shape, bool)


@pytest.mark.parametrize(
    "call, message",
    [
        (lambda: variants.split(MEAN[None]), "images of shape (1, 3, 4, 5); give at least 2 repeats"),
        (lambda: variants.split(NOISE, MEAN[:2]), "the noiseless image has shape (2, 4, 5), the repeats (3, 4, 5)"),
        (lambda: variants.split(NOISE * np.nan), "voxels that are not finite"),
        (lambda: variants.scale_noise(MEAN, NOISE, -1), "the noise factor is -1"),
        (lambda: variants.blur(MEAN, NOISE, (1, -1, 1)), "sigma is (1, -1, 1)"),
        (lambda: variants.filter_noise(MEAN, NOISE, 1, ALL[:2]), "the mask of shape (2, 4, 5) is empty or"),
        (lambda: variants.filter_noise(MEAN, NOISE, 1, ~ALL), "is empty or of another shape"),
        (lambda: variants.filter_noise(MEAN, 0 * NOISE, 1), "there is no noise; give"),
    ],
)
def test_bad_input_is_one_clear_line(call, message):
    with pytest.raises(InputError) as caught:
        call()
    assert message in str(caught.value) and "\n" not in str(caught.value)
