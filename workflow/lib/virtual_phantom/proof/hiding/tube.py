"""Heel effect and angular modulation of the tube current, from equations of this package."""

from __future__ import annotations

import numpy as np


def heel(cone_rad: np.ndarray, depth_mm: float, anode_deg: float, mu_per_mm: np.ndarray) -> np.ndarray:
    """Return the relative fluence for photons from exponentially distributed depths in the target.

    The mean of exp(-mu x / sin a) over depths x with the density exp(-x / d) / d is 1 / (1 + mu d / sin a), with the
    angle a between ray and target.

    Parameters
    ----------
    cone_rad : ndarray, shape (rays,)
        Angles to the central plane, rad.
    depth_mm : float
        d; the sign is the side of the anode.
    mu_per_mm : ndarray, shape (energies,)
        Attenuation of the target, 1/mm.

    Returns
    -------
    ndarray, shape (rays, energies)
        1 in the central plane.
    """
    anode = np.deg2rad(anode_deg)
    leaving = anode + np.sign(depth_mm) * cone_rad
    slant = abs(depth_mm) * mu_per_mm
    return (1 + slant / np.sin(anode)) / (1 + slant / np.sin(leaving)[:, None])


def modulated(angle_rad: np.ndarray, cosine: float, sine: float) -> np.ndarray:
    """Return the relative current at gantry angles b, exp(c cos 2b + s sin 2b) with a mean of 1 over a turn.

    The current follows the transmission of the object, which is the exponential of a line integral.
    """
    wave = cosine * np.cos(2 * angle_rad) + sine * np.sin(2 * angle_rad)
    return np.exp(wave) / np.i0(np.hypot(cosine, sine))
