"""Normalised cross-correlation of two masked volumes over every shift at once.

References
----------
D. Padfield, "Masked object registration in the Fourier domain", IEEE Trans. Image Process. 21, 2706, 2012.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

LEAST_COVERED = 0.4  # of the body: with less in common, chance fits win over the right one


def masked_cross_correlation(template, region, image, seen):
    """Normalised cross-correlation of a template with an image, for every shift that leaves enough in common.

    Parameters
    ----------
    template, region : ndarray, shape (z, y, x)
        HU, and where it counts (not 0).
    image, seen : ndarray, shape (z, y, x)
        HU, and where it is seen (not 0).

    Returns
    -------
    scores : ndarray, shape (z shifts, y shifts, x shifts)
        Coefficients; -1 where less than LEAST_COVERED of the region lies on what is seen.
    shifts : list of 3 ndarray
        For each axis, the shifts in voxels.
    """
    shape = [a + b - 1 for a, b in zip(template.shape, image.shape, strict=True)]
    size = [fft.next_fast_len(n, real=True) for n in shape]

    def spectrum(array):
        return fft.rfftn(array.astype(np.float64), size)

    def together(a, b):
        return fft.irfftn(np.conj(a) * b, size)

    within, visible = region.astype(np.float64), seen.astype(np.float64)
    f = np.where(region, template - template[region != 0].mean(), 0) / 1000
    g = np.where(seen, image - image[seen != 0].mean(), 0) / 1000
    f1, f2, fm = spectrum(f), spectrum(f * f), spectrum(within)
    g1, g2, gm = spectrum(g), spectrum(g * g), spectrum(visible)
    n = together(fm, gm)
    enough = n >= LEAST_COVERED * within.sum()
    n = np.where(enough, n, 1)
    sf, sg = together(f1, gm), together(fm, g1)
    upper = together(f1, g1) - sf * sg / n
    lower = (together(f2, gm) - sf * sf / n) * (together(fm, g2) - sg * sg / n)
    usable = enough & (lower > 1e-9 * within.sum() ** 2)
    scores = np.where(usable, upper / np.sqrt(np.where(usable, lower, 1)), -1.0)
    # index i of an axis is a shift of i, or of i - size beyond the image's length
    shifts = [
        np.where(np.arange(s) < n, np.arange(s), np.arange(s) - s) for s, n in zip(size, image.shape, strict=True)
    ]
    return scores, shifts
