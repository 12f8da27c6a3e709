"""Reconstruction: SIRT (plain and Chebyshev-accelerated) and FDK, on any engine of `projectors`.

Both take line integrals [lane, view, row, column] and give linear attenuation in 1/mm, [lane, z, y, x].
"""

from __future__ import annotations

import numpy as np
from scipy import fft, special

from .errors import InputError

# Voxels and rays whose weight is under this share of the largest are outside the scan: they stay at zero.
UNSEEN = 1e-6


def sirt(
    projector,
    line_integrals: np.ndarray,
    *,
    iterations: int = 500,
    solver: str = "chebyshev",
    terms: int = 60,
    backprojector: str = "adjoint",
) -> np.ndarray:
    """Simultaneous iterative reconstruction, x <- x + C A' R (b - A x) from x = 0, unclipped.

    R and C hold the reciprocals of the row and column sums of A (Gregor and Benson, IEEE Trans. Med. Imaging 27,
    918, 2008). With the exact transpose for A', M = C A' R A has its eigenvalues in [0, 1].

    solver   "plain" makes the iterations one by one. "chebyshev" gives the same image in `terms` applications of the
             operator: K iterations multiply the error by (1 - M)^K. Expanded in the Chebyshev polynomials
             T_j(1 - 2 M), its coefficients are binomials that die off like exp(-j^2 / K); `terms` says where to stop. 60 for K = 500 leaves 0.1 to 0.2 % of the noise. Not valid with clipping.
    backprojector   what stands for A'. "adjoint": the exact transpose. "voxel": voxel-driven interpolation, as ASTRA's
             SIRT3D_CUDA has it; it amplifies noise where few views see a voxel (off the axis, towards the ends of a helix).

    Raises InputError for an unknown word, counts under 1, or an engine without an adjoint.
    """
    if iterations < 1 or terms < 1:
        raise InputError(f"sirt: iterations {iterations} and terms {terms} must both be at least 1")
    update = _SirtUpdate(projector, line_integrals, _back(projector, backprojector))
    if solver == "plain":
        volume = projector.empty_volume()
        for _ in range(iterations):
            volume += update(volume)
    elif solver == "chebyshev":
        volume = _chebyshev(update, iterations, min(terms, iterations))
    else:
        raise InputError(f"sirt: solver '{solver}' is unknown; use 'chebyshev' or 'plain'")
    return projector.unpack_volume(volume)


def _back(projector, backprojector):
    """The function (projections, views, out) that stands for A'. It may overwrite the projections."""
    if backprojector == "voxel":
        return projector.back
    if backprojector != "adjoint":
        raise InputError(f"sirt: backprojector '{backprojector}' is unknown; use 'adjoint' or 'voxel'")
    if not hasattr(projector, "adjoint"):
        raise InputError(
            "sirt: this engine has no adjoint; set reconstruction.sirt.backprojector: voxel, or engine: cpu"
        )
    return lambda projections, views, out: projector.adjoint(projections, views, out, overwrite=True)


class _SirtUpdate:
    """C A' R (b - A x), a block of views at a time, so that no second set of projections is ever held."""

    def __init__(self, projector, line_integrals, back):
        self.projector, self.back = projector, back
        views = projector.geometry.views
        self.blocks = [
            slice(i, min(i + projector.views_per_block, views)) for i in range(0, views, projector.views_per_block)
        ]
        self.measured = [projector.pack_projections(line_integrals[:, block]) for block in self.blocks]
        ones = projector.pack_volume(np.ones((projector.lanes, *projector.grid.shape), dtype=np.float32))
        lengths = [projector.forward(ones, block)[..., :1] for block in self.blocks]
        longest = max(float(length.max()) for length in lengths)
        self.row_weights = [_reciprocal(length, UNSEEN * longest) for length in lengths]
        column_sum = projector.empty_volume()
        for block in self.blocks:
            back(projector.pack_projections(_ones(projector, block.stop - block.start)), block, column_sum)
        self.column_weights = _reciprocal(column_sum[..., :1], UNSEEN * float(column_sum.max()))

    def __call__(self, volume):
        total = self.projector.empty_volume()
        for block, measured, weights in zip(self.blocks, self.measured, self.row_weights, strict=True):
            residual = self.projector.forward(volume, block)
            np.subtract(measured, residual, out=residual)
            residual *= weights
            self.back(residual, block, total)
        total *= self.column_weights
        return total


def _ones(projector, views):
    return np.ones((projector.lanes, views, projector.geometry.rows, projector.geometry.columns), dtype=np.float32)


def _reciprocal(values, smallest):
    return np.divide(1, values, out=np.zeros_like(values), where=values > smallest)


def chebyshev_coefficients(iterations: int, terms: int) -> np.ndarray:
    """c_0 = C(2K, K) / 4^K, c_j = 2 C(2K, K - j) / 4^K: the share of each Chebyshev polynomial in K iterations, (terms + 1,)."""
    j = np.arange(terms + 1)
    k = iterations
    log = special.gammaln(2 * k + 1) - special.gammaln(k - j + 1) - special.gammaln(k + j + 1) - 2 * k * np.log(2)
    return np.exp(log) * np.where(j == 0, 1, 2)


def _chebyshev(update, iterations, terms):
    coefficients = chebyshev_coefficients(iterations, terms)
    before = update.projector.empty_volume()
    current = update(before)
    current *= np.float32(2)
    total = coefficients[1].astype(np.float32) * current
    for weight in coefficients[2:].astype(np.float32):
        following = update(current)
        following *= np.float32(4)
        following += current
        following += current
        following -= before
        before, current = current, following
        total += weight * current
    total *= np.float32(1 / coefficients.sum())
    return total


def fdk(projector, line_integrals: np.ndarray, *, normalise: str = "coverage") -> np.ndarray:
    """Filtered back-projection of a cone beam (Feldkamp, Davis and Kress, J. Opt. Soc. Am. A 1, 612, 1984), ramp filter.

    normalise   "none" takes the views for one whole turn, whatever they are: right for one circular turn; on a helix
                every voxel comes out scaled by the share of views that see it, as with ASTRA's FDK_CUDA.
                "coverage" divides each voxel by that share (back-projected, so that its edges are smooth).

    Raises InputError for another word.
    """
    if normalise not in ("coverage", "none"):
        raise InputError(f"fdk: normalise '{normalise}' is unknown; use 'coverage' or 'none'")
    geometry = projector.geometry
    filtered = _filter(geometry, line_integrals)
    volume = projector.back(projector.pack_projections(filtered), distance_weight=True)
    del filtered
    # Half of the integral over one turn of views (each ray is met twice).
    volume *= np.float32(np.pi / geometry.views)
    if normalise == "coverage":
        covered = projector.back(projector.pack_projections(_ones(projector, geometry.views)), distance_weight=True)
        volume *= _reciprocal(covered / np.float32(geometry.views), UNSEEN)
        _, y, x = projector.grid.axes_mm()
        radius = (x[None, :] ** 2 + y[:, None] ** 2) / geometry.source_to_isocentre_mm**2
        one_turn = np.maximum(1 - radius, UNSEEN) ** -1.5
        volume[1:-1, 1:-1] *= one_turn[:, :, None, None].astype(np.float32)
    return projector.unpack_volume(volume)


def _filter(geometry, line_integrals):
    """Cosine weighting and the ramp filter along detector columns, sampled for a flat detector scaled to the isocentre."""
    to_isocentre = 1 / geometry.magnification
    u = geometry.column_positions_mm()
    v = geometry.row_positions_mm()
    distance = geometry.source_to_detector_mm
    cosine = (distance / np.sqrt(distance**2 + u[None, :] ** 2 + v[:, None] ** 2)).astype(np.float32)
    pitch = geometry.column_pitch_mm * to_isocentre
    n = fft.next_fast_len(2 * geometry.columns, real=True)
    # The ramp as its band-limited impulse response (Kak and Slaney 1988, eq. 3.61), so that the mean is right.
    offset = np.minimum(np.arange(n), n - np.arange(n))
    response = np.where(offset % 2 == 1, -1 / (np.pi * np.maximum(offset, 1) * pitch) ** 2, 0.0)
    response[0] = 1 / (4 * pitch**2)
    ramp = (fft.rfft(response).real * pitch).astype(np.float32)
    filtered = np.empty(line_integrals.shape, dtype=np.float32)
    for lane, stack in enumerate(line_integrals):
        for view, image in enumerate(stack):
            spectrum = fft.rfft(image * cosine, n, axis=-1)
            filtered[lane, view] = fft.irfft(spectrum * ramp, n, axis=-1)[:, : geometry.columns]
    return filtered
