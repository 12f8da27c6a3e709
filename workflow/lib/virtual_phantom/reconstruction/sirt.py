"""Iterative reconstruction: SIRT, plain and Chebyshev-accelerated, for any projection engine."""

from __future__ import annotations

import numpy as np
from scipy import special

from ..base.errors import InputError

# Voxels and rays with less than this fraction of the largest weight are outside the scan and stay zero.
UNSEEN = 1e-6

# Chebyshev terms stop when at most this share of the voxels is estimated to be beyond the tolerance.
BEYOND_TOLERANCE = 0.05
# The estimate uses every fourth plane of voxels, and starts where the coefficients that are left sum to this.
SAMPLE = 4
LARGEST_TAIL = 0.02


def sirt(
    projector,
    line_integrals: np.ndarray,
    *,
    iterations: int,
    solver: str,
    terms: int,
    backprojector: str,
    tolerance_hu: float = 0.0,
    mu_water_per_mm: float = 0.02,
) -> np.ndarray:
    """Return the linear attenuation, 1/mm, by simultaneous iterative reconstruction.

    The iteration is x <- x + C A' R (b - A x) from x = 0, without clipping. R and C are the reciprocal row and column
    sums of A [1]_. With the exact transpose A', the eigenvalues of M = C A' R A are in [0, 1].

    Parameters
    ----------
    line_integrals : ndarray, shape (lanes, views, rows, columns)
    solver : {"plain", "chebyshev"}
        "plain": one iteration after the other. "chebyshev": the same image from fewer applications of the operator. K
        iterations multiply the error by (1 - M)^K. In Chebyshev polynomials T_j(1 - 2 M), the coefficients of this
        power decay like exp(-j^2 / K). Not valid with clipping.
    terms : int
        Largest number of Chebyshev terms.
    backprojector : {"adjoint", "voxel"}
        "adjoint": the exact transpose. "voxel": voxel-driven interpolation, as in ASTRA's SIRT3D_CUDA, without rays
        that cross less of the grid than the longest side of a voxel.
    tolerance_hu : float, optional
        Each realization stops adding terms when 95 % of its voxels are estimated to be within this of the image of all
        terms. 0: always `terms`. Structure that leaves the grid needs more terms.
    mu_water_per_mm : float, optional
        Linear attenuation of water, 1/mm, that converts `tolerance_hu`.

    Returns
    -------
    ndarray, shape (lanes, z, y, x)

    Raises
    ------
    InputError
        For an unknown option, counts below 1, or an engine without an adjoint.

    References
    ----------
    .. [1] Gregor and Benson, IEEE Trans. Med. Imaging 27, 918, 2008.
    """
    if iterations < 1 or terms < 1:
        raise InputError(f"sirt: iterations {iterations} and terms {terms} must both be at least 1")
    back = _back(projector, backprojector)
    update = SirtUpdate(projector, line_integrals, back, _shortest_mm(projector.grid, backprojector))
    if solver == "plain":
        volume = projector.empty_volume()
        for _ in range(iterations):
            volume += update(volume)
    elif solver == "chebyshev":
        volume = _chebyshev(update, iterations, min(terms, iterations), tolerance_hu * mu_water_per_mm / 1000)
    else:
        raise InputError(f"sirt: solver '{solver}' is unknown; use 'chebyshev' or 'plain'")
    return projector.unpack_volume(volume)


def _back(projector, backprojector):
    """Return the back-projection A' as a function of (projections, views, out). It may overwrite the projections."""
    if backprojector == "voxel":
        return projector.back
    if backprojector != "adjoint":
        raise InputError(f"sirt: backprojector '{backprojector}' is unknown; use 'adjoint' or 'voxel'")
    if not hasattr(projector, "adjoint"):
        raise InputError(
            "sirt: this engine has no adjoint; set reconstruction.sirt.backprojector: voxel, or engine: cpu"
        )
    return lambda projections, views, out: projector.adjoint(projections, views, out, overwrite=True)


def _shortest_mm(grid, backprojector):
    """Return the shortest path in the grid, mm, of a ray that is used.

    The exact transpose weights a ray's residual in a voxel by its path there. The voxel-driven back-projector does not,
    so the noise of a ray that grazes a corner of the grid would dominate.
    """
    return max(grid.spacing) if backprojector == "voxel" else 0.0


class SirtUpdate:
    """C A' R (b - A x), computed in blocks of views to avoid a second set of projections."""

    def __init__(self, projector, line_integrals, back, shortest_mm):
        self.projector, self.back = projector, back
        views = projector.geometry.views
        self.blocks = [
            slice(i, min(i + projector.views_per_block, views)) for i in range(0, views, projector.views_per_block)
        ]
        self.measured = [projector.pack_projections(line_integrals[:, block]) for block in self.blocks]
        ones = projector.pack_volume(np.ones((projector.lanes, *projector.grid.shape), dtype=np.float32))
        lengths = [projector.one_lane(projector.forward(ones, block)) for block in self.blocks]
        longest = max(float(length.max()) for length in lengths)
        smallest = max(UNSEEN * longest, shortest_mm)
        self.row_weights = [_reciprocal(length, smallest) for length in lengths]
        column_sum = projector.empty_volume()
        for block in self.blocks:
            shape = (projector.lanes, block.stop - block.start, projector.geometry.rows, projector.geometry.columns)
            back(projector.pack_projections(np.ones(shape, dtype=np.float32)), block, column_sum)
        self.column_weights = _reciprocal(projector.one_lane(column_sum), UNSEEN * float(column_sum.max()))

    def __call__(self, volume):
        """Return the update of a packed volume."""
        total = self.projector.empty_volume()
        for block, measured, weights in zip(self.blocks, self.measured, self.row_weights, strict=True):
            residual = self.projector.forward(volume, block)
            np.subtract(measured, residual, out=residual)
            residual *= weights
            self.back(residual, block, total)
        total *= self.column_weights
        return total


def _reciprocal(values, smallest):
    seen = values > smallest
    return seen / np.where(seen, values, np.float32(1))


def chebyshev_coefficients(iterations: int, terms: int) -> np.ndarray:
    """Return Chebyshev coefficients of K iterations for j = 0 to `terms`: C(2K, K) / 4^K, then 2 C(2K, K - j) / 4^K."""
    j = np.arange(terms + 1)
    k = iterations
    log = special.gammaln(2 * k + 1) - special.gammaln(k - j + 1) - special.gammaln(k + j + 1) - 2 * k * np.log(2)
    return np.exp(log) * np.where(j == 0, 1, 2)


def _chebyshev(update, iterations, terms, tolerance):
    coefficients = chebyshev_coefficients(iterations, iterations)
    tails = np.maximum(1 - np.cumsum(coefficients), 1e-9)
    before = update.projector.empty_volume()
    current = update(before)
    current *= np.float32(2)
    total = current * np.float32(coefficients[1])
    unfinished = np.ones(update.projector.lanes, bool)
    sums = np.full(len(unfinished), coefficients[:2].sum())
    for j in range(2, terms + 1):
        following = update(current)
        following *= np.float32(4)
        following += current
        following += current
        following -= before
        weights = coefficients[j] * unfinished
        total += np.multiply(following, _by_lane(update, weights), out=before)  # reuses the array, saves a fifth volume
        sums += weights
        if tolerance and tails[j] < LARGEST_TAIL:
            unfinished &= _beyond(update, following, total, sums, tolerance / tails[j]) > BEYOND_TOLERANCE
            if not unfinished.any():
                break
        before, current = current, following
    total *= _by_lane(update, 1 / sums)
    return total


def _by_lane(update, values):
    """Return float32 values of the realizations that broadcast against packed volumes; a number if all are equal."""
    return np.float32(values[0]) if (values == values[0]).all() else update.projector.per_lane(values)


def _beyond(update, current, total, sums, limit):
    """Return the share of voxels of each realization whose estimated error is beyond the tolerance.

    `current` is x - T_j(1 - 2 M) x, where x is the limit of the iteration, and the image is about x - (1 - M)^K x. The
    error is the sum of T_i(1 - 2 M) x times its coefficient over the missing terms i > j. The estimate replaces
    T_i(1 - 2 M) x by the difference of `current` and the image. `limit` is the tolerance divided by the sum of the
    coefficients.
    """
    some = np.s_[:, ::SAMPLE]
    beyond = abs(total[some] * _by_lane(update, 1 / sums) - current[some]) > np.float32(limit)
    counts = beyond.sum(axis=update.projector.voxel_axes)
    seen = float((update.column_weights[some] > 0).sum())
    return np.array([float(counts[lane]) for lane in range(len(sums))]) / max(seen, 1.0)
