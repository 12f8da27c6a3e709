"""Whether the white field falls off as it is said to: evenly lit, or as pixels see the source."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.geometry import OrbitGeometry
from ...physics.chain import EVEN

SOLID_ANGLE = "solid_angle"
# How far the exponent of the solid angle may be off 0 or 1: a bowtie or a heel, which shape the field too, give others.
NEAR = 0.15
LEAST_SPAN = 0.01  # of the logarithm of the solid angle over the detector: less shows nothing
EXPLAINED = 0.5  # of the field's variance, by the solid angle and a slope along either axis


def wrong_illumination(white: np.ndarray | None, geometry: OrbitGeometry, scan: Mapping) -> tuple[str, float] | None:
    """Another illumination than stated, that the white field has.

    Parameters
    ----------
    white : ndarray, shape (rows, columns), or None
        Counts without an object.
    scan : mapping
        The scan section of recording.yaml.

    Returns
    -------
    illumination : {"even", "solid_angle"}
        What to state.
    exponent : float
        Of the solid angle, by which the field falls off.
        None instead of both where the statement may hold, or nothing can be seen.
    """
    if white is None:
        return None
    good = white > 0
    angle = np.log(np.broadcast_to(geometry.solid_angles()[0], white.shape))
    if np.ptp(angle) < LEAST_SPAN or good.mean() < 0.5:
        return None
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in white.shape), indexing="ij")
    terms = np.stack([np.ones_like(angle), rows, columns, angle])[:, good]
    field = np.log(white[good])
    found = np.linalg.lstsq(terms.T, field, rcond=1e-9)[0]
    explained = 1 - np.var(field - found @ terms) / max(np.var(field), 1e-300)
    stated = scan.get("illumination", EVEN)
    exponent = float(found[-1])
    if stated == EVEN and abs(exponent - 1) < NEAR and explained > EXPLAINED:
        return SOLID_ANGLE, exponent
    flat = np.std(field) < NEAR * np.std(angle) or explained > EXPLAINED
    if stated == SOLID_ANGLE and abs(exponent) < NEAR and flat:
        return EVEN, exponent
    return None
