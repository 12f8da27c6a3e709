"""What every reader of drawn regions shares: regions within their boxes, remarks about them, gaps between slices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pydicom
from scipy.ndimage import distance_transform_edt

from ..base.console import note
from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.volumes import LARGEST_TILT, LPS_TO_RAS

GRID_TOLERANCE_MM = 0.02  # of positions read from different files: single precision and decimal text
ONE_BY_ONE = 3  # remarks of one kind about one file; more become one line

Box = tuple[slice, slice, slice]


@dataclass(frozen=True)
class Remark:
    """Something about a region that was skipped or interpreted, which is no error.

    Attributes
    ----------
    kind : str
        What regions with the same remark have in common.
    name : str
        Name of the region; empty if the remark is about the file.
    text : str
        What was skipped or interpreted, and why.
    """

    kind: str
    name: str
    text: str


@dataclass(frozen=True)
class Drawn:
    """A region within its box.

    Attributes
    ----------
    box : tuple of 3 slice
        Part of the CT, (z, y, x).
    mask : ndarray of bool
        Within the box.
    """

    box: Box
    mask: np.ndarray
    remarks: tuple[Remark, ...] = ()


def report(path: Path, remarks: Iterable[Remark]) -> None:
    """Report remarks about the regions of a file as notes; many of one kind become one line that names all regions."""
    kinds: dict[str, list[Remark]] = {}
    for remark in dict.fromkeys(remarks):
        kinds.setdefault(remark.kind, []).append(remark)
    for alike in kinds.values():
        for one in alike if len(alike) <= ONE_BY_ONE else alike[:1]:
            note(f"{path}: {f'{one.name}: ' if one.name else ''}{one.text}")
        if len(alike) > ONE_BY_ONE:
            others = ", ".join(one.name for one in alike[1:])
            note(f"{path}: the same applies to {len(alike) - 1} more regions ({alike[0].kind}): {others}")


class Regions:
    """Base of the readers: regions that are drawn on a CT.

    Parameters
    ----------
    path : Path
        The file.
    grid : Grid
        The CT's.
    """

    def __init__(self, path: Path, grid: Grid):
        self.path, self.grid = path, grid

    def there(self) -> dict[int | str, str | None]:
        """Every region: {label, as `mask` and `crop` take it: its name; None if the file has none}."""
        raise NotImplementedError

    def aliases(self, label: int | str) -> tuple[str, ...]:
        """What else a region may be called than its label of `there` and its name."""
        return ()

    def _draw(self, label: int | str | None) -> tuple[str, Drawn | None, bool]:
        """A region's name, its voxels (None: it has none), and whether every empty slice within it is worth a remark.

        Without the latter an empty slice is remarked on only if the slices on both sides of the gap overlap.
        """
        raise NotImplementedError

    def crop(self, label: int | str | None, fill_gaps: bool = False) -> Drawn | None:
        """A region within its box.

        Parameters
        ----------
        label : int, str or None
            As `there` gives it, or another name or number that means one region only; None: the only region.
        fill_gaps : bool, optional
            Interpolate empty slices between two drawn ones.

        Returns
        -------
        Drawn or None
            None if the region has no voxel.

        Raises
        ------
        InputError
            If there is no such region, or several, or it cannot be read.
        """
        name, drawn, always = self._draw(label)
        if drawn is None:
            return None
        return _without_gaps(drawn, name, self.grid, fill_gaps, always)

    def mask(self, label: int | str | None, fill_gaps: bool = False) -> np.ndarray:
        """A region on the CT's grid; what was skipped or interpreted is reported.

        Returns
        -------
        ndarray of bool, shape (z, y, x)

        Raises
        ------
        InputError
            As `crop`.
        """
        full = np.zeros(self.grid.shape, bool)
        drawn = self.crop(label, fill_gaps)
        if drawn is not None:
            report(self.path, drawn.remarks)
            full[drawn.box] = drawn.mask
        return full


def _without_gaps(drawn: Drawn, name: str, grid: Grid, fill: bool, always: bool) -> Drawn:
    """The region with empty slices interpolated, or with a remark about them."""
    taken = np.flatnonzero(drawn.mask.any(axis=(1, 2)))
    gaps = [(int(a), int(b)) for a, b in zip(taken[:-1], taken[1:], strict=True) if b - a > 1]
    if not gaps:
        return drawn
    joined = [(a, b) for a, b in gaps if (drawn.mask[a] & drawn.mask[b]).any()]
    slices = len(drawn.mask)
    z = grid.affine[2, 3] + grid.spacing[0] * np.array([drawn.box[0].start, drawn.box[0].stop - 1])
    where = f"of its {slices} slices from z = {z[0]:g} to {z[1]:g} mm"
    if fill:
        mask = drawn.mask.copy()
        for a, b in joined:
            mask[a + 1 : b] = _between(mask[a], mask[b], b - a, grid)
        filled = sum(b - a - 1 for a, b in joined)
        left = sum(b - a - 1 for a, b in gaps) - filled
        text = f"{filled} {where} are interpolated (fill_gaps)"
        text += f"; {left} stay empty, as the slices on both sides do not overlap" if left else ""
        return replace(drawn, mask=mask, remarks=(*drawn.remarks, Remark("interpolated slices", name, text)))
    missing = sum(b - a - 1 for a, b in (gaps if always else joined))
    if not missing:
        return drawn
    text = (
        f"{missing} {where} are not drawn and stay empty; to interpolate them, set fill_gaps: true in the ROI's entry "
        "(init: --fill-gaps)"
    )
    return replace(drawn, remarks=(*drawn.remarks, Remark("slices that are not drawn", name, text)))


def _between(low: np.ndarray, high: np.ndarray, steps: int, grid: Grid) -> np.ndarray:
    """Shape-based interpolation: linear between signed distances (Raya and Udupa 1990, doi:10.1109/42.52980)."""
    first, last = (_signed_distance(one, grid) for one in (low, high))
    shares = (np.arange(1, steps) / steps)[:, None, None]
    return (1 - shares) * first + shares * last > 0


def _signed_distance(mask: np.ndarray, grid: Grid) -> np.ndarray:
    """Distance to the outline, mm, positive inside."""
    padded = np.pad(mask, 1)
    spacing = grid.spacing[1:]
    return (distance_transform_edt(padded, spacing) - distance_transform_edt(~padded, spacing))[1:-1, 1:-1]


def boxed(mask: np.ndarray, offset: Sequence[int] = (0, 0, 0), remarks: Sequence[Remark] = ()) -> Drawn | None:
    """The smallest box around a mask.

    Parameters
    ----------
    mask : ndarray of bool, shape (z, y, x)
    offset : sequence of int, optional
        Voxel of the CT that is the mask's first.

    Returns
    -------
    Drawn or None
        None if the mask is empty.
    """
    inner = []
    for axes in ((1, 2), (0, 2), (0, 1)):
        index = np.flatnonzero(mask.any(axis=axes))
        if not index.size:
            return None
        inner.append(slice(int(index[0]), int(index[-1]) + 1))
    box = tuple(slice(one.start + int(n), one.stop + int(n)) for one, n in zip(inner, offset, strict=True))
    return Drawn(box, mask[tuple(inner)].copy(), tuple(remarks))


def to_voxels(grid: Grid) -> list[np.ndarray]:
    """How positions of regions can be meant that were drawn on a CT.

    Parameters
    ----------
    grid : Grid
        The CT's.

    Returns
    -------
    list of ndarray, shape (4, 4)
        From DICOM's patient frame (mm, LPS) to voxel indices (x, y, z); the first that fits is meant: by the CT's own
        directions or, if that moves no voxel center by more than LARGEST_TILT, upright.
    """
    ends = np.vstack([_corners(grid).T, np.ones(8)])
    moved = np.linalg.inv(grid.affine) @ (grid.drawn_affine @ ends) - ends
    upright = grid.directions is not None and np.abs(moved).max() <= LARGEST_TILT
    affines = [grid.drawn_affine, *([grid.affine] if upright else [])]
    return [np.linalg.inv(affine) @ LPS_TO_RAS for affine in affines]


def _corners(grid: Grid) -> np.ndarray:
    """Voxel indices (x, y, z) of the corners, shape (8, 3)."""
    return np.array(list(product(*[(0, n - 1) for n in grid.shape[::-1]])), float)


def placed(part: Grid, grid: Grid, path: Path) -> tuple[int, int, int]:
    """The voxel (z, y, x) of a grid at which the first voxel of another grid lies, whose voxels coincide with its own.

    They coincide by the directions of both. By their upright grids alone they may, if directions differ by so little
    that no voxel center moves by more than LARGEST_TILT: converters often drop a small rotation.

    Returns
    -------
    tuple of 3 int
        Below 0 where the other grid begins before the first.

    Raises
    ------
    InputError
        If they do not coincide.
    """
    corners = _corners(part)
    relative = np.linalg.inv(grid.drawn_affine) @ part.drawn_affine
    shift = corners @ relative[:3, :3].T + relative[:3, 3] - corners
    index = shift.mean(axis=0).round()
    off = np.abs(shift - index)
    if (off * grid.spacing[::-1]).max() <= GRID_TOLERANCE_MM:
        return tuple(index[::-1].astype(int).tolist())
    offset = (part.affine[:3, 3] - grid.affine[:3, 3])[::-1] / np.array(grid.spacing)
    index = offset.round()
    steps = np.array(part.shape) * (np.array(part.spacing) - np.array(grid.spacing))
    shifted = np.abs((offset - index) * np.array(grid.spacing)).max()
    aligned = max(shifted, np.abs(steps).max()) <= GRID_TOLERANCE_MM
    if not aligned or np.abs(shift - index[::-1]).max() > LARGEST_TILT:
        turned = ", with its axes rotated otherwise" if aligned else ""
        raise InputError(
            f"{path}: lies on another grid than the CT{turned} ({part}; CT: {grid}); resample it onto the CT"
        )
    return tuple(index.astype(int).tolist())


def sequence_of(path: Path, dataset: pydicom.Dataset, keyword: str) -> pydicom.Sequence:
    """A sequence of a DICOM data set; InputError if it is missing or no sequence."""
    value = dataset.get(keyword)
    if not isinstance(value, pydicom.Sequence):
        problem = "has no" if value is None else "has no valid"
        raise InputError(f"{path}: {problem} {keyword}; export the file again")
    return value


def whole_number(dataset: pydicom.Dataset, keyword: str) -> int | None:
    """A whole number; None if it is missing or something else."""
    try:
        value = dataset.get(keyword)
        return None if value is None or isinstance(value, str | bytes) and not str(value).strip() else int(value)
    except (TypeError, ValueError, OverflowError):
        return None
