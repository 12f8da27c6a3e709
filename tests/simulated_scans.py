"""A body with inserts, its scans by the chain, and effect selection, for tests of physics and diagnosis."""

import numpy as np

from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections.observed import Scans
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.io.volumes import Volume

# Fan-beam settings in the form of recording.yaml.
SCAN = {
    "trajectory": "circular",
    "source_to_isocentre_mm": 500,
    "source_to_detector_mm": 900,
    "columns": 64,
    "rows": 1,
    "column_pitch_mm": 8.0,
    "row_pitch_mm": 8.0,
    "views": 24,
    "views_per_rotation": 24,
    "start_angle_deg": 0,
    "direction": 1,
    "rotation_time_ms": 240,
}


def body(grid, half_axes_mm, hu, inserts):
    """An elliptic cylinder along z in air, with inserts of other HU.

    inserts   [(center (x, y, z) in mm, radius in mm, HU)]; balls, or cylinders along z where z is None
    """
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    array = np.where((x / half_axes_mm[0]) ** 2 + (y / half_axes_mm[1]) ** 2 < 1, hu, -1000.0)
    for centre, radius, value in inserts:
        along = 0.0 if centre[2] is None else z - centre[2]
        array = np.where((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + along**2 < radius**2, value, array)
    return Volume(array.astype(np.float32), grid)


def noisy_lines(state, repeats, random):
    """Noisy line integrals [repeat, view, row, column] of a state of the chain, relative to its reading in air."""
    air = state.measured_air * state.photons
    return np.stack([-np.log(np.maximum(state.counts(random), 0.5) / air) for _ in range(repeats)])


def scans_of(state, repeats, random, added=0.0):
    """The same with `added` line integrals and the white field; all pixels are usable."""
    lines = (noisy_lines(state, repeats, random) + added).astype(np.float32)
    return Scans(lines, state.measured_air.mean(axis=0) * state.photons, np.ones(lines.shape[1:], bool))


def disc_bench(view_interval_ms):
    """A circle of 40 views and one row, for discs."""
    return circular(
        views=40,
        source_to_isocentre_mm=570.0,
        source_to_detector_mm=1040.0,
        columns=48,
        rows=1,
        column_pitch_mm=8.0,
        row_pitch_mm=8.0,
        view_interval_ms=view_interval_ms,
    )


def chosen(fitter, candidates):
    """Effect selection among candidates, each first fitted alone."""
    baseline = trial(fitter, ())
    return choose(fitter, baseline, candidates)
