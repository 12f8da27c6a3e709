"""Files are written completely or not at all and reproducibly; broken files are named."""

import h5py
import numpy as np
import pandas as pd
import pytest
import SimpleITK as sitk
from scanner import SCANNER

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, helical
from virtual_phantom.io import exchange, files
from virtual_phantom.io.volumes import Volume, read_nifti, write_nifti
from virtual_phantom.simulation.acquire import simulate_counts

GEOMETRY = helical(
    views=5,
    volume_height_mm=20,
    **SCANNER,
    columns=7,
    rows=3,
    column_pitch_mm=2.0,
    row_pitch_mm=4.0,
    column_offset_px=0.25,
)


def volume(dtype=np.float32):
    random = np.random.default_rng(0)
    return Volume(random.integers(-1000, 1000, (3, 4, 5)).astype(dtype), Grid((3, 4, 5), (2, 1.5, 1), (10, -20, 30)))


def test_failed_write_keeps_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "table.csv"
    target.write_text("old")
    with pytest.raises(RuntimeError), files.replacing(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_csv_is_read_back_bit_for_bit(tmp_path):
    table = pd.DataFrame({"x": np.random.default_rng(1).random(50) * 1e-7})
    files.write_csv(table, tmp_path / "a" / "t.csv")
    np.testing.assert_array_equal(pd.read_csv(tmp_path / "a" / "t.csv")["x"], table["x"])


@pytest.mark.parametrize("dtype", [np.float32, np.int16, np.uint8])
def test_nifti_round_trip_and_voxel_positions_in_simpleitk(tmp_path, dtype):
    original = volume(dtype)
    path = tmp_path / "v.nii.gz"
    write_nifti(original, path)
    back = read_nifti(path, dtype)
    np.testing.assert_array_equal(back.array, original.array)
    assert back.grid.matches(original.grid)
    image = sitk.ReadImage(str(path))
    np.testing.assert_array_equal(sitk.GetArrayFromImage(image), original.array)
    # SimpleITK's world is LPS: x and y have the opposite sign.
    world = np.array(image.TransformIndexToPhysicalPoint((4, 3, 2))) * (-1, -1, 1)
    np.testing.assert_allclose(world, (original.grid.affine @ (4, 3, 2, 1))[:3], atol=1e-4)


def test_equal_volumes_make_equal_bytes(tmp_path):
    for name in ("a", "b"):
        write_nifti(volume(), tmp_path / f"{name}.nii.gz")
    assert (tmp_path / "a.nii.gz").read_bytes() == (tmp_path / "b.nii.gz").read_bytes()


def test_broken_nifti_is_named(tmp_path):
    path = tmp_path / "v.nii.gz"
    with pytest.raises(InputError, match="no such file"):
        read_nifti(path)
    write_nifti(volume(), path)
    files.checksum_path(path).unlink()
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match=r"v\.nii\.gz: cannot be read as NIfTI"):
        read_nifti(path)


def test_projection_files_round_trip(tmp_path):
    line_integrals = np.random.default_rng(2).random((5, 3, 7)).astype(np.float32)
    exchange.write_line_integrals(tmp_path / "clean.h5", line_integrals, GEOMETRY)
    back, geometry = exchange.read_line_integrals(tmp_path / "clean.h5")
    np.testing.assert_array_equal(back, line_integrals)
    np.testing.assert_array_equal(geometry.angles_rad, GEOMETRY.angles_rad)
    np.testing.assert_array_equal(geometry.source_z_mm, GEOMETRY.source_z_mm)
    assert geometry.column_offset_px == 0.25 and geometry.views_per_rotation == GEOMETRY.views_per_rotation

    counts = simulate_counts(line_integrals, 1e-3, "astra", np.random.SeedSequence(1))
    exchange.write_counts(tmp_path / "noisy.h5", counts, GEOMETRY)
    again, _ = exchange.read_counts(tmp_path / "noisy.h5")
    np.testing.assert_array_equal(again.line_integrals(0.5), counts.line_integrals(0.5))
    with h5py.File(tmp_path / "noisy.h5") as file:
        np.testing.assert_allclose(file["exchange/theta"], np.rad2deg(GEOMETRY.angles_rad))
        assert file["exchange/data_white"].shape == (1, 3, 7)


def test_broken_projection_files_are_named(tmp_path):
    path = tmp_path / "clean.h5"
    with pytest.raises(InputError, match="no such file"):
        exchange.read_line_integrals(path)
    exchange.write_line_integrals(path, np.zeros((5, 3, 7), np.float32), GEOMETRY)
    with pytest.raises(InputError, match="line integrals, not counts"):
        exchange.read_counts(path)
    files.checksum_path(path).unlink()
    with h5py.File(path, "a") as file:
        del file["acquisition"]
    with pytest.raises(InputError, match="not a complete projection file"):
        exchange.read_line_integrals(path)
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="not a complete HDF5 file"):
        exchange.read_line_integrals(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no such file"), ("", "cannot be read"), ("a,b\n1,2\n1,2,3\n", "cannot be read")],
)
def test_unreadable_tables(tmp_path, content, message):
    path = tmp_path / "table.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=message) as error:
        files.read_csv(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_parquet_keeps_types_and_leaves_no_partial_file(tmp_path):
    table = pd.DataFrame({"hash": ["012", "9e9"], "n": [1, 2], "x": [0.1, np.nan]})
    files.write_parquet(table, tmp_path / "a" / "t.parquet")
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "a" / "t.parquet"), table)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["t.parquet"]
