"""Rays that leave a volume through an end at which the object is cut."""

import numpy as np
import pytest

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.projections.lost_rays import LEAST_MISSING, truncation_of
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene

GEOMETRY = circular(
    views=24,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=900.0,
    columns=32,
    rows=8,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
)


def cylinder(slices, air=0, amount=1.0, noise=0.0):
    """Water of 100 mm in voxels of 2 mm, `air` slices beyond either end."""
    y, x = np.mgrid[:60, :60] - 29.5
    volume = np.full((1, slices + 2 * air, 60, 60), noise, np.float32)
    volume[0, air : air + slices, np.hypot(y, x) < 25] = amount
    return VoxelScene(volume, Grid(volume.shape[1:], (2.0, 2.0, 2.0)), ("water",), 60.0)


def test_missing_length_equals_that_of_a_longer_volume():
    cut, whole = cylinder(14), cylinder(60)
    found = truncation_of(PosedScene(cut), GEOMETRY)
    missing = cut.attenuation_per_mm[0] * (whole.path_lengths(GEOMETRY) - cut.path_lengths(GEOMETRY))[0]
    assert found.share == pytest.approx(np.mean(missing > LEAST_MISSING), abs=0.01)
    assert found.most == pytest.approx(missing.max(), rel=0.01)
    assert "3.8 mm longer on each side" in found.remark[0]
    # With the stated length, nothing is missing.
    assert not truncation_of(cylinder(14 + 2 * int(np.ceil(found.height_mm / 2))), GEOMETRY).remark


@pytest.mark.parametrize("scene", [cylinder(60), DiscScene(100.0, "water")], ids=["long", "disc"])
def test_object_longer_than_the_beam_is_complete(scene):
    assert not truncation_of(scene, GEOMETRY).remark


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_object_within_its_volume_is_not_cut(noise):
    assert not truncation_of(cylinder(14, air=1, noise=noise), GEOMETRY).remark
