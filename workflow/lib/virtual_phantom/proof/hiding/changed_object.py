"""Objects that differ from the stated one: a table, an arm outside of the beam, a wrong insert."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .objects import ROOM, Part, ScannedObject

ARM_HU = 40.0
GAP_MM = 3.0  # between the object and the added one
TABLE_WIDTH = 0.8  # share of the object's width


def changed(scanned: ScannedObject, settings: Mapping) -> ScannedObject:
    """Return the object with the changes that the hidden settings (Scan.settings) state."""
    outer = scanned.parts[0]
    if thick := settings.get("table_mm", 0.0):
        low = outer.shape.bounds_mm()[0][1] - GAP_MM - thick / 2
        axes = outer.radius_mm * TABLE_WIDTH, thick / 2, np.inf
        return _beside(scanned, Part("table", (outer.centre_mm[0], low, 0.0), axes, hu=settings["table_hu"]))
    if radius := settings.get("arm_radius_mm", 0.0):
        away = settings["arm_side"] * (outer.radius_mm * ROOM + GAP_MM + radius)
        center = away, settings["arm_height_mm"], 0.0
        return _beside(scanned, Part("arm", center, (radius, radius, np.inf), hu=ARM_HU))
    if hu := settings.get("insert_hu", 0.0):
        return _denser(scanned, hu, settings["insert"])
    return scanned


def _beside(scanned: ScannedObject, part: Part) -> ScannedObject:
    return replace(scanned, outside=(*scanned.outside, part))


def _denser(scanned: ScannedObject, hu: float, which: float) -> ScannedObject:
    """Change the CT number of one part that is not air, or of the object if it has no other part."""
    inner = [number for number, part in enumerate(scanned.parts) if number and part.material != "air"] or [0]
    chosen = inner[int(which * len(inner))]
    part = scanned.parts[chosen]
    # Tissues and plastics have about the attenuation of water, to which the CT number refers.
    denser = replace(part, density=max(part.density * (1 + hu / 1000), 0.1))
    return replace(scanned, parts=(*scanned.parts[:chosen], denser, *scanned.parts[chosen + 1 :]))
