"""Segment the body in a CT: its filled outline, and detached pieces such as arms and the table.

Everything counts as body unless it is clearly something else. Tissue that becomes air changes the object, while a
table in the field of view only costs time.
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

# The outline is found on blocks of voxels: 2 mm for 512 x 512 pixels of 0.98 mm. 300 slices take 3 s of CPU time.
MOST_PIXELS, MOST_SLICES = 256, 64
SLICE_DISTANCE_MM = 1e6  # between slices, so that distances are measured within each slice
# Fractions of the radius R of the largest circle in the body. In config/abdomen.yaml R is 125 mm, an arm has 0.3 R.
SHEET = 0.25  # thinner detached pieces are sheets: shells of a table (0.03 R), blankets, cables
CREASE = 0.04  # thinner holes stay open: the crease between an arm and the trunk (0.02 R), not a lung
BRIDGE = 0.4  # narrower parts are tested for being an arm
PLATE = 0.12  # largest half thickness of a table that touches the body
LUNG_HU = -900.0  # above air with noise: noise of 200 HU clipped at -1000 HU has a mean of -920 HU
WALL = 3  # pixels of the wall of an open lung; closed walls are thicker
# Fractions of other sizes.
NECK = 1.0  # of the width of an arm, which touches the trunk over less (0.5 to 0.97). Ends of an ellipse: over 2
ARM = 0.35  # largest area of an arm relative to the body in a slice: an arm has 0.05 to 0.1, a second leg about 1
PLATE_WIDTH = 0.3  # least width of a table relative to the body, less than half of which touches the body
LEAST_ARM_SHARE = 0.9  # least fraction of the area that looks like an arm: the rest may merge with the shoulder
ENCLOSED = 0.5  # a piece that surrounds this fraction of the body in a slice is its shell

DIAGONAL = np.ones((3, 3, 3), bool)  # neighborhood in which thin walls are connected
CROSS = np.array([[[0, 1, 0], [1, 1, 1], [0, 1, 0]]], bool)  # neighborhood within a slice


@dataclass(frozen=True)
class Body:
    """The body on blocks of a CT's voxels.

    Attributes
    ----------
    mask : ndarray of bool, shape (z, y, x)
        The body with its lungs, sinuses and gas.
    detached : ndarray of bool, shape (z, y, x)
        Pieces that are not part of the body: arms, a table, blankets.
    blocks : tuple of int
        Voxels per block along z, y and x.
    first : int
        Index of the first slice of the CT in the blocks.
    """

    mask: np.ndarray
    detached: np.ndarray
    blocks: tuple[int, int, int]
    first: int

    def pixels_of(self, axis: int) -> tuple[int, int]:
        """Return the first pixel of the CT in the body along an axis, and the pixel after the last."""
        index = np.flatnonzero(self.mask.any(axis=tuple(other for other in range(3) if other != axis)))
        return int(index[0]) * self.blocks[axis], (int(index[-1]) + 1) * self.blocks[axis]

    def with_piece(self, piece: np.ndarray) -> Body:
        """Return the body with one of the detached pieces added."""
        return Body(self.mask | piece, self.detached & ~piece, self.blocks, self.first)


def find_body(image: Volume, first: int = 0, last: int | None = None) -> Body:
    """Find the body in a CT.

    Parameters
    ----------
    image : Volume
        The CT, HU, not below air.
    first, last : int, optional
        Range of slices; `last` is excluded.

    Returns
    -------
    Body
        With an empty mask if no voxel is denser than HU_BODY.
    """
    array = image.array[first:last]
    blocks = tuple(math.ceil(n / most) for n, most in zip(array.shape, (MOST_SLICES, *[MOST_PIXELS] * 2), strict=True))
    mean = block_reduce(array, blocks, np.mean, cval=float(array.min()))
    dense = mean > HU_BODY
    sampling = (SLICE_DISTANCE_MM, *(n * wide for n, wide in zip(blocks[1:], image.grid.spacing[1:], strict=True)))
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
        if not _is_detached(piece, core, dense, radius, sampling):
            body[piece.where] |= piece.mask
    lungs = _open_lungs((mean > LUNG_HU) & ~dense & ~filled, body, CREASE * radius / max(sampling[1:]))
    if lungs.any():
        body |= lungs | (binary_dilation(lungs, CROSS, iterations=WALL) & dense)
    return Body(body, (dense | filled) & ~body, blocks, first)


def _depth(mask: np.ndarray, sampling: tuple[float, ...]) -> np.ndarray:
    """Return the distance (mm) of each voxel of a mask from the outside, within its slice."""
    padded = np.pad(mask, ((0, 0), (1, 1), (1, 1)))
    return distance_transform_edt(padded, sampling=sampling)[:, 1:-1, 1:-1].astype(np.float32)


def _sheets(dense: np.ndarray, depth: np.ndarray, thin_mm: float, neighbours: np.ndarray | None = None) -> np.ndarray:
    """Return connected pieces that are thin in every slice."""
    pieces, count = label(dense, neighbours)
    thickest = np.zeros(count + 1, np.float32)
    np.maximum.at(thickest, pieces.ravel(), depth.ravel())
    return dense & (thickest < thin_mm)[pieces]


def _shells(sheets: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return the thin pieces that surround the rest, such as the wall of a phantom."""
    shells = np.zeros_like(sheets)
    for piece in _pieces(sheets):
        if _encloses(piece, rest[piece.where[0]]):
            shells[piece.where] |= piece.mask
    return shells


def _filled(mask: np.ndarray, crease_mm: float, sampling: tuple[float, ...]) -> np.ndarray:
    """Fill the holes of a mask in each slice, except creases."""
    holes = np.stack([binary_fill_holes(plane) for plane in mask]) & ~mask
    return mask | (holes & ~_sheets(holes, _depth(holes, sampling), crease_mm))


def _open_lungs(thin: np.ndarray, body: np.ndarray, pixels: float) -> np.ndarray:
    """Return lungs whose wall is cut by the field of view or by coarse pixels: thick pieces that touch the body."""
    thick = binary_opening(thin, CROSS, iterations=max(2, math.ceil(2 * pixels)))
    return binary_propagation(binary_dilation(body, CROSS) & thick, CROSS, mask=thick)


def _core(filled: np.ndarray, sampling: tuple[float, ...]) -> np.ndarray:
    """Return the union of circles of BRIDGE times the largest radius in each slice, without small pieces."""
    depth = _depth(filled, sampling)
    widest = depth.max(axis=(1, 2))
    # Slices that show only a table or hands have no core: their largest circle is small relative to the volume.
    radius = BRIDGE * np.maximum(widest, widest.max() / 2)[:, None, None]
    deep = depth > radius
    opened = filled & (distance_transform_edt(~deep, sampling=sampling) <= radius)
    # One more pixel, because circles are uneven on pixels: the remainder must not be removed with an adjacent arm.
    opened = binary_dilation(opened, CROSS, mask=filled)
    for number, plane in enumerate(opened):
        pieces, count = label(plane)
        if count > 1:
            area = np.bincount(pieces.ravel())
            area[0] = 0
            opened[number] = plane & (area >= ARM * area.max())[pieces]
    return opened


@dataclass(frozen=True)
class _Piece:
    mask: np.ndarray
    where: tuple[slice, slice, slice]


def _pieces(rest: np.ndarray) -> Iterator[_Piece]:
    numbers, _ = label(rest)
    for number, where in enumerate(find_objects(numbers), start=1):
        yield _Piece(numbers[where] == number, where)


def _is_detached(
    piece: _Piece, core: np.ndarray, dense: np.ndarray, radius: float, sampling: tuple[float, ...]
) -> bool:
    """Return whether a piece next to the core is an arm or a table."""
    z, y, x = piece.where
    core_slices = core[z]
    areas = core_slices.sum(axis=(1, 2))
    if not areas.any():
        return True
    around = (z, *(slice(max(0, extent.start - 1), extent.stop + 1) for extent in (y, x)))
    mask = np.zeros((z.stop - z.start, *(core[around].shape[1:])), bool)
    mask[:, y.start - around[1].start :, x.start - around[2].start :][:, : y.stop - y.start, : x.stop - x.start] = (
        piece.mask
    )
    piece_areas = mask.sum(axis=(1, 2))
    contact = (binary_dilation(core[around], CROSS) & mask).sum(axis=(1, 2)) * sampling[1]
    if _encloses(piece, core_slices):
        return False
    thick = _depth(mask & dense[around], sampling).max(axis=(1, 2))
    columns = np.flatnonzero(core_slices.any(axis=(0, 1)))
    low, high = columns[0], columns[-1] + 1
    wide = (x.stop - x.start) * sampling[2]
    if wide >= PLATE_WIDTH * (high - low) * sampling[2] and thick.max() <= PLATE * radius and contact.max() <= wide / 2:
        return True
    touches = contact > 0
    lateral = ~np.isin(np.arange(x.start, x.stop), np.arange(low, high))
    beyond = piece.mask[..., lateral].sum() >= piece.mask.sum() / 2
    as_arm = ~touches | ((contact <= NECK * 2 * thick) & beyond)
    small = piece_areas <= ARM * np.maximum(areas, areas[areas > 0].min())
    return bool(piece_areas[as_arm & small].sum() >= LEAST_ARM_SHARE * piece_areas.sum())


def _encloses(piece: _Piece, core: np.ndarray) -> bool:
    """Return whether a piece surrounds most of the core in some slice, as the shell of a phantom does."""
    _, y, x = piece.where
    for plane, inside in zip(piece.mask, core, strict=True):
        total = np.count_nonzero(inside)
        if total and np.count_nonzero(binary_fill_holes(plane) & ~plane & inside[y, x]) >= ENCLOSED * total:
            return True
    return False


def edges_mm(grid: Grid, axis: int, pixels: tuple[int, int]) -> tuple[float, float]:
    """Return the world positions (mm) of the outer edges of pixels along an axis of the array (0: z, 1: y, 2: x)."""
    start = grid.centre_mm[2 - axis] - grid.shape[axis] / 2 * grid.spacing[axis]
    low, high = pixels
    return start + low * grid.spacing[axis], start + min(high, grid.shape[axis]) * grid.spacing[axis]
