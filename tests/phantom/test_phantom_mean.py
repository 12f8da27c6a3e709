"""Mean of repeated scans as the phantom: its properties, and rejected scans."""

from dataclasses import replace

import numpy as np
import public_files
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom.displacement import displacement
from virtual_phantom.phantom.mean_scan import ScanFiles, average_scans, object_mask

GRID = Grid((30, 60, 70), (2.0, 1.5, 1.5), (4.0, -20.0, 900.0))
NOISE_HU = 18.0
NAMES = ("811", "812", "813", "814")


def soft(distance_mm):
    """Share of a point spread function of 1 mm SD inside of a surface, as a similar logistic function."""
    return 1 / (1 + np.exp(np.clip(-distance_mm / 0.6, -50, 50)))


def body(shift_mm=(0.0, 0.0, 0.0), turn_deg=0.0):
    """Ellipsoid with a rod, moved; points are moved back, so that nothing is interpolated."""
    z, y, x = np.meshgrid(*GRID.axes_mm(), indexing="ij")
    x, y, z = x - shift_mm[0], y - shift_mm[1], z - shift_mm[2]
    angle = np.radians(turn_deg)
    x, y = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    radius = np.sqrt((x / 38) ** 2 + (y / 28) ** 2 + (z / 60) ** 2)
    hu = -1000 + 1040 * soft(28 * (1 - radius))
    return hu + 900 * soft(4 - np.hypot(x - 20, y - 5))


def table():
    """A shell 3 mm below the object, from side to side."""
    _, y, x = np.ix_(*GRID.axes_mm())
    return 0 * GRID.axes_mm()[0][:, None, None] + np.where(np.abs(y + 37 - 0.002 * x**2) < 1.5, 200.0, -1000.0)


def scan(seed, **moved):
    noise = np.random.default_rng(seed).normal(0, NOISE_HU, GRID.shape)
    hu = np.maximum(body(**moved), table())
    return Volume((hu + noise).astype(np.float32), GRID)


def masks():
    made = {}
    for number, name in enumerate(public_files.SEGMENTS):
        made[name] = np.zeros(GRID.shape, bool)
        made[name][10 + number : 18, 26:34, 14 + 6 * number : 18 + 6 * number] = True
    return made


@pytest.mark.parametrize(
    "shift_mm, turn_deg", [((0.1, -0.05, 0.15), 0.0), ((0.0, 0.0, 0.0), 0.2), ((0.02, 0.3, -0.1), -0.1)]
)
def test_small_motion_is_found_in_noise(shift_mm, turn_deg):
    inside = np.any(list(masks().values()), axis=0)
    reference = scan(2)
    # The table stays at its position.
    within = object_mask(reference, inside)
    found = displacement(scan(1, shift_mm=shift_mm, turn_deg=turn_deg), reference, within)
    # The noise of 18 HU leaves errors of some hundredths of a millimeter and of a degree.
    np.testing.assert_allclose(found.shift_mm, shift_mm, atol=0.03)
    np.testing.assert_allclose(found.turn_deg, (0, 0, turn_deg), atol=0.05)


def test_large_motion_is_measured():
    assert displacement(scan(1), scan(2)).largest_mm < 0.15
    for shift_mm in ((3.0, 0.0, 0.0), (0.0, -8.0, 0.0), (0.0, 0.0, 20.0)):
        assert displacement(scan(1, shift_mm=shift_mm), scan(2)).largest_mm > 1
    nothing = Volume(np.full(GRID.shape, -1000.0, np.float32), GRID)
    assert displacement(nothing, nothing) is None


def test_table_is_not_part_of_the_object():
    inside = np.any(list(masks().values()), axis=0)
    stored = object_mask(Volume((np.maximum(body(), table())).astype(np.float32), GRID), inside)
    assert stored[body() > -300].all()
    alone = (table() > 0) & (body() < -900)
    # Voxels directly below the object are within its rim.
    assert stored[alone].mean() < 0.15


def write(folder, names=NAMES, image_of=lambda scan_: scan(scan_.acquisition), masks_of=lambda scan_: masks()):
    """Write scans in the folders that fetching makes."""
    written = []
    for one in public_files.listed(*names):
        slices = public_files.ct_slices(one, image_of(one))
        ct, seg = folder / one.name / "ct", folder / one.name / "seg.dcm"
        ct.mkdir(parents=True)
        for number, dataset in enumerate(slices):
            dataset.save_as(ct / f"{97 * (number + 1) % 1009:04d}.dcm", enforce_file_format=True)
        public_files.seg(one, slices, masks_of(one)).save_as(seg, enforce_file_format=True)
        written.append(ScanFiles(one.name, ct, seg))
    return written


def test_mean_has_less_noise_no_table_and_the_regions_by_name(tmp_path):
    regions = ("cyst2", "normal1")
    mean = average_scans(write(tmp_path), regions, height_mm=8.0)
    place = [
        np.searchsorted(axis + centre, inner[0] + middle - 1e-6)
        for axis, centre, inner, middle in zip(
            *(GRID.axes_mm(), GRID.centre_mm[::-1], mean.image.grid.axes_mm(), mean.image.grid.centre_mm[::-1]),
            strict=True,
        )
    ]
    part = tuple(slice(first, first + n) for first, n in zip(place, mean.image.grid.shape, strict=True))
    truth = body()[part]
    deep = truth > 35  # away from surfaces
    left = (mean.image.array - truth)[deep]
    assert left.size > 5000 and abs(left.mean()) < 0.5
    assert left.std() == pytest.approx(NOISE_HU / 2, rel=0.05)
    assert mean.noise_hu == pytest.approx(NOISE_HU, rel=0.05) and mean.remaining_hu == mean.noise_hu / 2
    # White noise of SD s in voxels of volume v has power s^2 v at every frequency.
    power = (NOISE_HU / 2) ** 2 * np.prod(GRID.spacing)
    assert mean.spectra.noise[mean.spectra.noise > 0].mean() == pytest.approx(power, rel=0.2)
    for number, name in enumerate(regions, start=1):
        np.testing.assert_array_equal(mean.labels == number, masks()[name][part])
    # 8 mm and 5 mm of margin on both sides, around the middle of slices 10 to 17
    assert mean.image.grid.shape[0] == 8 and part[0] == slice(10, 18)
    assert (mean.image.array[:, 0] == -1000).any() and mean.image.array.min() >= -1100
    assert [row["scan"] for row in mean.rows] == list(NAMES)
    assert all(row["largest_mm"] < 0.1 for row in mean.rows)


@pytest.mark.parametrize("wrong", ["moved", "region", "name", "grid", "one", "empty"])
def test_scans_that_cannot_be_averaged_are_rejected(tmp_path, wrong):
    regions = ("cyst2", "normal1")

    def image_of(one):
        if one.name != "813":
            return scan(one.acquisition)
        moved = scan(one.acquisition, shift_mm=(1.0, 0.0, 0.0) if wrong == "moved" else (0, 0, 0))
        return replace(moved, grid=replace(GRID, centre_mm=(9.0, -20.0, 900.0))) if wrong == "grid" else moved

    def masks_of(one):
        drawn = masks()
        if one.name == "813" and wrong == "region":
            drawn["cyst2"] = np.roll(drawn["cyst2"], 3, axis=1)
        return drawn

    scans = write(tmp_path, image_of=image_of, masks_of=masks_of)
    if wrong == "name":
        regions = ("cyst2", "spleen")
    if wrong == "one":
        scans = scans[:1]
    text = {
        "moved": r"813/ct: the object is displaced by up to 1\.\d mm relative to .*811/ct",
        "region": r"813/seg.dcm: region cyst2 differs from most of the scans in position",
        "name": r"811/seg.dcm: .*there are: .*cyst1",
        "grid": r"813/ct: is on another grid .* exclude it",
        "one": r"811/ct: is the only scan",
        "empty": r"the regions lie in no object that is denser",
    }[wrong]
    if wrong == "empty":
        scans = write(tmp_path / "b", image_of=lambda _: Volume(np.full(GRID.shape, -1000, np.float32), GRID))
    with pytest.raises(InputError, match=text) as error:
        average_scans(scans, regions, height_mm=8.0)
    assert "\n" not in str(error.value)
