"""Amount of data that is fitted, for the preparation of a recording and for the forecast of its run time.

A module with few imports, as every start of the workflow needs it.
"""

from __future__ import annotations

import math

# Rays of one fit, with all rays of a pixel counted, unless `view_step` is set. Two processes need 5 GB.
MOST_FITTED = 2.5e6
FEWEST_VIEWS = 24  # fitted and held-out views of a large scan, which still show changes over the rotation
SAMPLES = 2  # rays per pixel and direction of the model


def rays_of(shape: tuple[int, int, int], samples: int) -> int:
    """Return the number of rays of a scan, with all rays of a pixel counted.

    Parameters
    ----------
    samples : int
        Rays per pixel and direction; in a fan beam along columns only.
    """
    views, rows, columns = shape
    return views * rows * columns * samples ** (2 if rows > 1 else 1)


def step_for(shape: tuple[int, int, int], samples: int) -> int:
    """Return the default step between fitted views, with which fits have at most MOST_FITTED rays.

    The step is odd, because every second view would not show a focal spot that alternates between views.
    """
    step = max(1, math.ceil(rays_of(shape, samples) / MOST_FITTED))
    return min(step + (step + 1) % 2, max(1, (shape[0] // FEWEST_VIEWS - 1) | 1))


def samples_and_step(samples: int | None, view_step: int | None, shape: tuple[int, int, int]) -> tuple[int, int]:
    """Return rays per pixel and direction, and the step between views, of a fit of projections."""
    samples = samples or SAMPLES
    return samples, view_step or step_for(shape, samples)
