"""Extreme values: the result is defined, or the study stops and states the reason.

docs/reference/stability.md lists what is defined.
"""

import ast
import warnings
from pathlib import Path

import nibabel
import numpy as np
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import FbpSettings, SirtSettings
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.features.extraction import FEATURES, RadiomicsWarning, extract
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume, read_nifti, write_nifti
from virtual_phantom.phantom.ct import read_hu
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.simulation.acquire import simulate_counts
from virtual_phantom.simulation.reconstruct import reconstruct

ROOT = Path(__file__).resolve().parents[2]
SEED = np.random.SeedSequence(5)
MU = 0.0193
SIRT = defaults_of("reconstruction", "sirt") | {"iterations": 100, "terms": 25}
SETTINGS = {"sirt": SirtSettings(**SIRT), "fbp": FbpSettings("coverage")}


def disc(grid: Grid, radius_mm: float = 30.0, hu: float = 0.0) -> Volume:
    """A cylinder along z in air."""
    z, y, x = np.ix_(*grid.axes_mm())
    inside = np.hypot(x, y) + 0 * z < radius_mm
    return Volume(np.where(inside, hu, HU_AIR).astype(np.float32), grid)


def scan(grid: Grid, columns: int = 64, rows: int = 1):
    pitch = 2.0 * max(grid.extent_mm[1:]) / columns
    return circular(
        views=60,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=columns,
        rows=rows,
        column_pitch_mm=pitch,
        row_pitch_mm=2 * grid.extent_mm[0] / rows,
    )


def images(line_integrals, geometry, grid, algorithm):
    data = np.asarray(line_integrals, np.float32)[None]
    return reconstruct(data, geometry, grid, algorithm, SETTINGS[algorithm], engine="cpu", mu_water_per_mm=MU)


@pytest.mark.parametrize("algorithm", ["sirt", "fbp"])
@pytest.mark.parametrize(
    "shape, spacing",
    [((1, 32, 32), (2.0, 2.5, 2.5)), ((3, 32, 32), (40.0, 2.5, 2.5)), ((24, 32, 32), (0.05, 2.5, 2.5))],
    ids=["one slice", "slices 16 times as thick as wide", "slices a fiftieth as thick as wide"],
)
def test_water_has_0_hu_in_one_slice_and_in_voxels_of_any_shape(shape, spacing, algorithm):
    grid = Grid(shape, spacing)
    geometry = scan(grid, rows=1 if shape[0] == 1 else 2 * shape[0])
    (image,) = images(clean_line_integrals(disc(grid), geometry, MU), geometry, grid, algorithm)
    middle = image.array[shape[0] // 2, 12:20, 12:20]
    assert abs(middle.mean()) < 40, middle.mean()


@pytest.mark.parametrize("model", ["astra", "physical"])
@pytest.mark.parametrize("algorithm", ["sirt", "fbp"])
def test_scan_without_photons_gives_finite_images(model, algorithm):
    grid = Grid((1, 32, 32), (2.0, 2.5, 2.5))
    geometry = scan(grid)
    counts = simulate_counts(clean_line_integrals(disc(grid, hu=3000.0), geometry, MU), 1.0, model, SEED)
    assert (counts.data == 0).mean() > 0.1
    lines = counts.line_integrals(0.5)
    assert np.isfinite(lines).all() and lines.max() == pytest.approx(-counts.scale * np.log(0.5))
    assert np.isfinite(images(lines, geometry, grid, algorithm)[0].array).all()


def test_scan_of_air_is_rejected_or_pure_noise():
    with pytest.raises(InputError, match="the phantom attenuates no ray"):
        simulate_counts(np.zeros((2, 3, 4)), 1e-4, "astra", SEED)
    counts = simulate_counts(np.zeros((20, 30, 40)), 1e-4, "physical", SEED)
    assert counts.data.mean() == pytest.approx(1e4, rel=1e-3)


@pytest.mark.filterwarnings("ignore:invalid value")  # from infinities, before they are rejected
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_numbers_stop_every_stage(bad, tmp_path):
    grid = Grid((1, 32, 32), (2.0, 2.5, 2.5))
    phantom, geometry = disc(grid), scan(grid)
    lines = clean_line_integrals(phantom, geometry, MU)
    phantom.array[0, 5, 5] = bad
    with pytest.raises(InputError, match="NaN or infinite"):
        clean_line_integrals(phantom, geometry, MU)
    lines[3, 0, 7] = bad
    with pytest.raises(InputError, match="NaN or infinite"):
        simulate_counts(lines, 1e-4, "physical", SEED)
    for algorithm in SETTINGS:
        with pytest.raises(InputError, match="NaN or infinite"):
            images(lines, geometry, grid, algorithm)
    write_nifti(phantom, tmp_path / "ct.nii.gz")
    with pytest.raises(InputError, match="NaN or infinite"):
        read_hu(tmp_path / "ct.nii.gz")
    with pytest.raises(InputError):
        extract(phantom, {"roi": np.ones(grid.shape, bool)}, "image")


def test_numbers_beyond_single_precision_are_rejected(tmp_path):
    array = np.full((4, 4, 4), -1000.0)
    array[1, 1, 1] = 1e300
    nibabel.save(nibabel.Nifti1Image(array, np.eye(4)), tmp_path / "ct.nii.gz")
    with pytest.warns(RuntimeWarning, match="overflow"), pytest.raises(InputError, match="NaN or infinite"):
        read_hu(tmp_path / "ct.nii.gz")


def test_hu_beyond_sixteen_bits_are_clipped_with_a_warning():
    grid = Grid((1, 32, 32), (2.0, 2.5, 2.5))
    geometry = scan(grid)
    lines = clean_line_integrals(disc(grid), geometry, MU) * 60
    with pytest.warns(UserWarning, match="voxels are beyond -32768 to 32767 HU"):
        (image,) = images(lines, geometry, grid, "sirt")
    assert image.array.max() == 32767


def test_constant_roi_has_finite_features_and_a_warning():
    grid = Grid((5, 8, 8), (2.0, 2.0, 2.0))
    with pytest.warns(RadiomicsWarning, match="fills 1 gray-level bins"):
        table = extract(Volume(np.full(grid.shape, 40.0, np.float32), grid), {"flat": np.ones(grid.shape, bool)}, "one")
    row = table.iloc[0]
    assert row["original_firstorder_Variance"] == 0 and row["original_firstorder_Mean"] == 40
    assert np.isfinite(row[list(FEATURES)].to_numpy(float)).all()


def test_roi_of_one_voxel_is_rejected():
    grid = Grid((5, 8, 8), (2.0, 2.0, 2.0))
    mask = np.zeros(grid.shape, bool)
    mask[2, 3, 4] = True
    with pytest.raises(InputError, match="has 1 voxels; textures need neighbors"):
        extract(Volume(np.zeros(grid.shape, np.float32), grid), {"dot": mask}, "image")


def test_no_warning_is_suppressed():
    """No filter hides a warning. Floating-point errors are ignored only by name, where 0/0 or 1/0 has a meaning."""
    found = 0
    for path in (ROOT / "workflow").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            name = ast.unparse(node.func).rsplit(".", 1)[-1]
            assert name not in ("filterwarnings", "seterr"), f"{path}: {node.lineno}"
            if name == "simplefilter":
                assert ast.unparse(node.args[0]) in ("'default'", "'error'"), f"{path}: {node.lineno}"
            if name == "catch_warnings":  # without record=True it hides nothing: it limits the filters to its block
                assert not node.keywords, f"{path}: {node.lineno}"
            if name == "errstate":
                found += 1
                allowed = {keyword.arg for keyword in node.keywords}
                assert allowed <= {"divide", "invalid"}, f"{path}: {node.lineno}"
    assert found > 5


def test_volume_of_one_voxel_is_written_and_read(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        voxel = Volume(np.full((1, 1, 1), 7.0, np.float32), Grid((1, 1, 1), (5.0, 0.1, 0.1)))
        write_nifti(voxel, tmp_path / "a.nii.gz")
        assert read_nifti(tmp_path / "a.nii.gz").array.item() == 7.0
