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
