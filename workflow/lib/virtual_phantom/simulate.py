"""From a phantom in HU to clean line integrals."""

from __future__ import annotations

import numpy as np

from .errors import InputError
from .geometry import ScanGeometry
from .projectors.cpu import CpuProjector
from .units import hu_to_attenuation
from .volumes import Volume


def clean_line_integrals(
    phantom: Volume, geometry: ScanGeometry, mu_water_per_mm: float, threads: int = 1
) -> np.ndarray:
    """Monochromatic line integrals [view, row, column] of a phantom in HU, whatever its sampling.

    One pass over a fine grid takes seconds, so it runs on the CPU engine whatever the study reconstructs with. Raises
    InputError if the phantom holds no number, or reaches out of the cylinder that every view sees.
    """
    if not np.isfinite(phantom.array).all():
        raise InputError("phantom image: holds NaN or infinite voxels; repair the CT that it was made from")
    _refuse_truncation(phantom, geometry)
    projector = CpuProjector(geometry, phantom.grid, threads=threads)
    volume = projector.pack_volume(hu_to_attenuation(phantom.array, mu_water_per_mm)[None])
    return projector.unpack_projections(projector.forward(volume))[0]


def _refuse_truncation(phantom, geometry, threshold_hu=-500.0):
    """Matter outside the field of view would make streaks that no reconstruction here allows for."""
    _, y, x = phantom.grid.axes_mm()
    occupied = (phantom.array > threshold_hu).any(axis=0)
    reach = float(np.max(np.hypot(y[:, None], x[None, :]), where=occupied, initial=0))
    radius = geometry.field_of_view_radius_mm
    if reach > radius:
        raise InputError(
            f"scan: the phantom reaches {reach:.0f} mm from the isocentre, the field of view only {radius:.0f} mm; "
            "give the detector more columns or a larger column_pitch_mm, or move the phantom's centre"
        )
