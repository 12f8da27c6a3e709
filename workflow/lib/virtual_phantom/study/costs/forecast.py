"""How long a diagnosis is going to take, as its job says it before it fits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ...base.data import RESOURCES
from ...base.errors import InputError
from ...io.volumes import shape_of
from ..progress.load import slowdown
from ..progress.status import duration_range
from .diagnoses import extent, materials_of, rays_in_words
from .rates import read_rates


def beforehand(
    name: str,
    model: Mapping,
    shape: tuple[int, int, int],
    effects: int,
    processes: int,
    phantom: str | Path | None,
) -> str | None:
    """The line that the job of a recording of projections says before it fits.

    Parameters
    ----------
    name : str
        Of the recording.
    model : mapping
        As study.diagnosed.Diagnosis.model gives it.
    shape : tuple of 3 int
        Of the scan: views, rows, columns.
    effects : int
        That are tried.
    processes : int
        Side by side.
    phantom : str, Path or None
        Image of the study's phantom, if that was scanned.

    Returns
    -------
    str or None
        None where the time is not known, and where no effect is tried.
    """
    if not effects:
        return None
    try:
        voxels = () if phantom is None else shape_of(phantom)
        found = extent(model["settings"], shape, effects, (voxels, materials_of(model["materials"])))
        forecast = found.forecast(read_rates(RESOURCES / "rates.yaml"), processes)
    except InputError:
        return None
    if forecast is None:
        return None
    load = slowdown(processes)
    wall = duration_range(*(load * seconds for seconds in forecast.wall))
    side_by_side = f"{processes} process{'es' if processes > 1 else ''}"
    counted = f"{effects} effect{'s' if effects > 1 else ''}, {rays_in_words(found.rays)}"
    return f"diagnosis of {name}: {wall} with {side_by_side} (CPU time {duration_range(*forecast.cpu)}; {counted})"
