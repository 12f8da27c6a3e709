"""Image quality measures of images with contrast, noise and blur in closed form."""

import numpy as np
import pytest
from scipy import ndimage, special

from virtual_phantom.base.errors import InputError
from virtual_phantom.statistics.image_quality import (
    contrast,
    independent_values,
    mean_frequency,
    noise_contrasts,
    noise_magnitude,
    noise_spectrum,
    shape_difference,
    tiles,
)
from virtual_phantom.statistics.resolution import mtf_half, signed_distance_mm

SPACING = (2.0, 0.8, 0.8)
SIGMA_HU = 12.0


def white(repeats, shape=(3, 96, 96), seed=1):
    return np.random.default_rng(np.random.SeedSequence(seed)).normal(0, SIGMA_HU, (repeats, *shape))


def test_contrast_is_exact_and_its_error_is_that_of_the_means():
    rois = {name: np.zeros((3, 96, 96), bool) for name in "abc"}
    image = np.zeros((3, 96, 96))
    for place, (name, hu) in enumerate(zip("abc", (-100.0, 0.0, 50.0), strict=True)):
        rois[name][:, 10:30, 10 + 30 * place : 30 + 30 * place] = True
        image[rois[name]] = hu
    same = np.stack([image, image])
    assert contrast(same, rois).value == pytest.approx((100 + 150 + 50) / 3) and contrast(same, rois).error == 0
    pair = {name: rois[name] for name in "ab"}
    error = contrast(image + white(200), pair).error
    assert error == pytest.approx(SIGMA_HU * np.sqrt(2 / (200 * rois["a"].sum())), rel=0.15)
    assert np.isnan(contrast(image[None], rois).error)
    with pytest.raises(InputError, match="needs two ROIs"):
        contrast(same, {"a": rois["a"]})


def test_white_noise_has_its_magnitude_and_a_flat_spectrum():
    images = 1000 * np.arange(3 * 96 * 96).reshape(3, 96, 96) + white(4)  # structure has no effect
    whole = np.ones(images.shape[1:], bool)
    spectrum = noise_spectrum(images, whole, SPACING)
    flat = SIGMA_HU**2 * SPACING[1] * SPACING[2]
    assert np.abs(spectrum.power - flat).max() < 4 * np.sqrt(spectrum.variance.max())
    frequency = mean_frequency(spectrum)
    assert abs(frequency.value - 1 / (4 * SPACING[1])) < 3 * frequency.error < 0.02  # half of the Nyquist frequency
    assert independent_values(white(40), whole) == pytest.approx(whole.sum(), rel=0.2)
    found = noise_magnitude(images, whole, whole.sum())
    assert abs(found.value - SIGMA_HU) < 3 * found.error
    assert found.error == pytest.approx(SIGMA_HU / np.sqrt(2 * 3 * whole.size), rel=0.05)
    np.testing.assert_allclose(noise_contrasts(images).std(), SIGMA_HU, rtol=0.02)


@pytest.mark.parametrize("sigma_px", [0.8, 1.2])
def test_filtered_noise_has_its_mean_frequency(sigma_px):
    """The spectrum of noise filtered by a Gaussian is exp(-(2 pi sigma f)^2), with mean 1/(2 pi^1.5 sigma)."""
    images = ndimage.gaussian_filter(white(6, (4, 160, 160)), (0, 0, sigma_px, sigma_px), mode="wrap")
    spectrum = noise_spectrum(images, np.ones(images.shape[1:], bool), SPACING)
    sigma = sigma_px * SPACING[1]
    expected = 1 / (2 * np.pi**1.5 * sigma)
    # Without the part beyond the Nyquist frequency.
    nyquist = 1 / (2 * SPACING[1])
    reach = 2 * np.pi * sigma * nyquist
    expected *= -np.expm1(-(reach**2)) / special.erf(reach)
    assert mean_frequency(spectrum).value == pytest.approx(expected, rel=0.02)
    # One independent value in the integral of rho^2.
    many = ndimage.gaussian_filter(white(40, (2, 64, 64)), (0, 0, sigma_px, sigma_px), mode="wrap")
    mask = np.ones(many.shape[1:], bool)
    for where in (mask, mask & (np.arange(64) < 48)):
        assert independent_values(many, where) == pytest.approx(where.sum() / (2 * np.pi * sigma_px**2), rel=0.2)
    assert np.isnan(independent_values(many[:2], mask))


def test_spectra_of_one_noise_differ_by_chance():
    whole = np.ones((3, 96, 96), bool)
    one, other = (noise_spectrum(white(3, seed=seed), whole, SPACING) for seed in (1, 2))
    found = shape_difference(one, other)
    assert found.value < 2 * found.error
    smooth = ndimage.gaussian_filter(white(3, seed=3), (0, 0, 1, 1))
    assert shape_difference(one, noise_spectrum(smooth, whole, SPACING)).value > 5 * found.error


def test_errors_equal_the_scatter_of_many_realizations():
    """Correlated noise: errors from three repeats compared with the scatter of 40 such measurements."""
    whole = np.ones((3, 64, 64), bool)
    rois = {"left": whole & (np.arange(64) < 32), "right": whole & (np.arange(64) >= 32)}
    y, x = np.mgrid[:64, :64] - 31.5
    distance = np.broadcast_to(np.hypot(y, x) * SPACING[1] - 18.3, whole.shape)
    disc = 1000 * ndimage.gaussian_filter((distance < 0).astype(float), (0, 1, 1))
    # Streaks that cross the whole image, of different strengths.
    strengths = np.exp(-np.arange(64) / 16)

    def correlated(repeats, seed):
        streaks = white(repeats, (3, 64, 1), 1000 + seed) * strengths[:, None]
        smooth = ndimage.gaussian_filter(white(repeats, whole.shape, seed), (0, 0.5, 0.8, 0.8), mode="wrap")
        return smooth, smooth + streaks / 2

    independent = independent_values(correlated(12, 100)[1], whole)
    values, errors = [], []
    for seed in range(40):
        images, streaked = correlated(3, seed)
        spectrum = noise_spectrum(images, whole, SPACING)
        measured = [
            contrast(images + disc * rois["left"], rois),
            noise_magnitude(streaked, whole, independent),
            mean_frequency(spectrum),
            mtf_half(images + disc, distance, SPACING, whole),
        ]
        values.append([one.value for one in measured])
        errors.append([one.error for one in measured])
    ratio = np.std(values, axis=0, ddof=1) / np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all((0.7 < ratio) & (ratio < 1.35)), ratio


@pytest.mark.parametrize("sigma_px", [0.7, 1.0, 1.5])
def test_blurred_disc_has_its_resolution(sigma_px):
    """The MTF of a Gaussian is exp(-2 (pi sigma f)^2): one half at sqrt(ln 2 / 2)/(pi sigma)."""
    y, x = np.mgrid[:96, :96] - 47.5 + 0.13
    distance = np.broadcast_to((np.hypot(y, x) - 33.3) * SPACING[1], (3, 96, 96))
    # A straight edge blurred by a Gaussian is an error function; the disc is at least 20 times wider than its blur.
    image = -500 * special.erf(distance / (np.sqrt(2) * sigma_px * SPACING[1]))
    valid = np.ones(image.shape, bool)
    expected = np.sqrt(np.log(2) / 2) / (np.pi * sigma_px * SPACING[1])
    exact = mtf_half(image[None], distance, SPACING, valid)
    assert exact.value == pytest.approx(expected, rel=0.02) and np.isnan(exact.error)
    # The same with a mask of a fifth of the voxel size, as from a phantom.
    y, x = (np.mgrid[: 5 * 96, : 5 * 96] - (5 * 96 - 1) / 2) / 5 + 0.13
    fine = np.broadcast_to(np.hypot(y, x) < 33.3, (3, 5 * 96, 5 * 96))
    measured = signed_distance_mm(fine, SPACING, 5)
    assert np.abs(measured - distance)[np.abs(distance) < 3].max() < 0.2 * SPACING[1]
    assert mtf_half(image[None], measured, SPACING, valid).value == pytest.approx(expected, rel=0.05)


def test_squares_are_disjoint_within_the_mask():
    mask = np.zeros((2, 40, 70), bool)
    mask[:, 3:37, 2:69] = True
    side, corners = tiles(mask)
    assert side == 16 and len(corners) == 2 * 2 * 4
    cover = np.zeros(mask.shape, int)
    for z, y, x in corners:
        cover[z, y : y + side, x : x + side] += 1
    assert cover.max() == 1 and np.all(mask[cover > 0])
    with pytest.raises(InputError, match="fewer than 8 tiles of 8 x 8 voxels"):
        tiles(np.ones((1, 16, 16), bool))


def test_unmeasurable_images_are_reported():
    images = white(2, (3, 32, 32))
    with pytest.raises(InputError, match="there is only one; record at least two"):
        noise_contrasts(images[:1])
    far = np.full(images.shape[1:], 100.0)
    with pytest.raises(InputError, match="too few voxels lie near the edge"):
        mtf_half(images, far, SPACING, np.ones(far.shape, bool))
