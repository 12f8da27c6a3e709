"""Kernels against closed forms, boxes against the whole volume, and thick slices against thin ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scanner import SCANNER
from scipy.integrate import quad
from scipy.interpolate import BSpline

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.base.settings import FbpSettings, ImageSettings, from_mapping
from virtual_phantom.physics.effect import checked
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.projectors.parallel import _arcsine
from virtual_phantom.reconstruction import boxes, slices
from virtual_phantom.reconstruction.fbp import Filter, ParallelProjections, fbp
from virtual_phantom.reconstruction.images import filtered, reconstruct_hu
from virtual_phantom.reconstruction.kernel import Kernel, NoiseKernel
from virtual_phantom.simulation.reconstruct import NoisyScans, reconstruct_images

SMOOTH, SHARP = Kernel(2.5, 4.2), Kernel(4.0, 7.0)
FAN = circular(views=400, columns=240, rows=1, column_pitch_mm=1.4, row_pitch_mm=2.0, **SCANNER)  # 0.7 mm at the center
FINE = Grid((1, 72, 72), (1.0, 0.6, 0.6))
HELIX = helical(views=170, volume_height_mm=20, columns=60, rows=10, column_pitch_mm=3.0, row_pitch_mm=4.0, **SCANNER)
WHOLE = Grid((12, 40, 44), (1.6, 2.0, 1.8))
MU = 0.02


def hu(attenuation):
    return 1000 * (attenuation / MU - 1)


def fbp_settings(kernel, noise_kernel=None):
    settings = {"normalise": "coverage", "kernel": kernel and vars(kernel)}
    if noise_kernel is not None:
        settings["noise_kernel"] = {**vars(noise_kernel.kernel), "variance": noise_kernel.variance}
    return from_mapping(FbpSettings, settings)


def in_boxes(lines, grid, made, kernel=None, noise_kernel=None, clean=None, thickness_mm=None):
    projections = filtered(lines, HELIX, [fbp_settings(kernel, noise_kernel)], clean)
    return boxes.back_in_boxes(projections, grid, made, mu_water_per_mm=MU, thickness_mm=thickness_mm)[0]


@pytest.fixture(scope="module")
def scan():
    return np.random.default_rng(4).normal(1, 0.1, (2, HELIX.views, HELIX.rows, HELIX.columns)).astype(np.float32)


@pytest.mark.parametrize("kernel", [SMOOTH, SHARP])
def test_the_mtf_passes_through_its_two_points(kernel):
    at = np.array([0.0, kernel.mtf50_per_cm / 10, kernel.mtf10_per_cm / 10])
    assert kernel.mtf(at) == pytest.approx([1, 0.5, 0.1])


@pytest.mark.parametrize("kernel", [SMOOTH, SHARP])
def test_closed_form_of_the_noise_equals_the_integral(kernel):
    integral, _ = quad(lambda f: f**2 * kernel.mtf(f) ** 2, 0, np.inf)
    assert kernel.noise == pytest.approx(integral, rel=1e-6)


def noise_variance(kernel):
    noise = np.random.default_rng(5).normal(0, 0.01, (8, *FAN.shape)).astype(np.float32)
    return fbp(CpuProjector(FAN, FINE, 8), noise, kernel=kernel).var()


def test_noise_of_filtered_back_projection_has_its_closed_form():
    """pi^2 / rays x variance of a ray x pitch x integral of (f MTF)^2 over both signs of f (Riederer et al., 1978)."""
    measured = {kernel: noise_variance(kernel) for kernel in (SMOOTH, SHARP)}
    for kernel, variance in measured.items():
        expected = np.pi**2 / FAN.views * 0.01**2 * 0.7 * 2 * kernel.noise
        assert variance == pytest.approx(expected, rel=0.05)
    assert measured[SHARP] / measured[SMOOTH] == pytest.approx(SHARP.noise / SMOOTH.noise, rel=0.04)


@pytest.mark.parametrize("kernel", [SMOOTH, SHARP])
def test_gaussian_object_is_blurred_by_the_mtf(kernel):
    """Peak of an off-axis Gaussian, whose rays pass between samples:

    the integral of 2 pi f times its spectrum times the MTF.
    """
    sigma, x, y = 0.8, 20.0, -7.0
    t = SCANNER["source_to_isocentre_mm"] * np.sin(np.arctan(FAN.column_positions_mm() / 1000))
    direction = FAN.angles_rad[:, None] + np.arcsin(t / SCANNER["source_to_isocentre_mm"])
    away = t - x * np.cos(direction) - y * np.sin(direction)
    lines = (np.sqrt(2 * np.pi) * sigma * np.exp(-(away**2) / 2 / sigma**2)).astype(np.float32)[None, :, None]
    around = CpuProjector(FAN, Grid((1, 3, 3), (1.0, 0.1, 0.1)), centre_mm=(x, y, 0))
    peak = fbp(around, lines, kernel=kernel)[0, 0, 1, 1]
    spectrum = lambda f: 2 * np.pi * sigma**2 * np.exp(-2 * (np.pi * sigma * f) ** 2)  # noqa: E731
    expected, _ = quad(lambda f: 2 * np.pi * f * spectrum(f) * kernel.mtf(f), 0, np.inf)
    assert peak == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("mtf", [(0, 5), (5, 5), (6, 5), (3, np.inf)])
def test_impossible_mtf_is_rejected(mtf):
    with pytest.raises(InputError, match="kernel: its MTF is a half at"):
        Kernel(*mtf)


@pytest.mark.parametrize("kernel", [None, SMOOTH])
def test_boxes_are_parts_of_the_whole_volume(scan, kernel):
    masks = np.zeros((2, *WHOLE.shape), bool)
    masks[0, 4:7, 10:20, 8:15] = masks[1, 0:3, 30:40, 20:22] = True
    made = boxes.boxes_around(masks, WHOLE, margin_mm=3.0)
    assert made == [(slice(2, 9), slice(8, 22), slice(6, 17)), (slice(0, 5), slice(28, 40), slice(18, 24))]
    images = in_boxes(scan, WHOLE, made, kernel)
    whole = hu(fbp(CpuProjector(HELIX, WHOLE, 2), scan, kernel=kernel))
    left = np.ones(WHOLE.shape, bool)
    for box in made:
        assert np.abs(images[:, *box] - whole[:, *box]).max() < 1e-6 * np.ptp(whole)
        left[box] = False
    assert np.all(images[:, left] == -1000)


def test_noise_kernel_changes_the_noise_and_its_variance_only(scan):
    """`scan` as noise on line integrals of a ball; the proxy is FBP of the ball plus noise with its own kernel."""
    clean = np.zeros(scan.shape[1:], np.float32)
    clean[:, :, 20:40] = 0.5
    noise = np.random.default_rng(3).normal(0, 0.01, scan.shape).astype(np.float32)
    box = (slice(3, 8), slice(8, 32), slice(8, 32))

    def images(lines, **settings):
        return in_boxes(lines, WHOLE, [box], SMOOTH, **settings)[:, *box]

    half = NoiseKernel(Kernel(SMOOTH.mtf50_per_cm * 0.7, SMOOTH.mtf10_per_cm * 0.7), 0.5)
    without = images(clean + 0 * noise)
    assert images(clean + 0 * noise, noise_kernel=half, clean=clean) == pytest.approx(without, abs=0.01)
    noisy = images(clean + noise)
    same = images(clean + noise, noise_kernel=NoiseKernel(SMOOTH, 1.0), clean=clean)
    assert same == pytest.approx(noisy, abs=1e-4 * float(np.ptp(noisy)))
    proxy = images(clean + noise, noise_kernel=half, clean=clean)
    assert (proxy - without).var() / (noisy - without).var() == pytest.approx(0.5, rel=0.15)
    neighbors = lambda image: np.mean(image[..., 1:] * image[..., :-1]) / np.mean(image**2)  # noqa: E731
    assert neighbors(proxy - without) > neighbors(noisy - without) + 0.05


def test_whole_image_with_a_noise_kernel_equals_its_boxes(scan):
    clean = scan.mean(axis=0)
    box = (slice(3, 8), slice(8, 32), slice(8, 32))
    proxy = NoiseKernel(Kernel(SMOOTH.mtf50_per_cm * 0.7, SMOOTH.mtf10_per_cm * 0.7), 0.5)
    boxed = in_boxes(scan, WHOLE, [box], SMOOTH, noise_kernel=proxy, clean=clean)
    settings = fbp_settings(SMOOTH, proxy)
    whole = reconstruct_hu(scan, HELIX, WHOLE, "fbp", settings, "cpu", MU, clean=clean)
    assert np.array_equal(in_boxes(scan, WHOLE, boxes.whole(WHOLE), SMOOTH, noise_kernel=proxy, clean=clean), whole)
    assert np.abs(boxed[:, *box] - whole[:, *box]).max() < 1e-6 * np.ptp(whole)


@pytest.mark.parametrize("sources", [["one", "one"], ["one", "two"]])
def test_images_of_protocols_with_shared_scans_equal_those_of_each_alone(scan, sources):
    """Kernels are filtered in pairs; of a pair, images with the same voxels are back-projected together."""
    clean = scan.mean(axis=0)
    proxy = NoiseKernel(Kernel(SMOOTH.mtf50_per_cm * 0.7, SMOOTH.mtf10_per_cm * 0.7), 0.5)
    kernels = {"proxy": (SMOOTH, proxy), "smooth": (SMOOTH, None), "again": (SMOOTH, None), "sharp": (SHARP, None)}
    images = [ImageSettings(name, "fbp", fbp_settings(*own), {}) for name, own in kernels.items()]
    images.append(
        ImageSettings("filtered", "fbp", fbp_settings(SMOOTH), checked({"reconstruction_kernel": {"sigma_mm": 0.8}}))
    )
    scans = NoisyScans(scan, [HELIX, HELIX], sources, {"one": clean, "two": 0.9 * clean})

    def made(*some):
        found = reconstruct_images(some, scans, WHOLE, {}, engine="cpu", mu_water_per_mm=MU)
        return {(name, lane): volume.array for name, lane, volume in found}

    together = made(*images)
    assert set(together) == {(image.protocol, lane) for image in images for lane in (0, 1)}
    for image in images:
        for key, alone in made(image).items():
            assert np.array_equal(together[key], alone)
    assert np.array_equal(together["again", 1], together["smooth", 1])
    assert not np.array_equal(together["sharp", 0], together["smooth", 0])
    assert not np.array_equal(together["filtered", 0], together["smooth", 0])


@given(st.floats(-1, 1))
def test_arcsine_of_the_kernel(sine):
    assert _arcsine(sine) == pytest.approx(np.arcsin(sine), rel=3e-7, abs=1e-300)


def test_noise_kernel_needs_a_positive_variance():
    with pytest.raises(InputError, match="noise_kernel: its variance is 0"):
        NoiseKernel(SMOOTH, 0.0)


def test_thick_slices_are_means_of_thin_ones(scan):
    grid = Grid((6, 20, 20), (1.0, 2.0, 2.0))
    box = (slice(2, 4), slice(4, 16), slice(0, 9))
    thick = in_boxes(scan, grid, [box], thickness_mm=2.0)[:, *box]
    thin = hu(fbp(CpuProjector(HELIX, Grid((12, 20, 20), (0.5, 2.0, 2.0)), 2), scan))
    expected = np.stack([thin[:, 3:7, 4:16, :9].mean(axis=1), thin[:, 5:9, 4:16, :9].mean(axis=1)], axis=1)
    assert np.abs(thick - expected).max() < 1e-6 * np.ptp(expected)


@pytest.mark.parametrize(("spacing", "thickness"), [(1.0, 2.0), (1.0, 1.5), (2.0, 3.0), (0.75, 1.0), (1.0, 0.5)])
def test_box_of_thin_slices_keeps_linear_functions_and_averages_noise(spacing, thickness):
    weights, thin, thin_mm = slices.thin_slices(5, spacing, thickness)
    heights = (np.arange(thin) - (thin - 1) / 2) * thin_mm
    assert thin_mm <= slices.THIN_MM
    assert weights @ heights == pytest.approx((np.arange(5) - 2) * spacing, abs=1e-6)
    assert weights.sum(axis=1) == pytest.approx(1)
    # The variance of independent thin slices is that of one divided by their number; the two at the edges count by
    # their share.
    within = thickness / thin_mm
    edge = 1 - (np.ceil(within) - within) / 2
    whole = np.ceil(within) - 2
    assert (weights**2).sum(axis=1) == pytest.approx((whole + 2 * edge**2) / within**2)


def noise_of_interpolated_rows(thickness, row):
    """Variance of a slice of linearly interpolated rows with white noise, averaged over positions, relative to one row.

    The autocorrelation of the interpolated noise is a cubic B-spline, that of the slice profile a triangle.
    """
    spline = BSpline.basis_element(np.arange(-2, 3) * row, extrapolate=False)
    integral, _ = quad(lambda z: spline(z) * (1 - z / thickness), 0, min(2 * row, thickness), limit=200)
    return 2 * integral / thickness


@pytest.mark.parametrize(("spacing", "thickness"), [(1.0, 2.0), (1.0, 1.5), (2.0, 3.0), (0.75, 1.0)])
def test_noise_falls_with_thickness_as_for_a_box_over_interpolated_rows(spacing, thickness):
    """Rows of 0.6 mm. A half-counted sample beyond each edge would reduce the noise of 1.5 mm by 7 %."""
    weights, thin, thin_mm = slices.thin_slices(1, spacing, thickness)
    at = np.arange(thin) * thin_mm
    spline = BSpline.basis_element(np.arange(-2, 3) * 0.6, extrapolate=False)
    covariance = np.nan_to_num(spline(at[:, None] - at))
    found = float((weights @ covariance @ weights.T)[0, 0])
    assert found == pytest.approx(noise_of_interpolated_rows(thickness, 0.6), rel=0.05)


def test_noise_of_a_scan_falls_with_thickness_as_for_interpolated_rows():
    """On the axis, where rows are 0.6 mm wide in all views."""
    pixels = dict(columns=12, rows=16, column_pitch_mm=3.0, row_pitch_mm=1.2)
    scan = helical(views=720, volume_height_mm=16, **pixels, **SCANNER)
    row = scan.row_pitch_mm / scan.magnification
    noise = np.random.default_rng(6).normal(0, 0.01, (8, *scan.shape)).astype(np.float32)
    grid = Grid((12, 3, 3), (1.0, 1.0, 1.0))
    box = (slice(2, 10), slice(0, 3), slice(0, 3))
    projections = ParallelProjections.of(noise, scan, [Filter(SMOOTH)])
    variance = {
        thickness: boxes.back_in_boxes(projections, grid, [box], mu_water_per_mm=MU, thickness_mm=thickness)[
            0, :, *box
        ].var()
        for thickness in (1.5, 2.0, 3.0)
    }
    for thickness in (1.5, 3.0):
        expected = noise_of_interpolated_rows(thickness, row) / noise_of_interpolated_rows(2.0, row)
        assert variance[thickness] / variance[2.0] == pytest.approx(expected, rel=0.05)
