"""Objects that differ from the known phantom: a table, an arm outside of the beam, a wrong insert."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.geometry import Grid
from ...io.volumes import Volume
from .objects import MARGIN, Object

AIR_HU, ARM_HU = -1000.0, 40.0
GAP_MM = 3.0  # between the phantom's grid and the added object
TABLE_WIDTH = 0.8  # share of the phantom's width


def changed(fine: Volume, scanned_object: Object, settings: Mapping) -> Volume:
    """Return the phantom (HU) with the changes of the object that the hidden settings (Scan.settings) state.

    The grid can be larger, with the same center. Without a change, the result is `fine` itself.
    """
    if thick := settings.get("table_mm", 0.0):
        return _table(fine, thick, settings["table_hu"])
    if radius := settings.get("arm_radius_mm", 0.0):
        return _arm(fine, scanned_object, radius, settings["arm_side"], settings["arm_height_mm"])
    if hu := settings.get("insert_hu", 0.0):
        return _insert(fine, hu, settings["insert_at"], settings["insert_radius_mm"])
    return fine


def _wider(fine: Volume, axis: int, by_mm: float) -> Volume:
    """Add air on both sides along an axis."""
    spacing = fine.grid.spacing
    count = int(np.ceil(by_mm / spacing[axis]))
    padding = [(count, count) if dimension == axis else (0, 0) for dimension in range(3)]
    array = np.pad(fine.array, padding, constant_values=AIR_HU)
    return Volume(array, Grid(array.shape, spacing))


def _table(fine: Volume, thick_mm: float, hu: float) -> Volume:
    """Add a plate below the phantom, with the length of the phantom."""
    bottom = -fine.grid.extent_mm[1] / 2 - GAP_MM
    width = fine.grid.extent_mm[2] * TABLE_WIDTH
    volume = _wider(fine, 1, GAP_MM + thick_mm + fine.grid.spacing[1])
    _, y, x = volume.grid.axes_mm()
    step = volume.grid.spacing[1]
    share = np.clip((thick_mm + step) / 2 - np.abs(y - (bottom - thick_mm / 2)), 0, min(step, thick_mm)) / step
    under = np.abs(x) < width / 2
    volume.array[...] += ((hu - AIR_HU) * share[:, None] * under).astype(volume.array.dtype)
    return volume


def _arm(fine: Volume, scanned_object: Object, radius_mm: float, side: float, height_mm: float) -> Volume:
    """Add a cylinder along z just outside of the field of view of every projection."""
    middle = side * (max(scanned_object.extent_mm) * MARGIN / 2 + GAP_MM + radius_mm)
    volume = _wider(fine, 2, max(0.0, abs(middle) + radius_mm - fine.grid.extent_mm[2] / 2) + fine.grid.spacing[2])
    _, y, x = volume.grid.axes_mm()
    distance = np.hypot(y[:, None] - height_mm, x - middle)
    share = np.clip((radius_mm - distance) / volume.grid.spacing[2] + 0.5, 0, 1)
    volume.array[...] += ((ARM_HU - AIR_HU) * share).astype(volume.array.dtype)
    return volume


def _insert(fine: Volume, hu: float, at: tuple[float, float], radius_mm: float) -> Volume:
    """Change the HU in a cylinder along z, where there is matter."""
    _, y, x = fine.grid.axes_mm()
    across, along = (share * extent for share, extent in zip(at, fine.grid.extent_mm[1:], strict=True))
    share = np.clip((radius_mm - np.hypot(y[:, None] - across, x - along)) / fine.grid.spacing[2] + 0.5, 0, 1)
    added = np.where(fine.array > AIR_HU / 2, hu * share, 0.0)
    return Volume(np.maximum(fine.array + added, AIR_HU).astype(fine.array.dtype), fine.grid)
