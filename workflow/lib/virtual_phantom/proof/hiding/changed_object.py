"""Objects that are not the phantom that the diagnosis is told of: a table, an arm beside the beam, a wrong insert."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.geometry import Grid
from ...io.volumes import Volume
from .objects import MARGIN, Object

AIR_HU, ARM_HU = -1000.0, 40.0
GAP_MM = 3.0  # between the phantom's grid and what is added
TABLE_WIDTH = 0.8  # of the phantom's


def changed(fine: Volume, one: Object, settings: Mapping) -> Volume:
    """The phantom with what is concealed of the object.

    Parameters
    ----------
    fine : Volume
        HU.
    settings : mapping
        What is concealed, by the names of Scan.settings.

    Returns
    -------
    Volume
        `fine` itself, where nothing of the object is; else on a grid that may reach farther, with the same middle.
    """
    if thick := settings.get("table_mm", 0.0):
        return _table(fine, thick, settings["table_hu"])
    if radius := settings.get("arm_radius_mm", 0.0):
        return _arm(fine, one, radius, settings["arm_side"], settings["arm_height_mm"])
    if hu := settings.get("insert_hu", 0.0):
        return _insert(fine, hu, settings["insert_at"], settings["insert_radius_mm"])
    return fine


def _wider(fine: Volume, axis: int, by_mm: float) -> Volume:
    """Air on both sides along an axis."""
    spacing = fine.grid.spacing
    many = int(np.ceil(by_mm / spacing[axis]))
    padding = [(many, many) if place == axis else (0, 0) for place in range(3)]
    array = np.pad(fine.array, padding, constant_values=AIR_HU)
    return Volume(array, Grid(array.shape, spacing))


def _table(fine: Volume, thick_mm: float, hu: float) -> Volume:
    """A plate under the phantom, as long as that is."""
    bottom = -fine.grid.extent_mm[1] / 2 - GAP_MM
    wide = fine.grid.extent_mm[2] * TABLE_WIDTH
    volume = _wider(fine, 1, GAP_MM + thick_mm + fine.grid.spacing[1])
    _, y, x = volume.grid.axes_mm()
    step = volume.grid.spacing[1]
    share = np.clip((thick_mm + step) / 2 - np.abs(y - (bottom - thick_mm / 2)), 0, min(step, thick_mm)) / step
    under = np.abs(x) < wide / 2
    volume.array[...] += ((hu - AIR_HU) * share[:, None] * under).astype(volume.array.dtype)
    return volume


def _arm(fine: Volume, one: Object, radius_mm: float, side: float, height_mm: float) -> Volume:
    """A cylinder along z just outside of what every view sees."""
    middle = side * (max(one.extent_mm) * MARGIN / 2 + GAP_MM + radius_mm)
    volume = _wider(fine, 2, max(0.0, abs(middle) + radius_mm - fine.grid.extent_mm[2] / 2) + fine.grid.spacing[2])
    _, y, x = volume.grid.axes_mm()
    away = np.hypot(y[:, None] - height_mm, x - middle)
    share = np.clip((radius_mm - away) / volume.grid.spacing[2] + 0.5, 0, 1)
    volume.array[...] += ((ARM_HU - AIR_HU) * share).astype(volume.array.dtype)
    return volume


def _insert(fine: Volume, hu: float, at: tuple[float, float], radius_mm: float) -> Volume:
    """Other HU in a cylinder along z, where there is matter."""
    _, y, x = fine.grid.axes_mm()
    across, along = (share * extent for share, extent in zip(at, fine.grid.extent_mm[1:], strict=True))
    share = np.clip((radius_mm - np.hypot(y[:, None] - across, x - along)) / fine.grid.spacing[2] + 0.5, 0, 1)
    more = np.where(fine.array > AIR_HU / 2, hu * share, 0.0)
    return Volume(np.maximum(fine.array + more, AIR_HU).astype(fine.array.dtype), fine.grid)
