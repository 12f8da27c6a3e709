"""A grid off the isocenter, compared with the same object in a larger grid around it."""

import numpy as np
import pytest

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.projectors.cpu import CpuProjector

GEOMETRY = circular(
    views=40,
    source_to_isocentre_mm=400.0,
    source_to_detector_mm=700.0,
    columns=60,
    rows=20,
    column_pitch_mm=4.0,
    row_pitch_mm=4.0,
)


def projected(volume, grid, **place):
    projector = CpuProjector(GEOMETRY, grid, **place)
    packed = projector.pack_volume(volume[None].astype(np.float32))
    return projector, packed, projector.unpack_projections(projector.forward(packed))[0]


@pytest.mark.parametrize("shift", [(0, 0, 0), (5, -8, 3), (-7, 6, -2)])
def test_cropped_part_projects_like_the_whole(shift):
    """shift in voxels (x, y, z)."""
    spacing = (2.0, 1.5, 2.5)
    part = np.random.default_rng(1).random((8, 12, 10))
    whole = np.zeros((20, 40, 36))
    x, y, z = shift
    whole[6 + z : 14 + z, 14 + y : 26 + y, 13 + x : 23 + x] = part
    centre = (x * spacing[2], y * spacing[1], z * spacing[0])
    right = projected(whole, Grid(whole.shape, spacing))[2]
    found = projected(part, Grid(part.shape, spacing), centre_mm=centre)[2]
    assert right.max() > 5
    np.testing.assert_allclose(found, right, atol=2e-5 * right.max())


def test_back_projection_uses_the_grid_position():
    """<forward(x), y> = <x, adjoint(y)>, and the voxel-driven back-projection peaks at a point."""
    grid, centre = Grid((8, 12, 10), (2.0, 1.5, 2.5)), (12.0, -9.0, 5.0)
    random = np.random.default_rng(2)
    volume = random.random(grid.shape)
    projector, packed, forward = projected(volume, grid, centre_mm=centre)
    other = random.random(forward.shape).astype(np.float32)
    back = projector.unpack_volume(projector.adjoint(projector.pack_projections(other[None])))[0]
    assert (forward * other).sum() == pytest.approx((volume * back).sum(), rel=1e-5)
    point = np.zeros(grid.shape)
    point[3, 8, 2] = 1
    projector, _, forward = projected(point, grid, centre_mm=centre)
    image = projector.unpack_volume(projector.back(projector.pack_projections(forward[None])))[0]
    assert np.unravel_index(image.argmax(), image.shape) == (3, 8, 2)
