"""Minimum grid size, in the order of the keys; a wrong axis order is named."""

import pytest

from virtual_phantom.base.geometry import Grid
from virtual_phantom.phantom.grid_size import minimum_shape, suggest_size

BODY = (40.0, 270.0, 360.0)  # z, y, x


def test_minimum_number_of_voxels_that_cover_the_object():
    grid = Grid((20, 100, 100), (2.0, 2.5, 2.5))
    assert minimum_shape(grid, BODY) == [20, 108, 144]
    assert suggest_size(grid, BODY) == "set grid.shape to at least [20, 108, 144] (z, y, x) at this grid.spacing_mm"


@pytest.mark.parametrize(
    ("shape", "spacing", "said"),
    [
        (
            (144, 108, 20),
            (2.0, 2.5, 2.5),
            "grid.shape [144, 108, 20] looks like x, y, z; write z, y, x: [20, 108, 144]",
        ),
        ((20, 135, 144), (2.5, 2.5, 2.0), "grid.spacing_mm [2.5, 2.5, 2.0] looks like x, y, z; write z, y, x: [2.0, 2"),
        ((144, 108, 20), (2.5, 2.5, 2.0), "[20, 108, 144] and grid.spacing_mm [2.5, 2.5, 2.0] looks like x, y, z"),
    ],
)
def test_wrong_axis_order_is_named(shape, spacing, said):
    assert said in suggest_size(Grid(shape, spacing), BODY)
    # The object may extend beyond the required range.
    assert said in suggest_size(Grid(shape, spacing), (0.0, *BODY[1:]), BODY)


def test_almost_cubic_voxels_are_not_called_a_wrong_order():
    """A body 3 % too wide, which happens to fit if the sides of 4 and 3.8 mm are swapped."""
    grid = Grid((10, 70, 96), (4.0, 3.8, 3.8))
    assert suggest_size(grid, (40.0, 261.0, 375.0)) == (
        "set grid.shape to at least [10, 70, 99] (z, y, x) at this grid.spacing_mm"
    )
