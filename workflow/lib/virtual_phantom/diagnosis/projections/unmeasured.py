"""Projections that measured nothing: what of them is too little, and what is said of it."""

from __future__ import annotations

import numpy as np

from ...base.errors import InputError
from .observed import LEAST_TRANSMISSION, Scans

LEAST_VIEWS = 16  # fewer cannot tell the object's place from its physics
MOST_LOST = 0.5  # share of rays that measured nothing
MENTIONED_LOST = 0.001  # share of rays that is worth a remark


def check_scans(taken: Scans, source: str) -> None:
    """Check that a diagnosis can be made of repeats.

    Parameters
    ----------
    source : str
        What the message begins with.

    Raises
    ------
    InputError
        For too few views, or most rays without signal.
    """
    views = taken.usable.shape[0]
    if views < LEAST_VIEWS:
        raise InputError(f"{source}: {views} views are too few for a diagnosis; it needs {LEAST_VIEWS}")
    lost = 1 - taken.usable.mean()
    if lost > MOST_LOST:
        raise InputError(
            f"{source}: {100 * lost:.0f} % of the rays measured nothing (under {LEAST_TRANSMISSION:g} of air) or were "
            "saturated; is the white field another scan's, or the object opaque?"
        )


def lost_rays(usable: np.ndarray) -> list[str]:
    """A sentence for the report about rays that do not count.

    Parameters
    ----------
    usable : ndarray of bool, shape (views, rows, columns)

    Returns
    -------
    list of str
        Empty if there are hardly any.
    """
    lost = 1 - usable.mean()
    if lost <= MENTIONED_LOST:
        return []
    return [
        f"{100 * lost:.2g} % of the rays measured nothing, or stood at the detector's saturation, in some repeat; they "
        "were left out."
    ]
