"""ROIs that the scan does not cover completely are rejected before the simulation."""

import numpy as np
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.base.parallel_rays import ParallelRays
from virtual_phantom.physics.scenes.line_integrals import check_rois_seen

SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0, column_pitch_mm=8.0, row_pitch_mm=8.0)
GRID = Grid((12, 32, 32), (4.0, 8.0, 8.0))


def roi(slices, x=slice(12, 20)):
    mask = np.zeros(GRID.shape, bool)
    mask[slices, 12:20, x] = True
    return mask


def test_point_on_the_axis_is_covered_up_to_the_cone():
    """Rows reach 2.5 pitches from the middle:

    10 mm at the isocenter, where every view has the same distance to the axis.
    """
    rays = ParallelRays(circular(views=60, columns=64, rows=6, **SCANNER))
    seen = rays.directions_seen(np.array([[0, 0, 9.9], [0, 0, 10.1], [0, 0, -9.9], [0, 0, -10.1]]))
    np.testing.assert_array_equal(seen, [30, 0, 30, 0])


def test_off_axis_point_is_covered_from_its_far_side():
    """At 100 mm, one view covers a height of 12 mm and the opposite one 8 mm; a whole turn has the larger one."""
    rays = ParallelRays(circular(views=60, columns=64, rows=6, **SCANNER))
    seen = rays.directions_seen(np.array([[100.0, 0, 7.9], [100.0, 0, 9.0], [100.0, 0, 12.1]]))
    assert seen[0] == 30 and 0 < seen[1] <= 30 and seen[2] == 0


def test_rois_in_the_beam_pass():
    check_rois_seen(circular(views=60, columns=64, rows=6, **SCANNER), GRID, {"middle": roi(slice(5, 7))})
    check_rois_seen(
        helical(views=200, volume_height_mm=48, columns=64, rows=6, **SCANNER), GRID, {"all": roi(slice(0, 12))}
    )


@pytest.mark.parametrize(
    "geometry",
    [
        circular(views=60, columns=64, rows=6, **SCANNER),
        helical(views=200, volume_height_mm=48, pitch=2.5, columns=64, rows=6, **SCANNER),
        helical(views=60, volume_height_mm=48, turns=1, columns=64, rows=6, **SCANNER),
    ],
    ids=["circular scan of a high volume", "helix with gaps", "short helix"],
)
def test_rois_outside_of_the_beam_are_named(geometry):
    with pytest.raises(InputError, match="ROI high is not seen from every direction: .* more detector rows"):
        check_rois_seen(geometry, GRID, {"high": roi(slice(0, 12))})


def test_roi_outside_of_the_fan_is_named():
    geometry = circular(views=60, columns=24, rows=12, **SCANNER)
    with pytest.raises(InputError, match="ROI far"):
        check_rois_seen(geometry, GRID, {"far": roi(slice(5, 7), slice(28, 32))})


def test_empty_roi_is_named():
    geometry = circular(views=60, columns=64, rows=6, **SCANNER)
    with pytest.raises(InputError, match="ROI nothing has no voxel; remove it"):
        check_rois_seen(geometry, GRID, {"nothing": roi(slice(5, 5))})
