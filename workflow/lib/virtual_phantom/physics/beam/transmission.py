"""What a beam of many energies leaves of its signal behind given path lengths.

Nearly all the time of fits with a spectrum goes into exponentials: one for every ray and energy. They are worked out in
single precision, as path lengths are, for blocks of rays that stay in a core's nearest cache. Loops are plain, and
compilers turn them into instructions that take many rays at once.
"""

from __future__ import annotations

import math

import numpy as np
from numba import float32, int32, types
from numba.extending import intrinsic

from ...base.compiled import compiled
from ...projectors.lanes import OPTIONS
from ...projectors.threads import share_out

BLOCK = 512  # rays: a few kilobytes for each array
MANY = 40  # blocks from which on threads, which take 0.2 ms to start, gain more than that
# 2^x, x from -1/2 to 1/2: Chebyshev's interpolation of this degree is within 2e-8, a quarter of what float32 resolves.
DEGREE = 6
LEAST_POWER, MOST_POWER = -126, 127  # of 2 that float32 holds in full: less is left as that, which is nothing


def _coefficients() -> np.ndarray:
    """Of the polynomial of 2^x, that of x^0 first, shape (DEGREE + 1,)."""
    halves = np.polynomial.chebyshev.chebinterpolate(lambda x: 2 ** (x / 2), DEGREE)
    return np.polynomial.chebyshev.cheb2poly(halves) * 2.0 ** np.arange(DEGREE + 1)


_C0, _C1, _C2, _C3, _C4, _C5, _C6 = (np.float32(one) for one in _coefficients())


def transmitted(paths: np.ndarray, attenuation_per_mm: np.ndarray, shares: np.ndarray, threads: int = 1) -> np.ndarray:
    """Shares of the signal and of its variance that many energies leave.

    Parameters
    ----------
    paths : ndarray, shape (materials, views, rows, columns)
        Path lengths, mm.
    attenuation_per_mm : ndarray, shape (materials, energies)
        1/mm.
    shares : ndarray, shape (shares, energies) or (shares, energies, rows, columns)
        In air, of all pixels or of every one.
    threads : int, optional
        That share out the rays, where there are many.

    Returns
    -------
    ndarray of float64, shape (shares, views, rows, columns)
        Right to 2e-7 of their value for each unit of the largest line integral, and one; but not under 1e-37.
    """
    materials, *shape = paths.shape
    views = shape[0] if shares.ndim > 2 else 1  # that differ in what one share is of
    flat = np.ascontiguousarray(paths, np.float32).reshape(materials, views, -1)
    powers = np.ascontiguousarray(attenuation_per_mm / -math.log(2), np.float32)
    every = np.broadcast_to(shares, (*shares.shape[:2], *shape[1:])) if shares.ndim > 2 else shares[..., None]
    every = np.ascontiguousarray(every, np.float32).reshape(*shares.shape[:2], -1)
    found = np.empty((len(shares), *flat.shape[1:]))

    def run(first: int, last: int) -> None:
        room = np.empty((1 + len(shares), BLOCK), np.float32)
        _transmit(flat, powers, every, found, room, first, last)

    blocks = -(-flat.shape[-1] // BLOCK)
    share_out(run, blocks, threads if views * blocks >= MANY else 1)
    return found.reshape(len(shares), *shape)


@intrinsic
def _float_of(typingctx, bits):
    """The float32 that has these bits."""

    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.float32))

    return types.float32(types.int32), generate


@compiled(**OPTIONS)
def _powers_of_two(values):
    """2^x in the place of every x. Rays that follow others may have path lengths a little below 0."""
    for i in range(values.size):
        x = min(max(values[i], float32(LEAST_POWER)), float32(MOST_POWER))
        whole = int32(x + float32(0.5 - LEAST_POWER)) + int32(LEAST_POWER)  # the nearest: conversion goes towards zero
        y = x - float32(whole)
        part = ((((_C6 * y + _C5) * y + _C4) * y + _C3) * y + _C2) * y + _C1
        values[i] = (part * y + _C0) * _float_of(int32((whole + int32(127)) << int32(23)))


# Loops of their own: compiled within `_transmit`, no instruction of theirs would take several rays.
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
def _transmit(paths, powers, shares, found, room, begin, end):
    """Write the shares that are left, of some blocks of rays.

    Parameters
    ----------
    paths : ndarray of float32, shape (materials, views, rays)
    powers : ndarray of float32, shape (materials, energies)
        Of 2, per mm.
    shares : ndarray of float32, shape (shares, energies, 1 or rays)
    found : ndarray of float64, shape (shares, views, rays)
    room : ndarray of float32, shape (1 + shares, BLOCK)
    begin, end : int
        The first block, and the one behind the last.
    """
    materials, views, rays = paths.shape
    count, energies, each = shares.shape
    for view in range(views):
        for block in range(begin, end):
            first, last = block * BLOCK, min((block + 1) * BLOCK, rays)
            left = room[0, : last - first]
            room[1:] = 0
            for energy in range(energies):
                _set(left, paths[0, view, first:last], powers[0, energy])
                for material in range(1, materials):
                    _add(left, paths[material, view, first:last], powers[material, energy])
                _powers_of_two(left)
                for share in range(count):
                    total = room[1 + share, : last - first]
                    if each == 1:
                        _add(total, left, shares[share, energy, 0])
                    else:
                        _add_of_each(total, left, shares[share, energy, first:last])
            for share in range(count):
                for i in range(last - first):
                    found[share, view, first + i] = room[1 + share, i]
