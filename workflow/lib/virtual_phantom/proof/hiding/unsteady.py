"""Where an unsteady object or gantry is in every view, by equations of the proof's own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.streams import branch, generator


def breathed(turns: float, settings: Mapping) -> np.ndarray:
    """How far an object that breathes is displaced.

    Parameters
    ----------
    turns : float
        Of the gantry, since the scan began.
    settings : mapping
        `breathing_mm`, the amplitude (x, y, z); `breathing_per_turn`; `breathing_phase`, radians.

    Returns
    -------
    ndarray, shape (3,)
        mm.
    """
    phase = 2 * np.pi * settings["breathing_per_turn"] * turns + settings["breathing_phase"]
    return np.sin(phase) * np.asarray(settings["breathing_mm"])


def swung(turns: float, settings: Mapping) -> float:
    """How far an object that swings about z is turned, degrees; settings as of `breathed`, of `swing_deg`."""
    return settings["swing_deg"] * np.sin(2 * np.pi * settings["swing_per_turn"] * turns + settings["swing_phase"])


def jittered(view: int, settings: Mapping) -> float:
    """How far a view is taken beside its angle.

    Parameters
    ----------
    settings : mapping
        `jitter_deg`, the standard deviation, and `jitter_seed`.

    Returns
    -------
    float
        Degrees.
    """
    return settings["jitter_deg"] * float(generator(branch(settings["jitter_seed"], view)).normal())


def turned(vectors: np.ndarray, angle_deg: float) -> np.ndarray:
    """Rows of vectors (x, y, z) turned about z, from +x to +y."""
    cosine, sine = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return vectors @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
