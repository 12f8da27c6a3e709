"""Path lengths through a scene of voxels, however its materials are projected."""

import numpy as np
import pytest
from scanner import SCANNER

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.physics import scene
from virtual_phantom.projectors.cpu import lanes_at_once


@pytest.mark.parametrize("rows, expected", [(20, 1), (4, 2)])
def test_materials_have_the_same_paths_together_and_one_by_one(rows, expected, monkeypatch):
    geometry = circular(views=6, columns=30, rows=rows, column_pitch_mm=8.0, row_pitch_mm=8.0, **SCANNER)
    grid = Grid((20, 24, 24), (4.0, 5.0, 5.0))
    assert lanes_at_once(geometry, grid, 2) == expected
    assert lanes_at_once(geometry, grid, 8) == 8
    fractions = np.random.default_rng(0).random((2, *grid.shape), np.float32)
    paths = []
    for together in (1, 2):
        monkeypatch.setattr(scene, "lanes_at_once", lambda *_: together)  # noqa: B023
        paths.append(scene.VoxelScene(fractions, grid, ("water", "cortical_bone"), 60.0).path_lengths(geometry))
    assert paths[0].any()
    np.testing.assert_allclose(*paths, atol=3e-6 * paths[1].max())
