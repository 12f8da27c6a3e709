"""The body in a CT: its filled outline, and the pieces that lie apart from it, such as arms and a table.

Everything counts as body unless it is clearly something else: turning tissue into air changes what is scanned, while a
field of view that also contains a table costs time only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import (
    binary_dilation,
    binary_fill_holes,
    binary_opening,
    binary_propagation,
    distance_transform_edt,
    find_objects,
    label,
)
from skimage.measure import block_reduce

from ..base.geometry import Grid
from ..base.units import HU_BODY
from ..io.volumes import Volume

# The outline is found on blocks: pixels of 2 mm for 512 x 512 pixels of 0.98 mm. 300 slices take 3 s of CPU time.
MOST_PIXELS, MOST_SLICES = 256, 64
APART_MM = 1e6  # between slices, so that distances are measured within each slice
# Shares of the radius of the largest circle in the body, R. In config/abdomen.yaml R is 125 mm, an arm has 0.3 R.
SHEET = 0.25  # a detached piece that is thinner: a table's shells (0.03 R), blankets, cables
CREASE = 0.04  # a hole that is thinner stays open: the crease between an arm and the trunk (0.02 R), not a lung
BRIDGE = 0.4  # what is narrower is looked at as a possible arm
PLATE = 0.12  # half the thickness of a table that touches the body
LUNG_HU = -900.0  # denser than air with noise, which has -920 where 200 HU of noise are cut off at -1000
WALL = 3  # pixels of a wall around a lung that is not closed: thinner than those that are closed
# Shares of other sizes.
NECK = 1.0  # of an arm's width: it touches the trunk over less (there 0.5 to 0.97). Ends of an ellipse: over 2
ARM = 0.35  # of the body's area in a slice, at most: an arm has 0.05 to 0.1 of a trunk, a second leg about 1
PLATE_WIDTH = 0.3  # of the body's width, at least, of which less than half touches it: a table's end beside the body
MOST_SLICES_AS_ARM = 0.9  # of a piece, by area: it may merge with the shoulder at its end
ENCLOSED = 0.5  # of the body in a slice: what surrounds as much is its shell

DIAGONAL = np.ones((3, 3, 3), bool)  # neighbours where a thin wall counts as whole
CROSS = np.array([[[0, 1, 0], [1, 1, 1], [0, 1, 0]]], bool)  # neighbours within a slice


@dataclass(frozen=True)
class Body:
    """The body on blocks of a CT's voxels.

    Attributes
    ----------
    mask : ndarray of bool, shape (z, y, x)
        The body with its lungs, sinuses and gas.
    apart : ndarray of bool, shape (z, y, x)
        Pieces that are no part of it: arms, a table, blankets.
    blocks : tuple of int
        Voxels in a block along z, y and x.
    first : int
        The CT's slice at which the blocks begin.
    """

    mask: np.ndarray
    apart: np.ndarray
    blocks: tuple[int, int, int]
    first: int

    def pixels_of(self, axis: int) -> tuple[int, int]:
        """Return the CT's first pixel that is in the body along an axis, and the one after its last."""
        index = np.flatnonzero(self.mask.any(axis=tuple(other for other in range(3) if other != axis)))
        return int(index[0]) * self.blocks[axis], (int(index[-1]) + 1) * self.blocks[axis]

    def with_piece(self, piece: np.ndarray) -> Body:
        """Return the same with one of the pieces apart counted as body."""
        return Body(self.mask | piece, self.apart & ~piece, self.blocks, self.first)


def find_body(image: Volume, first: int = 0, last: int | None = None) -> Body:
    """Find the body in a CT.

    Parameters
    ----------
    image : Volume
        The CT, HU, not below air.
    first, last : int, optional
        Slices to look at: from the first to the one before the last.

    Returns
    -------
    Body
        Its mask is empty if nothing is denser than HU_BODY.
    """
    array = image.array[first:last]
    blocks = tuple(math.ceil(n / most) for n, most in zip(array.shape, (MOST_SLICES, *[MOST_PIXELS] * 2), strict=True))
    mean = block_reduce(array, blocks, np.mean, cval=float(array.min()))
    dense = mean > HU_BODY
    sampling = (APART_MM, *(n * wide for n, wide in zip(blocks[1:], image.grid.spacing[1:], strict=True)))
    depth = _depth(dense, sampling)
    radius = float(depth.max())
    if radius == 0:
        return Body(dense, np.zeros_like(dense), blocks, first)
    sheets = _sheets(dense, depth, SHEET * radius, DIAGONAL)
    sheets &= ~_shells(sheets, dense & ~sheets)
    filled = _filled(dense & ~sheets, CREASE * radius, sampling)
    core = _core(filled, sampling)
    body = core.copy()
    for piece in _pieces(filled & ~core):
        if not _lies_apart(piece, core, dense, radius, sampling):
            body[piece.where] |= piece.mask
    lungs = _open_lungs((mean > LUNG_HU) & ~dense & ~filled, body, CREASE * radius / max(sampling[1:]))
    if lungs.any():
        body |= lungs | (binary_dilation(lungs, CROSS, iterations=WALL) & dense)
    return Body(body, (dense | filled) & ~body, blocks, first)


def _depth(mask: np.ndarray, sampling: tuple[float, ...]) -> np.ndarray:
    """Distance of each voxel of a mask from the nearest outside, in its slice, mm; beyond the CT is air."""
    padded = np.pad(mask, ((0, 0), (1, 1), (1, 1)))
    return distance_transform_edt(padded, sampling=sampling)[:, 1:-1, 1:-1].astype(np.float32)


def _sheets(dense: np.ndarray, depth: np.ndarray, thin_mm: float, neighbours: np.ndarray | None = None) -> np.ndarray:
    """Connected pieces that are thin in every slice."""
    pieces, count = label(dense, neighbours)
    thickest = np.zeros(count + 1, np.float32)
    np.maximum.at(thickest, pieces.ravel(), depth.ravel())
    return dense & (thickest < thin_mm)[pieces]


def _shells(sheets: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Of thin pieces, those that surround the rest, as the wall of a phantom does."""
    shells = np.zeros_like(sheets)
    for piece in _pieces(sheets):
        if _encloses(piece, rest[piece.where[0]]):
            shells[piece.where] |= piece.mask
    return shells


def _filled(mask: np.ndarray, crease_mm: float, sampling: tuple[float, ...]) -> np.ndarray:
    """The mask with its holes filled in each slice, but for creases."""
    holes = np.stack([binary_fill_holes(one) for one in mask]) & ~mask
    return mask | (holes & ~_sheets(holes, _depth(holes, sampling), crease_mm))


def _open_lungs(thin: np.ndarray, body: np.ndarray, pixels: float) -> np.ndarray:
    """Lungs that no wall closes, as the field of view or coarse pixels cut it: they touch the body and are no rim."""
    thick = binary_opening(thin, CROSS, iterations=max(2, math.ceil(2 * pixels)))
    return binary_propagation(binary_dilation(body, CROSS) & thick, CROSS, mask=thick)


def _core(filled: np.ndarray, sampling: tuple[float, ...]) -> np.ndarray:
    """Per slice, the union of circles of BRIDGE times the largest radius in it; of several pieces the large ones."""
    depth = _depth(filled, sampling)
    widest = depth.max(axis=(1, 2))
    # Slices that show only a table or hands have no core: their largest circle is small beside the volume's.
    radius = BRIDGE * np.maximum(widest, widest.max() / 2)[:, None, None]
    deep = depth > radius
    opened = filled & (distance_transform_edt(~deep, sampling=sampling) <= radius)
    # A pixel more: the circle's edge on pixels is uneven, and what it leaves must not be lost with an arm that touches.
    opened = binary_dilation(opened, CROSS, mask=filled)
    for number, one in enumerate(opened):
        pieces, count = label(one)
        if count > 1:
            area = np.bincount(pieces.ravel())
            area[0] = 0
            opened[number] = one & (area >= ARM * area.max())[pieces]
    return opened


@dataclass(frozen=True)
class _Piece:
    mask: np.ndarray
    where: tuple[slice, slice, slice]


def _pieces(rest: np.ndarray) -> Iterator[_Piece]:
    numbers, _ = label(rest)
    for number, where in enumerate(find_objects(numbers), start=1):
        yield _Piece(numbers[where] == number, where)


def _lies_apart(piece: _Piece, core: np.ndarray, dense: np.ndarray, radius: float, sampling: tuple[float, ...]) -> bool:
    """Whether a piece beside the core is an arm or a table."""
    z, y, x = piece.where
    beside = core[z]
    areas = beside.sum(axis=(1, 2))
    if not areas.any():
        return True
    around = (z, *(slice(max(0, one.start - 1), one.stop + 1) for one in (y, x)))
    mask = np.zeros((z.stop - z.start, *(core[around].shape[1:])), bool)
    mask[:, y.start - around[1].start :, x.start - around[2].start :][:, : y.stop - y.start, : x.stop - x.start] = (
        piece.mask
    )
    own = mask.sum(axis=(1, 2))
    contact = (binary_dilation(core[around], CROSS) & mask).sum(axis=(1, 2)) * sampling[1]
    if _encloses(piece, beside):
        return False
    thick = _depth(mask & dense[around], sampling).max(axis=(1, 2))
    columns = np.flatnonzero(beside.any(axis=(0, 1)))
    low, high = columns[0], columns[-1] + 1
    wide = (x.stop - x.start) * sampling[2]
    if wide >= PLATE_WIDTH * (high - low) * sampling[2] and thick.max() <= PLATE * radius and contact.max() <= wide / 2:
        return True
    touches = contact > 0
    lateral = ~np.isin(np.arange(x.start, x.stop), np.arange(low, high))
    beyond = piece.mask[..., lateral].sum() >= piece.mask.sum() / 2
    as_arm = ~touches | ((contact <= NECK * 2 * thick) & beyond)
    small = own <= ARM * np.maximum(areas, areas[areas > 0].min())
    return bool(own[as_arm & small].sum() >= MOST_SLICES_AS_ARM * own.sum())


def _encloses(piece: _Piece, core: np.ndarray) -> bool:
    """Whether a piece surrounds most of the core in some slice, as the shell of a phantom does."""
    _, y, x = piece.where
    for one, inside in zip(piece.mask, core, strict=True):
        total = np.count_nonzero(inside)
        if total and np.count_nonzero(binary_fill_holes(one) & ~one & inside[y, x]) >= ENCLOSED * total:
            return True
    return False


def edges_mm(grid: Grid, axis: int, pixels: tuple[int, int]) -> tuple[float, float]:
    """Return the world positions (mm) of the outer edges of pixels along an axis of the array (0: z, 1: y, 2: x)."""
    start = grid.centre_mm[2 - axis] - grid.shape[axis] / 2 * grid.spacing[axis]
    low, high = pixels
    return start + low * grid.spacing[axis], start + min(high, grid.shape[axis]) * grid.spacing[axis]
