"""How differences of a kind of recording are looked at: tested by place, summed up in its unit, and drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .locate import Location, locate
from .uncertainty import left_by_numbers


@dataclass(frozen=True)
class Look:
    """What differs between recordings of projections and of images.

    places       (residuals, weights, data, pattern's variance) to Locations
    difference   (prepared, fit, held_out) to recorded less modelled, where rays or voxels count, in `unit`
    unit         as metrics name it
    summed       axis of the data that maps are summed over
    down, across   names of the map's axes
    profiles     (domain, name of its axis, number of its first place)
    one_repeat   where the noise of a recording with a single repeat is from
    uncertain    (fitter, fit) to what the errors of a fit's numbers add to residuals, as `places` takes it; None: that
                 is left out
    """

    places: Callable[..., list[Location]]
    difference: Callable[..., np.ndarray]
    unit: str
    summed: int
    down: str
    across: str
    profiles: tuple[tuple[str, str, int], ...]
    one_repeat: str
    uncertain: Callable[..., list[np.ndarray]] | None = None


def _line_integrals(prepared, fit, held_out: bool) -> np.ndarray:
    data = prepared.held_out if held_out else prepared.data
    whitened = prepared.fitter.residuals(fit, held_out)[0].reshape(data.mean.shape)
    return data.as_recorded(whitened)[data.usable]


PROJECTIONS = Look(
    places=locate,
    difference=_line_integrals,
    unit="line_integral",
    summed=1,
    down="view",
    across="detector column",
    profiles=(("columns", "detector column", 0), ("views", "view", 0), ("path length", "line integral (tenth)", 1)),
    one_repeat="was taken from second differences of neighbouring views, so variances and correlations were not tested",
    uncertain=left_by_numbers,
)
