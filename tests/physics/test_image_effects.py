"""Effects on images: closed forms, back-projections of scikit-image, and effects added by one file."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from generators import effects as effects_page
from skimage.transform import iradon

from virtual_phantom.base.geometry import Grid, circular, parallel_beam
from virtual_phantom.base.settings import FbpSettings, from_mapping
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.physics import effect, effects
from virtual_phantom.reconstruction.images import reconstruct_hu
from virtual_phantom.simulation.reconstruct import apply_image_effects

NEW_EFFECT = """
from ..effect import Effect, Parameter


def apply(state, values):
    state.hu = state.hu.clip(max=values["ceiling_hu"])


EFFECT = Effect(
    name="{name}",
    physics="Numbers are cut.",
    equation="HU' = min(HU, c)",
    source="none",
    stage="image",
    signature="nothing over it",
    settled_by="metal",
    parameters=(Parameter("ceiling_hu", "HU", "largest number", 0.0, 1e4, 3000.0, 3000.0, None),),
    apply=apply,
    rank={rank},
)
"""


def test_effect_on_images_is_added_by_one_file(tmp_path, monkeypatch):
    """It is found, acts at its rank, is a candidate for images, and is listed in the catalog."""
    known = set(effect.image_effects())
    for path in Path(effects.__path__[0]).glob("*.py"):
        shutil.copy(path, tmp_path)
    for name, rank in (("cut_before", 0), ("cut_after", 2)):
        (tmp_path / f"{name}.py").write_text(NEW_EFFECT.format(name=name, rank=rank))
    monkeypatch.setattr(effects, "__path__", [str(tmp_path)])
    image, added = np.array([[[0.0, 40.0, 80.0]]]), {"hu_calibration": {"scale": 1.0, "offset_hu": 30.0}}
    before = apply_image_effects(image, (1.0, 1.0, 1.0), added | {"cut_before": {"ceiling_hu": 50.0}})
    after = apply_image_effects(image, (1.0, 1.0, 1.0), {"cut_after": {"ceiling_hu": 50.0}} | added)
    np.testing.assert_array_equal([before.ravel(), after.ravel()], [[30, 70, 80], [30, 50, 50]])
    assert set(effect.image_effects()) == known | {"cut_before", "cut_after"}
    settings = from_mapping(RecordingSettings, {"nominal_photons": 1e5})
    assert {"cut_before", "cut_after"} <= set(candidates(settings, "images"))
    assert not {"cut_before", "cut_after"} & set(candidates(settings))
    assert "## Cut before" in effects_page.page()


SIDE, MM, MU = 129, 2.0, 0.02  # odd: skimage.transform.iradon and ImageState then have the same center
POSITION = (np.arange(SIDE) - SIDE // 2) * MM
RADIUS = np.hypot(POSITION[:, None], POSITION)
KERNEL = effect.load("reconstruction_kernel")
CHORD = 2 * np.sqrt(np.maximum(100.0**2 - POSITION**2, 0))  # of a disc of radius 100 mm


def changed_hu(name, image=None, **values):
    image = np.zeros((1, SIDE, SIDE)) if image is None else image
    return apply_image_effects(image, (1.0, MM, MM), {name: effect.load(name).values(values)})[0]


def back_projected_hu(line_integrals):
    """Return the HU that a sinogram, equal in all views, adds to an image, by scikit-image."""
    views = np.arange(180.0)
    sinogram = np.repeat(line_integrals[:, None] / MM, len(views), axis=1)
    return 1000 / MU * iradon(sinogram, views, filter_name="ramp", circle=True)


@pytest.mark.parametrize("name", effect.image_effects())
def test_neutral_parameters_change_nothing(name):
    image = np.random.default_rng(1).normal(0, 100, (3, 20, 24)).astype(np.float32)
    neutral = {one.name: one.neutral for one in effect.load(name).parameters if one.neutral is not None}
    values = effect.load(name).values(neutral)
    np.testing.assert_array_equal(apply_image_effects(image, (2.0, 1.0, 1.5), {name: values}), image)


def test_kernel_has_the_mtf_of_its_equation():
    point = np.zeros((1, SIDE, SIDE))
    point[0, SIDE // 2, SIDE // 2] = 1
    found = np.fft.rfft2(np.fft.ifftshift(changed_hu("reconstruction_kernel", point, sigma_mm=1.5, boost=0.4)))
    frequency = np.hypot(np.fft.fftfreq(SIDE, MM)[:, None], np.fft.rfftfreq(SIDE, MM))
    boost = 1 + 0.4 * (frequency / 0.3) ** 2 * np.exp(1 - (frequency / 0.3) ** 2)
    expected = np.exp(-((2 * np.pi * 1.5 * frequency) ** 2) / 2) * boost
    # The cosine transform samples the MTF at other frequencies, so that they agree up to the edge of the image.
    np.testing.assert_allclose(found.real, expected, atol=0.01)


@pytest.mark.parametrize(
    ("shape", "sigma", "window"),  # the standard deviation in 1 / cut-off frequency
    [
        (0.5, 8**-0.5, lambda x: np.where(x < 1, (1 + np.cos(np.pi * x)) / 2, 0)),  # Hann
        (1.0, 0.25, lambda x: np.where(x < 1, np.cos(np.pi * x / 2), 0)),
        (0.0, 0.25, lambda x: np.exp(-((np.pi * x / 2) ** 2) / 2)),
        (1.1e-4, 0.25, lambda x: np.exp(-((np.pi * x / 2) ** 2) / 2)),
        (-1.0, 0.25, lambda x: 1 / np.cosh(np.pi * x / 2)),
    ],
    ids=["hann", "cosine", "gaussian", "nearly gaussian", "sech"],
)
def test_shape_of_the_kernel_gives_known_windows(shape, sigma, window):
    cut_off, frequency = 0.25, np.linspace(0, 0.5, 101)  # per mm
    found = KERNEL.mtf(frequency, KERNEL.values({"sigma_mm": sigma / cut_off, "shape": shape}))
    np.testing.assert_allclose(found, window(frequency / cut_off), atol=1e-4)


@pytest.mark.parametrize(
    ("name", "sigma", "shape"),  # the standard deviation in detector elements
    [("hann", 2**-0.5, 0.5), ("cosine", 0.5, 1.0), ("shepp-logan", 12**-0.5, 0.6), ("hamming", 0.683, 0.32)],
)
def test_kernel_reproduces_filters_of_scikit_image(name, sigma, shape):
    """An image that is filtered instead keeps 7 to 26 % of the change, because edges are aliased."""
    views = 120
    geometry = circular(views=views, **parallel_beam(), columns=SIDE, rows=1, column_pitch_mm=MM, row_pitch_mm=MM)
    lines = MU * np.repeat(CHORD[None], views, axis=0)

    def by_scikit_image(filter_name):
        angles = np.arange(views) * 360 / views
        return 1000 * (iradon(lines.T / MM, angles, filter_name=filter_name, circle=True) / MU - 1)

    physics = {KERNEL.name: KERNEL.values({"sigma_mm": sigma * MM, "shape": shape})}
    scan = lines[None, :, None].astype(np.float32), geometry, Grid((1, SIDE, SIDE), (MM,) * 3), "fbp"
    how = FbpSettings("coverage"), "cpu", MU
    images = [reconstruct_hu(*scan, *how, mtf=mtf)[0] for mtf in (None, effect.filter_factor(physics))]
    image = apply_image_effects(images[0], (MM,) * 3, physics, tuple(images))[0]
    inside, ramp, expected = RADIUS < 120, by_scikit_image("ramp"), by_scikit_image(name)
    change, rest = (float((expected - other)[inside].std()) for other in (ramp, image))
    in_image = (expected - changed_hu(KERNEL.name, ramp[None], **physics[KERNEL.name]))[inside].std()
    assert change > 5 and rest < 0.016 * change and in_image > 0.06 * change


def test_filter_is_found_among_effects():
    """Fits of a pattern have no parameters; a kernel that does nothing is none."""
    values = KERNEL.values({"sigma_mm": 1.0})
    found = effect.filter_factor({"rings": {}, KERNEL.name: values})
    np.testing.assert_array_equal(found(np.array([0.0, 0.1])), KERNEL.mtf(np.array([0.0, 0.1]), values))
    assert effect.filter_factor({"rings": {}, KERNEL.name: values | {"sigma_mm": 0.0}}) is None


@pytest.mark.parametrize(
    ("slope", "profile"),
    [
        (0.0, lambda z: abs(z) < 5),
        (0.5, lambda z: (7.5 - abs(z)).clip(0, 5) / 5),
        (1.0, lambda z: (10 - abs(z)).clip(0) / 10),
    ],
    ids=["rectangle", "trapezoid", "triangle"],
)
def test_slice_profile(slope, profile):
    point, fine = np.zeros((41, 1, 1)), (np.arange(4100) - 2049.5) / 100
    point[20] = 1
    values = effect.load("slice_thickness").values({"thickness_mm": 10.0, "slope": slope})
    found = apply_image_effects(point, (1.0, MM, MM), {"slice_thickness": values})[:, 0, 0]
    expected = profile(fine).reshape(41, 100).mean(axis=1) / 10  # a slice is the mean over its spacing
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_cupping_is_that_of_an_error_of_line_integrals():
    """A term e p^3 of the water correction gives a disc the cupping 6 e mu^3 (R^2 - r^2)."""
    inside, error = RADIUS < 80, 1e-3
    expected = back_projected_hu(error * (MU * CHORD) ** 3)[inside]
    found = changed_hu("residual_cupping", quadratic_hu=-6 * error * MU**2 * 1000 * 100.0**2)[inside]
    assert np.ptp(expected) > 1
    np.testing.assert_allclose(found - found.mean(), expected - expected.mean(), atol=0.03 * np.ptp(expected))


def test_truncation_is_that_of_a_truncated_disc():
    fov = 70.0
    inside = RADIUS < 0.9 * fov
    kept = np.where(np.abs(POSITION) <= fov, MU * CHORD, 0)
    expected = (back_projected_hu(kept) - back_projected_hu(MU * CHORD))[inside]
    found = changed_hu("truncation", radius_mm=fov + MM / 2, path_mm=2 * np.sqrt(100**2 - (fov + MM / 2) ** 2))[inside]
    assert found.max() > 500
    np.testing.assert_allclose(found, expected, rtol=0.03, atol=5)


def test_crescent_is_a_cosine_of_the_angle_with_its_peak_at_its_radius():
    found = changed_hu("crescent", x_hu=20.0, y_hu=0.0, radius_mm=80.0)
    assert found[SIDE // 2].max() == pytest.approx(20, rel=1e-3)
    assert POSITION[found[SIDE // 2].argmax()] == pytest.approx(80, abs=MM)
    np.testing.assert_allclose(found, -found[:, ::-1], atol=1e-5)
    np.testing.assert_allclose(found[:, SIDE // 2], 0, atol=1e-5)


def test_resampling_interpolates_linearly_between_other_pixels():
    def image(position):
        return 100 * np.cos(2 * np.pi * position / 30)

    pixels = 3.1 * (np.arange(-45, 45) + 0.5)
    rows = np.interp(POSITION, pixels, image(pixels))
    found = changed_hu("resampling", np.broadcast_to(image(POSITION), (1, SIDE, SIDE)), pixel_mm=3.1)
    np.testing.assert_allclose(found[:, 5:-5], np.broadcast_to(rows, (SIDE, SIDE))[:, 5:-5], atol=0.2)
    assert np.abs(rows - image(POSITION)).max() > 3


def test_low_contrast_is_blurred_and_high_contrast_kept():
    edge = np.broadcast_to(np.where(POSITION > 0, 0.5, -0.5), (1, SIDE, SIDE))
    blurred = changed_hu("reconstruction_kernel", edge, sigma_mm=4.0)
    values = {"sigma_mm": 4.0, "contrast_hu": 50.0}
    low, high = (changed_hu("contrast_dependent_resolution", size * edge, **values) / size for size in (1.0, 5000.0))
    np.testing.assert_allclose(low, blurred, atol=0.01)
    np.testing.assert_allclose(high, edge[0], atol=0.01)
