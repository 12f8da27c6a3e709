"""Deconvolution of a scanned phantom's own blur: closed forms of Gaussians, and added noise."""

import numpy as np
import pytest
from scipy.special import ndtr

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom.ct import resample
from virtual_phantom.phantom.deconvolution import (
    SD_OF_HALF,
    PowerSpectra,
    add_voxel_blur,
    deconvolve,
    keep_air,
    measure_spectra,
)
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.statistics.surface_resolution import edge_mtf_half

GRID = Grid((40, 96, 96), (0.75, 0.7, 0.7), (0.0, 0.0, 0.0))
OWN = (0.42, 0.6, 0.6)  # SD along z, y, x, mm
NO_NOISE = PowerSpectra((1.0, 0.67), np.ones((16, 8)), np.zeros((16, 8)))


def blob(*sd_mm):
    """A Gaussian of unit mass."""
    z, y, x = (np.exp(-((axis / sd) ** 2) / 2) / sd for axis, sd in zip(GRID.axes_mm(), sd_mm, strict=True))
    return z[:, None, None] * y[:, None] * x


def second_moments(array):
    squares = np.ix_(*(axis**2 for axis in GRID.axes_mm()))
    return [float((array * square).sum() / array.sum()) for square in squares]


def test_deconvolved_scan_of_a_scan_has_one_blur():
    """Variances of Gaussians add: an object of 2 mm, and the blur of its scanner."""
    seen = Volume(blob(*np.hypot(2.0, OWN)).astype(np.float32), GRID)
    np.testing.assert_allclose(second_moments(seen.array), 4 + np.square(OWN), rtol=0.01)
    restored = deconvolve(seen, OWN, NO_NOISE)
    np.testing.assert_allclose(second_moments(restored.array), [4.0] * 3, rtol=0.01)


def test_waves_regain_the_contrast_lost_to_the_mtf():
    _, _, x = GRID.axes_mm()
    for cycles in (4, 12, 20):
        frequency = cycles / (96 * 0.7)
        wave = np.broadcast_to(np.sin(2 * np.pi * frequency * x), GRID.shape)
        mtf = np.exp(-2 * (np.pi * 0.6 * frequency) ** 2)
        restored = deconvolve(Volume((mtf * wave).astype(np.float32), GRID), OWN, NO_NOISE)
        np.testing.assert_allclose(restored.array, wave, atol=2e-3)


def edge(sd_mm, seed=None):
    """A blurred disc of 22 mm."""
    _, y, x = np.ix_(*GRID.axes_mm())
    hu = -1000 + 1040 * ndtr((22 - np.hypot(x, y)) / sd_mm) + 0 * GRID.axes_mm()[0][:, None, None]
    noise = 0 if seed is None else np.random.default_rng(seed).normal(0, 5, GRID.shape)
    return Volume((hu + noise).astype(np.float32), GRID)


@pytest.mark.parametrize("sd_mm", [0.6, 0.9])
def test_blur_is_measured_at_the_surface_to_air(sd_mm):
    assert SD_OF_HALF / edge_mtf_half(edge(sd_mm, seed=1)) == pytest.approx(sd_mm, rel=0.07)


def test_surface_becomes_as_sharp_as_before():
    sharp = deconvolve(edge(1.0), OWN, NO_NOISE)
    assert SD_OF_HALF / edge_mtf_half(sharp) == pytest.approx(0.8, rel=0.07)  # 1.0^2 - 0.6^2 = 0.8^2
    air = edge(1.0).array < -999
    stored = keep_air(sharp, Volume(np.where(air, -1000, 0).astype(np.float32), GRID))
    assert stored.array.min() == -1000 and (stored.array[air] == -1000).all()


def test_noise_is_removed_and_not_amplified():
    """Coarse texture of 10 HU under white noise of 6 HU: the result is closer to the texture than the mean image is."""
    rng = np.random.default_rng(7)
    frequencies = np.ix_(*(np.fft.fftfreq(size, step) for size, step in zip(GRID.shape, GRID.spacing, strict=True)))
    squares = sum(frequency**2 for frequency in frequencies)

    def blurred(array, sd):
        return np.fft.ifftn(np.fft.fftn(array) * np.exp(-2 * np.pi**2 * sd**2 * squares)).real

    texture = blurred(rng.normal(size=GRID.shape), 1.5)
    texture *= 10 / texture.std()
    mean = blurred(texture, 0.6) + rng.normal(0, 6, GRID.shape)
    measured = measure_spectra(mean, rng.normal(0, 6, GRID.shape), GRID.spacing)
    restored = deconvolve(Volume(mean.astype(np.float32), GRID), (0.6, 0.6, 0.6), measured).array
    assert np.sqrt(np.mean((restored - texture) ** 2)) < 0.6 * np.sqrt(np.mean((mean - texture) ** 2))
    again = PowerSpectra.from_table(measured.table())
    np.testing.assert_allclose([*again.most_per_mm], measured.most_per_mm)
    np.testing.assert_array_equal(again.noise, measured.noise)


def test_white_noise_has_its_power():
    """White noise of SD s in voxels of volume v has power s^2 v at every frequency."""
    white = np.random.default_rng(3).normal(0, 6, GRID.shape)
    measured = measure_spectra(white, white, GRID.spacing)
    filled = measured.mean > 0
    assert filled.mean() > 0.9
    assert np.average(measured.mean[filled]) == pytest.approx(36 * 0.75 * 0.7 * 0.7, rel=0.03)
    assert not measured.signal().any()


def test_linear_interpolation_blurs_by_a_sixth_of_a_voxel_squared():
    """A wide Gaussian, interpolated halfway between voxels, against the closed form."""
    x = np.arange(-60, 61.0)
    values = np.exp(-((x / 4) ** 2) / 2)
    places = np.linspace(-50, 50, 1001)
    read = np.interp(places, x, values)
    variance = (read * places**2).sum() / read.sum()
    of_points = add_voxel_blur((4.0, 0, 0), (1.0, 1.0, 1.0), (1e-6, 1e-6, 1e-6))
    assert variance == pytest.approx(of_points[0] ** 2, rel=1e-3)


@pytest.mark.parametrize("fine", [1, 2])
def test_blur_by_voxels_appears_in_projections(fine):
    """A Gaussian through `ct` and the projector: its width along z, and across rays of all directions."""
    fine_grid, sd = Grid((64, 64, 64), (1.3, 1.3, 1.3)), 3.1
    z, y, x = np.meshgrid(*fine_grid.axes_mm(), indexing="ij")
    image = Volume((-1000 + 800 * np.exp(-(x**2 + y**2 + z**2) / 2 / sd**2)).astype(np.float32), fine_grid)
    grid = Grid((28, 28, 28), (3.0, 3.0, 3.0)).refined(fine)
    phantom = Volume(resample(image, grid, outside=-1000.0), grid)
    far = 1e5  # almost parallel
    scan = circular(
        views=64,
        source_to_isocentre_mm=far,
        source_to_detector_mm=far + 1,
        columns=200,
        rows=200,
        column_pitch_mm=0.4,
        row_pitch_mm=0.4,
    )
    profile = clean_line_integrals(phantom, scan, 0.02).mean(axis=0, dtype=np.float64)
    places = (np.arange(200) - 99.5) * 0.4
    of_rows, of_columns = (profile.sum(axis=axis) for axis in (1, 0))
    found = [np.average((places - np.average(places, weights=w)) ** 2, weights=w) for w in (of_rows, of_columns)]
    expected = add_voxel_blur((sd,) * 3, fine_grid.spacing, grid.spacing)
    np.testing.assert_allclose(found, np.square(expected[:2]), rtol=2e-3)
    assert expected[0] ** 2 > 1.04 * sd**2  # the difference under test exceeds the tolerance


def test_invalid_blur_is_rejected():
    with pytest.raises(InputError, match="blur_mm is "):
        deconvolve(Volume(np.zeros(GRID.shape, np.float32), GRID), (-1.0, 0.5, 0.5), NO_NOISE)
    with pytest.raises(InputError, match="show no surface between object and air; set public_scans.own_blur: kept"):
        edge_mtf_half(Volume(np.zeros(GRID.shape, np.float32), GRID))
