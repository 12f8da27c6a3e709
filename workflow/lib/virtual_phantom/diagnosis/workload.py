"""How much of a recording is fitted, which tells how long its diagnosis takes before it starts.

Apart from `ready`, whose imports take two seconds that every start of the workflow would pay.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

# Rays of one fit, those of a pixel counted one by one, unless `view_step` says otherwise: two processes take some 5 GB
# with them.
MOST_FITTED = 2.5e6
FEWEST_VIEWS = 24  # that are left of a large scan, fitted and held out together: what turns with the gantry still shows
# Rays per pixel and direction of the model. Edges of shapes are as sharp as can be: with 2 per direction, what they
# miss there passes for 25 of log score of a source distance (4 repeats of 1e5 photons, nothing wrong); with 4 for 3.
SAMPLES, SAMPLES_OF_SHAPES = 2, 4


def rays_of(shape: tuple[int, int, int], samples: int) -> int:
    """Rays of a scan, those of a pixel counted one by one.

    Parameters
    ----------
    shape : tuple of 3 int
        Of the scan: views, rows, columns.
    samples : int
        Rays per pixel and direction; those of a fan beam stay in its plane.
    """
    views, rows, columns = shape
    return views * rows * columns * samples ** (2 if rows > 1 else 1)


def is_shapes(section: Mapping) -> bool:
    """Whether a disc or an object of shapes was scanned.

    Parameters
    ----------
    section : mapping
        Of the recording, in the configuration: disc, object.
    """
    return "disc" in section or "kind" in section.get("object", {})


def samples_for(stated: int | None, shapes: bool, shape: tuple[int, int, int]) -> int:
    """Rays per pixel and direction of the model of a recording of projections.

    Parameters
    ----------
    stated : int or None
        What the configuration says.
    shapes : bool
        Whether path lengths come from shapes, and not from voxels.
    shape : tuple of 3 int
        Of the scan: views, rows, columns.

    Returns
    -------
    int
        Those stated. Else of shapes up to SAMPLES_OF_SHAPES, as long as all views can be fitted, and of voxels SAMPLES.
    """
    if stated:
        return stated
    counts = range(SAMPLES_OF_SHAPES if shapes else SAMPLES, SAMPLES, -1)
    return next((count for count in counts if rays_of(shape, count) <= MOST_FITTED), SAMPLES)


def step_for(shape: tuple[int, int, int], samples: int) -> int:
    """One view of so many is fitted where nothing else is said, so that fits have MOST_FITTED rays at most.

    Parameters
    ----------
    shape : tuple of 3 int
        Of the scan: views, rows, columns.
    samples : int
        Rays per pixel and direction.

    Returns
    -------
    int
        Odd: a focal spot that jumps from view to view would stand still in every second one.
    """
    step = max(1, math.ceil(rays_of(shape, samples) / MOST_FITTED))
    return min(step + (step + 1) % 2, max(1, (shape[0] // FEWEST_VIEWS - 1) | 1))


def fitted(samples: int | None, view_step: int | None, shapes: bool, shape: tuple[int, int, int]) -> tuple[int, int]:
    """What of a recording of projections is fitted.

    Parameters
    ----------
    samples, view_step : int or None
        What the configuration says.
    shapes, shape
        As `samples_for` takes them.

    Returns
    -------
    samples : int
        Rays per pixel and direction.
    step : int
        One view of so many.
    """
    samples = samples_for(samples, shapes, shape)
    return samples, view_step or step_for(shape, samples)
