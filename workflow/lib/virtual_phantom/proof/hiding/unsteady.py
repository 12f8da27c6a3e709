"""Motion of an unsteady object or gantry in each view, from equations of this package."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.streams import branch, generator


def breathed(turns: float, settings: Mapping) -> np.ndarray:
    """Return the displacement of an object that breathes, (x, y, z) in mm, after some turns of the gantry.

    Settings: `breathing_mm`, the amplitude (x, y, z); `breathing_per_turn`; `breathing_phase`, radians.
    """
    phase = 2 * np.pi * settings["breathing_per_turn"] * turns + settings["breathing_phase"]
    return np.sin(phase) * np.asarray(settings["breathing_mm"])


def swung(turns: float, settings: Mapping) -> float:
    """Return the rotation of an object that swings about z, degrees. Settings: as in `breathed`, for `swing_deg`."""
    return settings["swing_deg"] * np.sin(2 * np.pi * settings["swing_per_turn"] * turns + settings["swing_phase"])


def jittered(view: int, settings: Mapping) -> float:
    """Return the angular error of a view, degrees. Settings: `jitter_deg`, the SD, and `jitter_seed`."""
    return settings["jitter_deg"] * float(generator(branch(settings["jitter_seed"], view)).normal())


def turned(vectors: np.ndarray, angle_deg: float) -> np.ndarray:
    """Rotate rows of vectors (x, y, z) about z, from +x to +y."""
    cosine, sine = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return vectors @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
