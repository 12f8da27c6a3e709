"""Positions of source and detector in each view, from equations of this package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...base.streams import branch, generator

# Time constant of the exponential laws below, in durations of the scan.
SETTLING = 1.0


@dataclass(frozen=True)
class Displacement:
    """Displacements of one view.

    Attributes
    ----------
    object_mm : ndarray, shape (3,)
        Displacement of the object, mm.
    source_mm : ndarray, shape (3,)
        Displacement of the source alone, mm.
    turn_deg : float
        Error of the gantry angle, degrees.
    """

    object_mm: np.ndarray
    source_mm: np.ndarray
    turn_deg: float


def displacement(
    settings: Mapping, view: int, views: int, turns: float, duration_s: float, along: np.ndarray, up: np.ndarray
) -> Displacement:
    """Return the displacements of a view.

    Parameters
    ----------
    settings : mapping
        Hidden settings, as Scan.settings.
    turns : float
        Turns of the gantry since the start of the scan.
    along, up : ndarray, shape (3,)
        Directions of growing columns and rows.
    """
    settled = settling((view + 0.5) / views) * duration_s
    moved = settings.get("axis_shift_mm", 0.0) * along + settled * np.asarray(
        settings.get("velocity_mm_per_s", (0,) * 3)
    )
    axes = [along, up, np.cross(up, along)]
    source = settled * np.asarray(settings.get("source_mm_per_s", (0,) * 3)) @ axes
    angle = 0.0
    if "angle_wave_deg" in settings:
        angle += triangle_wave(turns, settings["angle_wave_deg"])
    if "breathing_mm" in settings:
        moved = moved + breathed(turns, settings)
    if "swing_deg" in settings:
        angle -= swung(turns, settings)
    if "jitter_deg" in settings:
        angle += jittered(view, settings)
    return Displacement(moved, source, angle)


def settling(time: float) -> float:
    """Return the position of a part that settles exponentially, with a range of 1 and a mean of 0 over the scan.

    Creep of a soft object and thermal expansion follow this law.

    Parameters
    ----------
    time : float
        Since the start of the scan, in its duration.
    """
    whole = -np.expm1(-1 / SETTLING)
    mean = 1 - SETTLING * whole
    return float((-np.expm1(-time / SETTLING) - mean) / whole)


def triangle_wave(turns: float, amplitudes: tuple[float, float]) -> float:
    """Return a triangle wave with one period per turn, as of a worn belt.

    Parameters
    ----------
    amplitudes : tuple of 2 float
        Amplitudes of cosine and sine of the fundamental wave.
    """
    size, phase = np.hypot(*amplitudes), np.arctan2(amplitudes[1], amplitudes[0])
    return float(size * np.pi**2 / 8 * 2 / np.pi * np.arcsin(np.cos(2 * np.pi * turns - phase)))


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
