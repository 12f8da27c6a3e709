"""Noise, texture and dose law of the image model against closed forms, and against the printed phantom's features."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.streams import below, root
from virtual_phantom.image_model.dose import DoseLaw
from virtual_phantom.image_model.fitting import Measured, fit_noise
from virtual_phantom.image_model.noise import NoiseModel
from virtual_phantom.image_model.region import Blur, RegionModel
from virtual_phantom.image_model.scanner import FBP, ImageScanner, features_of
from virtual_phantom.phantom.texture import Component

SPACING = (1.0, 0.7, 0.7)  # mm
NOISE = NoiseModel(2.7, 5.0, 0.15, 0.8)
BLUR = Blur(3.0, 5.0, 0.8)


def ball(radius_mm, spacing=SPACING):
    axes = [np.arange(-np.ceil(radius_mm / step), np.ceil(radius_mm / step) + 1) * step for step in spacing]
    return sum(axis**2 for axis in np.ix_(*axes)) <= radius_mm**2


def test_noise_has_the_power_spectrum_of_its_equation():
    shape = (48, 96, 96)
    power = np.zeros((96, 96))
    for repeat in range(12):
        planes = NOISE.sample(shape, SPACING, below(root(1), repeat))
        power += (np.abs(np.fft.fft2(planes - planes.mean(axis=(1, 2), keepdims=True))) ** 2).mean(axis=0)
    f = np.hypot(*np.meshgrid(*[np.fft.fftfreq(96, 0.7)] * 2))
    expected = (f + 0.015) * np.exp(
        -2 * np.log(2) * (f * 10 / 2.7) ** (np.log(np.log(10) / np.log(2)) / np.log(5 / 2.7))
    )
    rings = np.digitize(f, np.arange(0.03, 0.6, 0.04))
    measured = np.array([power[rings == ring].mean() for ring in range(1, 14)])
    truth = np.array([expected[rings == ring].mean() for ring in range(1, 14)])
    assert measured / measured.sum() == pytest.approx(truth / truth.sum(), abs=0.004)


def test_noise_has_variance_one_and_the_correlation_of_its_slice_profile_along_z():
    fields = [NOISE.sample((64, 64, 64), SPACING, below(root(2), repeat)) for repeat in range(8)]
    variance = np.mean([field.var() for field in fields])
    assert variance == pytest.approx(1, abs=0.02)
    for slices in (1, 2):
        product = np.mean([(field[slices:] * field[:-slices]).mean() for field in fields])
        # A Gaussian profile of SD s gives the autocorrelation exp(-z^2 / (4 s^2)).
        assert product / variance == pytest.approx(np.exp(-(slices**2) / (4 * 0.8**2)), abs=0.01)


def test_varying_amplitude_keeps_the_variance_and_gives_a_known_kurtosis():
    noise = NoiseModel(2.7, 5.0, 0.15, 0.8, log_amplitude_sd=0.3)
    values = np.concatenate([noise.sample((64, 64, 64), SPACING, below(root(3), k)).ravel() for k in range(12)])
    assert values.var() == pytest.approx(1, abs=0.03)
    # E n^4 = 3 E exp(4 m g - 4 m^2) = 3 exp(4 m^2) for Gaussian n and g of variance 1
    assert stats.kurtosis(values, fisher=False) == pytest.approx(3 * np.exp(4 * 0.3**2), rel=0.06)


@given(dose=st.floats(0.5, 30), factor=st.floats(0.3, 3))
def test_quantum_noise_is_proportional_to_the_factor_over_dose(dose, factor):
    law = DoseLaw({1.0: 900.0, 3.0: 300.0, 10.0: 90.0})
    assert law.variance(dose, factor) == pytest.approx(900 * factor / dose, rel=1e-9)
    assert list(law.exponents().values()) == pytest.approx([1, 1])


def test_the_dose_law_passes_through_its_points_and_lowers_differences_at_low_dose():
    law = DoseLaw({1.0: 1160.0, 3.0: 650.0, 10.0: 275.0})
    assert [law.variance(dose) for dose in (1, 3, 10)] == pytest.approx([1160, 650, 275])
    assert law.variance(1, 1.3) / law.variance(1) < law.variance(10, 1.3) / law.variance(10)
    assert law.exponents()[1.0, 3.0] == pytest.approx(np.log(1160 / 650) / np.log(3))


@pytest.mark.parametrize("variances", [{1.0: 5.0}, {1.0: 5.0, 3.0: 0.0}, {0.0: 5.0, 3.0: 1.0}])
def test_a_dose_law_needs_positive_variances_at_two_doses(variances):
    with pytest.raises(InputError, match="two or more"):
        DoseLaw(variances)


def test_texture_has_mean_zero_and_its_variance_inside_the_region():
    mask = ball(12)
    region = RegionModel(1.0, Component(12, 2.0, 1.5), Component(5, 8.0))
    texture = np.stack([region.texture(mask, SPACING, BLUR, below(root(4), k))[mask] for k in range(20)])
    assert texture.mean(axis=1) == pytest.approx(0, abs=1e-4)
    assert texture.var(axis=1).mean() == pytest.approx(12**2 + 5**2, rel=0.03)  # both components are independent
    assert stats.skew(texture, axis=1).mean() > 0.5


def test_images_of_a_dose_have_the_mean_and_the_variance_of_the_law():
    mask = ball(14)
    scanner = ImageScanner(SPACING, BLUR, {FBP: NOISE}, {FBP: DoseLaw({1.0: 900.0, 10.0: 90.0})})
    region = RegionModel(1.2, Component(0, 1.0), Component(6, 9.0))
    images = np.stack([image[mask] for image in scanner.images(region, mask, 40.0, FBP, 3.0, root(5), range(12))])
    assert images.mean(axis=1) == pytest.approx(40, abs=1e-3)
    assert images.var(axis=1).mean() == pytest.approx(300 * 1.2 + 36, rel=0.04)


def test_fitted_noise_predicts_features_of_other_noise_like_the_true_model():
    """The fit sees features of a ball of 7,000 voxels; the noise of data, fit and comparison differs."""
    mask, pattern = ball(9), Component(0.5, 10.0)
    scanner = ImageScanner(SPACING, BLUR, {FBP: NOISE}, {FBP: DoseLaw({1.0: 400.0, 2.0: 400.0})})
    region = RegionModel(1.0, Component(0, 1.0), pattern)
    table = scanner.features(region, mask, 0.0, FBP, 1.0, root(6), range(12))
    known = Measured(table.mean(), table.std())
    start = NoiseModel(1.7, 4.0, 0.15, 1.2, 0.05)
    fitted, _ = fit_noise(known, mask, SPACING, root(7), pattern=pattern, start=start, realizations=2, evaluations=70)

    def misfit(noise):
        other = ImageScanner(SPACING, BLUR, {FBP: noise}, {FBP: DoseLaw({1.0: 400.0, 2.0: 400.0})})
        return known.misfit(other.features(region, mask, 0.0, FBP, 1.0, root(9), range(4)))

    excess = {noise: misfit(noise) - misfit(NOISE) for noise in (start, fitted)}
    assert excess[start] > 1
    assert excess[fitted] < 0.25 * excess[start]


def test_features_are_those_of_the_study():
    mask = ball(6)
    table = features_of([NOISE.sample(mask.shape, SPACING, root(8)) * 20], mask, SPACING)
    assert table.shape == (1, 86)
