"""Masks of the phantom, as later stages read them."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.io import files
from virtual_phantom.io.volumes import Volume, write_nifti


def test_masks_are_read_with_their_table_and_must_lie_on_the_images_grid(tmp_path):
    grid = Grid((4, 5, 6), (2.0, 1.0, 1.0))
    mask = np.zeros((4, 5, 6), np.uint8)
    mask[1, 2:4, 3] = 1
    write_nifti(Volume(mask, grid), tmp_path / "rois" / "spot.nii.gz")
    files.write_text("roi,tissue_class,label\nspot,cyst,1\n", tmp_path / "rois.csv")
    table, masks = phantom.read_masks(tmp_path / "rois.csv", grid)
    assert list(table["tissue_class"]) == ["cyst"]
    assert masks["spot"].dtype == bool and np.array_equal(masks["spot"], mask > 0)
    with pytest.raises(InputError, match=r"spot\.nii\.gz: is on another grid"):
        phantom.read_masks(tmp_path / "rois.csv", replace(grid, centre_mm=(0, 0, 2.0)))
    with pytest.raises(InputError, match=r"rois\.csv: lacks the column\(s\) tissue_class"):
        files.write_text("roi\nspot\n", tmp_path / "rois.csv")
        phantom.read_masks(tmp_path / "rois.csv", grid)


def test_images_come_with_the_rois_of_their_own_table(tmp_path):
    grid, other = Grid((4, 5, 6), (2.0, 1.0, 1.0)), Grid((2, 5, 6), (4.0, 1.0, 1.0))
    for name, own, tissue in (("a", grid, "cyst"), ("b", other, "liver")):
        write_nifti(Volume(np.ones(own.shape, np.uint8), own), tmp_path / name / "rois" / "spot.nii.gz")
        files.write_text(f"roi,tissue_class,label\nspot,{tissue},1\n", tmp_path / name / "rois.csv")
        write_nifti(Volume(np.zeros(own.shape, np.int16), own), tmp_path / f"{name}.nii.gz")
    paths = [tmp_path / "a.nii.gz", tmp_path / "a.nii.gz", tmp_path / "b.nii.gz"]
    tables = [tmp_path / "a" / "rois.csv"] * 2 + [tmp_path / "b" / "rois.csv"]
    found = list(phantom.images_with_rois(paths, tables))
    assert [(image.grid.shape, classes) for image, _, classes in found] == [
        (grid.shape, {"spot": "cyst"}),
        (grid.shape, {"spot": "cyst"}),
        (other.shape, {"spot": "liver"}),
    ]
    assert found[0][1] is found[1][1]  # read once
    with pytest.raises(InputError, match=r"b\.nii\.gz: is on another grid .* than the ROIs"):
        list(phantom.images_with_rois(paths[1:], [tables[0]] * 2))
