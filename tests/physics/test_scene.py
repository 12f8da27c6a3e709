"""Path lengths through a scene of voxels: against the study's projector, and all rays of a pixel at once."""

from dataclasses import replace

import numpy as np
import pytest
from scanner import SCANNER

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.physics.scenes.sampling import average_rays, pixel_quadrature, supersampled
from virtual_phantom.physics.scenes.scene import Pose, VoxelScene
from virtual_phantom.projectors.cpu import CpuProjector

GRID = Grid((20, 24, 24), (4.0, 5.0, 5.0))
PLACED = Pose(x_mm=3.0, y_mm=-2.0, z_mm=1.0, turn_deg=20.0)


def scan(rows, pitch_mm, trajectory=circular, **more):
    return trajectory(views=6, columns=30, rows=rows, column_pitch_mm=8.0, row_pitch_mm=pitch_mm, **SCANNER, **more)


@pytest.fixture(scope="module")
def scene():
    fractions = np.random.default_rng(0).random((2, *GRID.shape), np.float32)
    fractions[1, :, :8] = 0  # empty lines of voxels
    return VoxelScene(fractions, GRID, ("water", "cortical_bone"), 60.0)


HELIX = dict(trajectory=helical, volume_height_mm=80.0, pitch=0.7)


@pytest.mark.parametrize(
    "rows, pitch_mm, more", [(4, 8.0, {}), (7, 30.0, {}), (20, 8.0, {}), (20, 3.0, {}), (40, 5.0, {}), (9, 8.0, HELIX)]
)
def test_path_lengths_equal_the_projector(scene, rows, pitch_mm, more):
    """The study's kernel projects each volume separately, row by row."""
    geometry = scan(rows, pitch_mm, **more)
    projector = CpuProjector(geometry, GRID)
    found = scene.path_lengths(geometry)
    for one, volume in zip(found, scene.amounts, strict=True):
        expected = projector.unpack_projections(projector.forward(projector.pack_volume(volume[None])))[0]
        assert expected.any()
        np.testing.assert_allclose(one, expected, atol=3e-6 * expected.max())


@pytest.mark.parametrize(
    "samples, rows, more", [(2, 4, {}), (3, 5, {}), (2, 1, {}), (2, 4, {"surface": "cylindrical"})]
)
@pytest.mark.parametrize("roll", [0.0, 0.3])
def test_all_rays_of_a_pixel_at_once_equal_single_rays(scene, samples, rows, more, roll):
    geometry = rolled(scan(rows, 8.0, column_offset_px=0.2, **more), roll)
    ((together, weights),) = supersampled(geometry, samples)
    found = average_rays(np.exp(-0.02 * scene.path_lengths(together, PLACED)), weights)
    expected = sum(
        weight * np.exp(-0.02 * scene.path_lengths(displaced_rays(geometry, *place), PLACED))
        for place, weight in pixel_quadrature(samples, rows > 1)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def rolled(geometry, roll):
    """Rotate the detector about its normal."""
    if not roll:
        return geometry
    columns, rows = geometry.column_direction, geometry.row_direction
    along, up = np.cos(roll) * columns + np.sin(roll) * rows, np.cos(roll) * rows - np.sin(roll) * columns
    return replace(geometry.by_vectors(), column_direction=along, row_direction=up)


def displaced_rays(geometry, column, row):
    """The geometry of the rays to one position in every pixel."""
    places = {"column_offset_px": geometry.column_offset_px + column, "row_offset_px": geometry.row_offset_px + row}
    return replace(geometry, **places)


def test_many_rays_are_processed_in_parts(scene, monkeypatch):
    geometry = scan(4, 8.0)
    ((together, weights),) = supersampled(geometry, 2)
    whole = average_rays(scene.path_lengths(together), weights)
    for most, parts in ((2 * np.prod(geometry.shape), 2), (1, 4)):
        monkeypatch.setattr("virtual_phantom.physics.scenes.sampling.MAX_RAYS", int(most))
        made = supersampled(geometry, 2)
        assert len(made) == parts
        found = sum(average_rays(scene.path_lengths(one), share) for one, share in made)
        np.testing.assert_allclose(found, whole, rtol=1e-6)


def test_grid_that_contains_the_source_is_rejected(scene):
    with pytest.raises(InputError, match="outside the source's orbit"):
        scene.path_lengths(scan(4, 8.0), Pose(x_mm=1000.0))
