"""CTs in HU and mm pass; similar images in other units are rejected with suitable advice."""

import re

import nibabel
import numpy as np
import pytest

from virtual_phantom.base.errors import InputError, lines_of
from virtual_phantom.base.geometry import Grid
from virtual_phantom.phantom.ct import read_hu
from virtual_phantom.phantom.plausibility import require_plausible

GRID = Grid((10, 64, 64), (4.0, 6.0, 6.0), (12.0, -150.0, 640.0))
Z, Y, X = np.meshgrid(*GRID.axes_mm(), indexing="ij")
OUTLINE = (X / 160) ** 2 + (Y / 110) ** 2 < 1
OUTSIDE_VIEW = np.hypot(X, Y) > 190
MU_WATER = 0.02  # per mm
INNER = (slice(None), slice(22, 42), slice(22, 42))  # within the body, including bone


def chest(noise=10.0, lowest=-1024, lungs=False, seed=0):
    """A body of 320 x 220 mm (x, y) with fat, muscle and a vertebra, whole HU."""
    hu = np.where(OUTLINE, -100.0, -1000.0)
    hu[(X / 150) ** 2 + (Y / 100) ** 2 < 1] = 50
    if lungs:
        hu[((abs(X) - 75) / 50) ** 2 + (Y / 75) ** 2 < 1] = -850
    hu[(X / 25) ** 2 + ((Y + 60) / 25) ** 2 < 1] = 250
    hu[(X / 12) ** 2 + ((Y + 60) / 12) ** 2 < 1] = 700
    hu += np.random.default_rng(seed).normal(0, noise, hu.shape)
    return np.rint(hu if lowest is None else np.maximum(hu, lowest))


def padded(hu, value):
    return np.where(OUTSIDE_VIEW, value, hu)


def with_metal(hu, value):
    hu = hu.copy()
    hu[4:6, 30:33, 40:44] = value
    return hu


def noisy(hu, sd=15.0):
    return hu + np.random.default_rng(1).normal(0, sd, hu.shape)


def magnitudes(signal, sd=15.0):
    """Rician noise, as in magnitude images."""
    real, imaginary = np.random.default_rng(2).normal(0, sd, (2, *signal.shape))
    return np.hypot(signal + real, imaginary)


def cylinder(hu, radius=100.0):
    return np.where(np.hypot(X, Y) < radius, float(hu), -1000.0)


def found(array, grid=GRID, not_checked=()):
    if array.shape != grid.shape:
        grid = Grid(array.shape, grid.spacing, grid.centre_mm)
    try:
        require_plausible(np.asarray(array, np.float32), grid, "ct.nii.gz", not_checked)
    except InputError as error:
        return lines_of(error)
    return ()


def spaced(*spacing):
    return Grid(GRID.shape, spacing, GRID.centre_mm)


RIGHT = {
    "a body": lambda: chest(),
    "lungs": lambda: chest(lungs=True),
    "noise of 100 HU": lambda: chest(100, None),
    "noise of 250 HU": lambda: chest(250, None),
    "noise clipped at -1024": lambda: chest(300),
    "without noise": lambda: chest(0),
    "padding of GE": lambda: padded(chest(), -2000),
    "padding of Siemens": lambda: padded(chest(), -3024),
    "padding far below": lambda: padded(chest(lungs=True), -10000),
    "padding at -1024": lambda: padded(chest(), -1024),
    "air set to -1000": lambda: np.where(OUTLINE, chest(), -1000),
    "air set to -2000": lambda: np.where(OUTLINE, chest(), -2000),
    "a crop without air": lambda: chest()[INNER],
    "a crop of lung": lambda: chest(lungs=True)[:, 26:38, 16:26],
    "fat alone": lambda: noisy(np.full((10, 30, 30), -100.0)),
    "water alone, little noise": lambda: np.rint(noisy(np.zeros((10, 30, 30)), 3)),
    "a cylinder of water": lambda: noisy(cylinder(0)),
    "a cylinder of water without noise": lambda: cylinder(0),
    "a block of PTFE": lambda: noisy(cylinder(990, 150)),
    "wood": lambda: noisy(cylinder(-420, 150)),
    "a small thing in much air": lambda: noisy(cylinder(30, 14)),
    "metal clipped at 3071": lambda: with_metal(chest(), 3071),
    "metal of an extended range": lambda: with_metal(chest(), 30000),
    "metal clipped at 1976": lambda: with_metal(chest(), 1976),
    "a cone-beam CT that is 8 % off": lambda: 0.92 * chest() + 20,
    "no bone": lambda: np.minimum(chest(), 120 - np.random.default_rng(2).integers(0, 30, X.shape)),
}

WRONG = {
    "HU + 1024": (lambda: chest() + 1024, "hu", "perhaps HU \\+ 1024: subtract 1024 first"),
    "HU + 1024, padded by GE": (lambda: padded(chest() + 1024, -2000), "hu", "1000 or 1024 was added to HU"),
    "HU + 1024, padded with air": (lambda: padded(chest() + 1024, -1000), "hu", "1000 or 1024 was added to HU"),
    "HU + 1000, noise below 0": (lambda: chest(30, None) + 1000, "hu", "1000 or 1024 was added to HU"),
    "HU - 1024": (lambda: chest() - 1024, "hu", "air is at about -2024, not -1000 HU; add 1024"),
    "HU - 1024, no noise": (lambda: cylinder(0) - 1024, "hu", "perhaps HU - 1000 or HU - 1024: add 1000 or 1024"),
    "HU + 500": (lambda: chest() + 500, "hu", "the surroundings of the body are at -500 HU"),
    "HU / 1000": (lambda: chest() / 1000, "hu", "perhaps HU / 1000: multiply by 1000"),
    "HU / 10": (lambda: chest() / 10, "hu", "perhaps the scale was lost"),
    "HU * 10": (lambda: chest(20, None) * 10, "hu", "air is at about -10000"),
    "half the slope": (lambda: chest() / 2, "hu", "the surroundings of the body are at -500 HU"),
    "mu per mm": (lambda: MU_WATER * (1 + chest() / 1000), "hu", "perhaps attenuation mu"),
    "mu per cm, noise": (lambda: 10 * MU_WATER * (1 + chest(60, None) / 1000), "hu", "perhaps attenuation mu"),
    "mu per m": (lambda: 1000 * MU_WATER * (1 + chest(20, None) / 1000), "hu", "perhaps the scale was lost"),
    "0 to 1": (lambda: np.clip((chest() + 160) / 400, 0, 1), "hu", "they were scaled to 0 to 1"),
    "-1 to 1": (lambda: np.clip((chest() + 160) / 200 - 1, -1, 1), "hu", "they were scaled to -1 to 1"),
    "z-scores": (lambda: (chest() - chest().mean()) / chest().std(), "hu", "perhaps normalized by mean and SD"),
    "z-scores with metal": (lambda: (with_metal(chest(), 30000) + 600) / 500, "hu", "perhaps normalized by mean"),
    "a picture": (
        lambda: np.rint(255 * np.clip((chest() + 160) / 400, 0, 1)),
        "hu",
        "perhaps gray values of a picture",
    ),
    "sign lost": (lambda: chest() % 65536, "hu", "subtract 65536 from values above 32767"),
    "inverted": (lambda: -chest(), "hu", "the values are inverted; multiply by -1"),
    "a window": (lambda: np.clip(chest(), -160, 240), "window", "exactly -160, the lowest value: it was clipped"),
    "a window, no noise": (lambda: np.clip(chest(0), -160, 240), "window", "exactly -160, the lowest value"),
    "a wide window": (lambda: np.clip(chest(lungs=True), -500, 1300), "window", "exactly -500, the lowest value"),
    "a lung window": (lambda: np.clip(chest(), -1000, 100), "window", "exactly 100, the highest value: it was clipped"),
    "signed bytes": (lambda: np.clip(chest(), -128, 127), "window", "exactly -128, the lowest value"),
    "an MR": (lambda: magnitudes(np.where(OUTLINE, 400, 0)), "hu", "perhaps magnitudes, as of MR"),
    "an MR of whole numbers": (lambda: 1 + np.rint(magnitudes(np.where(OUTLINE, 900, 0))), "hu", "of MR"),
    "mu times 1e5": (lambda: 2000 * (1 + chest(20, None) / 1000), "hu", "denser than bone, and there is no air"),
    "twice HU + 1000": (lambda: 2 * chest(20, None) + 2500, "hu", "denser than bone|has no value below 0"),
    "a mask": (lambda: OUTLINE * 1.0, "hu", "has 2 different whole numbers up to 1, as a label map or mask"),
    "labels": (lambda: np.rint(cylinder(0) + 1000) / 1000 * 117, "hu", "up to 117, as a label map or mask: give the"),
    "outside set to 0": (
        lambda: np.where(OUTLINE, chest(), 0),
        "window",
        "the surroundings of the body were set to this value",
    ),
}

SIZES = {
    "cm": (
        spaced(0.4, 0.6, 0.6),
        "the body in it 32.4 mm, where at least 60 mm are expected; are its .* in mm, not in cm",
    ),
    "m": (spaced(0.004, 0.006, 0.006), "has voxels of 0.006 x 0.006 x 0.004 mm"),
    "um": (spaced(4000.0, 6000.0, 6000.0), "is 3.84e\\+05 mm wide, where up to 1500 mm"),
    "m along z": (spaced(0.004, 6.0, 6.0), "has voxels of 6 x 6 x 0.004 mm"),
    "no affine": (Grid(GRID.shape, (1.0, 1.0, 1.0), (31.5, 31.5, 4.5)), "voxel size was lost"),
    "no affine, as ITK writes it": (Grid(GRID.shape, (1.0, 1.0, 1.0), (-31.5, -31.5, 4.5)), "voxel size was lost"),
}


@pytest.mark.parametrize("name", RIGHT)
def test_ct_in_hu_passes(name):
    assert found(RIGHT[name]()) == ()


@pytest.mark.parametrize("name", WRONG)
def test_values_other_than_hu_are_rejected_with_suitable_advice(name):
    make, check, advice = WRONG[name]
    array = make()
    (line,) = [one for one in found(array) if f"not_checked: [{check}]" in one]
    assert line.startswith("ct.nii.gz: ")
    assert re.search(advice, line)
    assert not [one for one in found(array, not_checked=[check]) if f"[{check}]" in one]


@pytest.mark.parametrize("name", SIZES)
def test_lengths_other_than_mm_are_rejected(name):
    grid, advice = SIZES[name]
    (line,) = found(chest(), grid)
    assert re.search(advice, line) and line.endswith("(if it is right: not_checked: [size])")
    assert found(chest(), grid, ["size"]) == ()


@pytest.mark.parametrize(
    "grid",
    [
        spaced(2.0, 1.5, 1.5),  # a neonate, 80 mm wide
        spaced(0.5, 3.0, 3.0),  # a child, thin slices
        spaced(10.0, 9.0, 9.0),  # the widest body in a bore, thick slices
    ],
)
def test_bodies_of_all_sizes_pass(grid):
    wide = Grid((10, 80, 80), grid.spacing, grid.centre_mm)
    array = np.full(wide.shape, -1000.0)
    array[:, 8:72, 8:72] = chest()
    assert found(noisy(array, 2), wide) == ()


def test_voxels_of_1_mm_with_their_position_pass():
    fine = chest().repeat(3, axis=1).repeat(3, axis=2)
    assert found(fine, Grid(fine.shape, (1.0, 1.0, 1.0), (5.0, 0.0, 0.0))) == ()


def test_crop_without_air_may_be_small():
    assert found(chest()[INNER], Grid((10, 20, 20), (1.0, 1.0, 1.0), (3.0, 0.0, 0.0))) == ()


@pytest.mark.parametrize("unit", ["meter", "micron"])
def test_header_in_other_units_is_rejected_and_can_be_overruled(unit, tmp_path):
    image = nibabel.Nifti1Image(chest().T.astype(np.int16), GRID.affine)
    image.header.set_xyzt_units(unit)
    nibabel.save(image, tmp_path / "ct.nii")
    with pytest.raises(InputError, match=f"its header gives lengths in {unit}; write it in mm"):
        read_hu(tmp_path / "ct.nii")
    assert read_hu(tmp_path / "ct.nii", ["size"]).grid.matches(GRID)


def test_all_errors_are_reported_together():
    lines = found(np.minimum(chest() + 300, 400), SIZES["cm"][0])
    assert [line[line.rindex("[") :] for line in lines] == ["[hu])", "[window])", "[size])"]
