"""Forecast that the job of a diagnosis prints before it fits."""

from __future__ import annotations

from pathlib import Path

from ...base.data import RESOURCES
from ...base.errors import InputError
from ...diagnosis.settings import FitSettings
from ...io.volumes import shape_of
from ..progress.load import slowdown
from ..progress.status import duration_range
from .diagnoses import extent, material_count, rays_text
from .rates import read_rates


def forecast_line(
    name: str, model: FitSettings, shape: tuple[int, int, int], effects: int, processes: int, phantom: str | Path | None
) -> str | None:
    """Return a line with the expected time of a diagnosis; None if it is unknown or no effect is fitted.

    Parameters
    ----------
    name : str
        Name of the recording.
    shape : tuple of 3 int
        Views, rows and columns of the scan.
    effects : int
        Number of candidate effects.
    processes : int
        Number of parallel processes.
    phantom : str, Path or None
        Image of the study's phantom, for a recording of it.
    """
    if not effects:
        return None
    try:
        voxels = () if phantom is None else shape_of(phantom)
        size = extent(model.settings, shape, effects, (voxels, material_count(model.materials)))
        forecast = size.forecast(read_rates(RESOURCES / "rates.yaml"), processes)
    except InputError:
        return None
    if forecast is None:
        return None
    load = slowdown(processes)
    wall = duration_range(*(load * seconds for seconds in forecast.wall))
    cpu = duration_range(*forecast.cpu)
    workers = f"{processes} process{'es' if processes > 1 else ''}"
    amount = f"{effects} effect{'s' if effects > 1 else ''}, {rays_text(size.rays)}"
    return f"diagnosis of {name}: {wall} with {workers} (CPU time {cpu}; {amount})"
