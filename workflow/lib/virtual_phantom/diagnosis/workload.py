"""Amount of data that is fitted, for the preparation of a recording and for the forecast of its run time.

A module with few imports, as every start of the workflow needs it.
"""

from __future__ import annotations

import math

# Rays of one fit, with all rays of a pixel counted, unless `view_step` is set. Two processes need 5 GB.
MOST_FITTED = 2.5e6
FEWEST_VIEWS = 24  # fitted and held-out views of a large scan, which still show changes over the rotation
# Rays per pixel and direction of the model. Shapes have sharp edges. In a scan without missing physics (4 repeats with
# 1e5 photons), the error with 2 rays looks like a source distance with a log score of 25, with 4 rays of 3.
SAMPLES, SAMPLES_OF_SHAPES = 2, 4


def rays_of(shape: tuple[int, int, int], samples: int) -> int:
    """Return the number of rays of a scan, with all rays of a pixel counted.

    Parameters
    ----------
    samples : int
        Rays per pixel and direction; in a fan beam along columns only.
    """
    views, rows, columns = shape
    return views * rows * columns * samples ** (2 if rows > 1 else 1)


def samples_for(stated: int | None, shapes: bool, shape: tuple[int, int, int]) -> int:
    """Return the rays per pixel and direction of a model of projections.

    This is the stated number. Otherwise it is SAMPLES, or for shapes the largest number up to SAMPLES_OF_SHAPES with
    which all views can be fitted.

    Parameters
    ----------
    shapes : bool
        Whether path lengths come from shapes instead of voxels.
    """
    if stated:
        return stated
    counts = range(SAMPLES_OF_SHAPES if shapes else SAMPLES, SAMPLES, -1)
    return next((count for count in counts if rays_of(shape, count) <= MOST_FITTED), SAMPLES)


def step_for(shape: tuple[int, int, int], samples: int) -> int:
    """Return the default step between fitted views, with which fits have at most MOST_FITTED rays.

    The step is odd, because every second view would not show a focal spot that alternates between views.
    """
    step = max(1, math.ceil(rays_of(shape, samples) / MOST_FITTED))
    return min(step + (step + 1) % 2, max(1, (shape[0] // FEWEST_VIEWS - 1) | 1))


def samples_and_step(
    samples: int | None, view_step: int | None, shapes: bool, shape: tuple[int, int, int]
) -> tuple[int, int]:
    """Return rays per pixel and direction, and the step between views, of a fit of projections."""
    samples = samples_for(samples, shapes, shape)
    return samples, view_step or step_for(shape, samples)
