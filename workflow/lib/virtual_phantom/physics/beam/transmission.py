"""Compute the signal of a polychromatic beam from path lengths through materials.

Fits with a spectrum spend nearly all their time in exponentials, one per ray and energy. They are computed in single
precision, like path lengths, for blocks of rays that fit into the L1 cache. The loops are simple so that compilers
vectorize them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float32, int32, types
from numba.extending import intrinsic

from ...base.compiled import compiled
from ...projectors.lanes import OPTIONS
from ...projectors.threads import run_in_threads

BLOCK = 512  # rays; a few kilobytes per array
MANY = 40  # blocks from which threads gain more than the 0.2 ms that they take to start
# Degree of the Chebyshev interpolation of 2^x in [-1/2, 1/2]; its error of 2e-8 is a quarter of the float32 resolution.
DEGREE = 6
MIN_POWER, MAX_POWER = -126, 127  # exponents of normal float32 numbers; smaller exponents are set to the minimum


def _coefficients() -> np.ndarray:
    """Return the polynomial coefficients of 2^x in ascending order, shape (DEGREE + 1,)."""
    halves = np.polynomial.chebyshev.chebinterpolate(lambda x: 2 ** (x / 2), DEGREE)
    return np.polynomial.chebyshev.cheb2poly(halves) * 2.0 ** np.arange(DEGREE + 1)


_C0, _C1, _C2, _C3, _C4, _C5, _C6 = (np.float32(coefficient) for coefficient in _coefficients())


def polychromatic_signal(
    paths: np.ndarray, attenuation_per_mm: np.ndarray, shares: np.ndarray, threads: int = 1
) -> np.ndarray:
    """Return sum over energies of share times exp(-sum of attenuation times path length).

    Parameters
    ----------
    paths : ndarray, shape (materials, views, rows, columns)
        Path lengths, mm.
    attenuation_per_mm : ndarray, shape (materials, energies)
        1/mm.
    shares : ndarray, shape (shares, energies) or (shares, energies, rows, columns)
        Shares of the energies in air (of the signal and of its variance), for all pixels or for each pixel.

    Returns
    -------
    ndarray of float64, shape (shares, views, rows, columns)
        Relative error up to 2e-7 times (1 + largest line integral), for results above 1e-37.
    """
    materials, *shape = paths.shape
    views = shape[0] if shares.ndim > 2 else 1  # shares for each pixel repeat in every view
    flat = np.ascontiguousarray(paths, np.float32).reshape(materials, views, -1)
    powers = np.ascontiguousarray(attenuation_per_mm / -math.log(2), np.float32)
    every = np.broadcast_to(shares, (*shares.shape[:2], *shape[1:])) if shares.ndim > 2 else shares[..., None]
    every = np.ascontiguousarray(every, np.float32).reshape(*shares.shape[:2], -1)
    found = np.empty((len(shares), *flat.shape[1:]))

    def run(first: int, last: int) -> None:
        workspace = np.empty((1 + len(shares), BLOCK), np.float32)
        _transmit(flat, powers, every, found, workspace, first, last)

    blocks = -(-flat.shape[-1] // BLOCK)
    run_in_threads(run, blocks, threads if views * blocks >= MANY else 1)
    return found.reshape(len(shares), *shape)


@intrinsic
def _float_of(typingctx, bits):
    """Return the float32 with these bits."""

    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.float32))

    return types.float32(types.int32), generate


@compiled(**OPTIONS)
def _powers_of_two(values):
    """Replace x by 2^x = 2^whole * 2^y. Linearized path lengths may be slightly negative, and x positive."""
    for i in range(values.size):
        x = min(max(values[i], float32(MIN_POWER)), float32(MAX_POWER))
        whole = int32(x + float32(0.5 - MIN_POWER)) + int32(MIN_POWER)  # rounded: int32() truncates toward zero
        y = x - float32(whole)
        part = ((((_C6 * y + _C5) * y + _C4) * y + _C3) * y + _C2) * y + _C1
        values[i] = (part * y + _C0) * _float_of(int32((whole + int32(127)) << int32(23)))


# Separate functions, because the compiler does not vectorize these loops inside `_transmit`.
@compiled(**OPTIONS)
def _set(values, times, factor):
    for i in range(values.size):
        values[i] = factor * times[i]


@compiled(**OPTIONS)
def _add(values, times, factor):
    for i in range(values.size):
        values[i] += factor * times[i]


@compiled(**OPTIONS)
def _add_of_each(values, times, factors):
    for i in range(values.size):
        values[i] += factors[i] * times[i]


@compiled(**OPTIONS)
def _transmit(paths, powers, shares, found, workspace, begin, end):
    """Write the signal of the blocks from `begin` to before `end` into `found`.

    Shapes: paths (materials, views, rays), powers of 2 per mm (materials, energies), shares (shares, energies, 1 or
    rays), found (shares, views, rays), and workspace (1 + shares, BLOCK).
    """
    materials, views, rays = paths.shape
    count, energies, per_share = shares.shape
    for view in range(views):
        for block in range(begin, end):
            first, last = block * BLOCK, min((block + 1) * BLOCK, rays)
            transmission = workspace[0, : last - first]
            workspace[1:] = 0
            for energy in range(energies):
                _set(transmission, paths[0, view, first:last], powers[0, energy])
                for material in range(1, materials):
                    _add(transmission, paths[material, view, first:last], powers[material, energy])
                _powers_of_two(transmission)
                for share in range(count):
                    total = workspace[1 + share, : last - first]
                    if per_share == 1:
                        _add(total, transmission, shares[share, energy, 0])
                    else:
                        _add_of_each(total, transmission, shares[share, energy, first:last])
            for share in range(count):
                for i in range(last - first):
                    found[share, view, first + i] = workspace[1 + share, i]
