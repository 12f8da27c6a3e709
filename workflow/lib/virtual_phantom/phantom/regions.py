"""Base class of the readers of drawn regions: cropped regions, remarks, and gaps between slices."""

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

GRID_TOLERANCE_MM = 0.02  # tolerance of positions from different files: single precision and decimal text
ONE_BY_ONE = 3  # remarks of one kind about a file that are listed; further ones are summarized

Box = tuple[slice, slice, slice]


@dataclass(frozen=True)
class Remark:
    """A note about data that were skipped or interpreted, and why.

    Attributes
    ----------
    kind : str
        Groups the same remarks about several regions.
    name : str
        Name of the region; empty for a remark about the file.
    """

    kind: str
    name: str
    text: str


@dataclass(frozen=True)
class CroppedRegion:
    """A region: its bounding box (z, y, x) in the CT, and the mask within the box."""

    box: Box
    mask: np.ndarray
    remarks: tuple[Remark, ...] = ()


def report(path: Path, remarks: Iterable[Remark]) -> None:
    """Print remarks about the regions of a file as notes; many of one kind become one line."""
    kinds: dict[str, list[Remark]] = {}
    for remark in dict.fromkeys(remarks):
        kinds.setdefault(remark.kind, []).append(remark)
    for same in kinds.values():
        for remark in same if len(same) <= ONE_BY_ONE else same[:1]:
            note(f"{path}: {f'{remark.name}: ' if remark.name else ''}{remark.text}")
        if len(same) > ONE_BY_ONE:
            others = ", ".join(remark.name for remark in same[1:])
            note(f"{path}: the same applies to {len(same) - 1} more regions ({same[0].kind}): {others}")


class Regions:
    """Regions in a file that were drawn on the grid of a CT: base class of the readers."""

    def __init__(self, path: Path, grid: Grid):
        self.path, self.grid = path, grid

    def list_regions(self) -> dict[int | str, str | None]:
        """Return {label: name} of every region; names are None if the file has none."""
        raise NotImplementedError

    def aliases(self, label: int | str) -> tuple[str, ...]:
        """Return other names of a region than its label and name in `list_regions`."""
        return ()

    def _draw(self, label: int | str | None) -> tuple[str, CroppedRegion | None, bool]:
        """Return the name of a region, its voxels (None if empty), and whether all gaps are reported.

        Otherwise, gaps are reported only if the slices on both sides overlap.
        """
        raise NotImplementedError

    def crop(self, label: int | str | None, fill_gaps: bool = False) -> CroppedRegion | None:
        """Return a region within its bounding box; None if it has no voxel.

        Parameters
        ----------
        label : int, str or None
            Label of `list_regions`, or another unique name or number; None for the only region.
        fill_gaps : bool, optional
            Interpolate empty slices between drawn ones.

        Raises
        ------
        InputError
            If there is no such region or several, or it cannot be read.
        """
        name, drawn, always = self._draw(label)
        if drawn is None:
            return None
        return _without_gaps(drawn, name, self.grid, fill_gaps, always)

    def mask(self, label: int | str | None, fill_gaps: bool = False) -> np.ndarray:
        """Return a region on the grid of the CT, bool [z, y, x], and report remarks; parameters as in `crop`."""
        full = np.zeros(self.grid.shape, bool)
        drawn = self.crop(label, fill_gaps)
        if drawn is not None:
            report(self.path, drawn.remarks)
            full[drawn.box] = drawn.mask
        return full


def _without_gaps(drawn: CroppedRegion, name: str, grid: Grid, fill: bool, always: bool) -> CroppedRegion:
    """Interpolate empty slices, or add a remark about them."""
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
    first, last = (_signed_distance(mask, grid) for mask in (low, high))
    shares = (np.arange(1, steps) / steps)[:, None, None]
    return (1 - shares) * first + shares * last > 0


def _signed_distance(mask: np.ndarray, grid: Grid) -> np.ndarray:
    """Return the distance to the outline, mm, positive inside."""
    padded = np.pad(mask, 1)
    spacing = grid.spacing[1:]
    return (distance_transform_edt(padded, spacing) - distance_transform_edt(~padded, spacing))[1:-1, 1:-1]


def crop_to_box(mask: np.ndarray, offset: Sequence[int], remarks: Sequence[Remark]) -> CroppedRegion | None:
    """Crop a mask, whose first voxel is at `offset` in the CT, to its bounding box; None if it is empty."""
    inner = []
    for axes in ((1, 2), (0, 2), (0, 1)):
        index = np.flatnonzero(mask.any(axis=axes))
        if not index.size:
            return None
        inner.append(slice(int(index[0]), int(index[-1]) + 1))
    box = tuple(slice(s.start + int(n), s.stop + int(n)) for s, n in zip(inner, offset, strict=True))
    return CroppedRegion(box, mask[tuple(inner)].copy(), tuple(remarks))


def to_voxels(grid: Grid) -> list[np.ndarray]:
    """Return possible affines from DICOM's patient frame (mm, LPS) to voxel indices (x, y, z) of a CT.

    The first affine that fits the regions is used. The first has the directions of the CT. The second is upright, if
    this moves no voxel center by more than LARGEST_TILT.
    """
    ends = np.vstack([_corners(grid).T, np.ones(8)])
    moved = np.linalg.inv(grid.affine) @ (grid.drawn_affine @ ends) - ends
    upright = grid.directions is not None and np.abs(moved).max() <= LARGEST_TILT
    affines = [grid.drawn_affine, *([grid.affine] if upright else [])]
    return [np.linalg.inv(affine) @ LPS_TO_RAS for affine in affines]


def _corners(grid: Grid) -> np.ndarray:
    """Return the voxel indices (x, y, z) of the corners, shape (8, 3)."""
    return np.array(list(product(*[(0, n - 1) for n in grid.shape[::-1]])), float)


def voxel_offset(part: Grid, grid: Grid, path: Path) -> tuple[int, int, int]:
    """Return the index (z, y, x) in a grid of the first voxel of a part, if their voxels coincide.

    Voxels may coincide by the directions of both grids, or by their upright grids if no voxel center moves by more than
    LARGEST_TILT, as converters often drop small rotations. Indices are negative if the part starts before the grid.

    Raises
    ------
    InputError
        If voxels do not coincide.
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
    same_if_upright = max(shifted, np.abs(steps).max()) <= GRID_TOLERANCE_MM
    if not same_if_upright or np.abs(shift - index[::-1]).max() > LARGEST_TILT:
        turned = ", with rotated axes" if same_if_upright else ""
        raise InputError(
            f"{path}: lies on another grid than the CT{turned} ({part}; CT: {grid}); resample it onto the CT"
        )
    return tuple(index.astype(int).tolist())


def sequence_of(path: Path, dataset: pydicom.Dataset, keyword: str) -> pydicom.Sequence:
    """Return a sequence of a DICOM data set; InputError if it is missing or not a sequence."""
    value = dataset.get(keyword)
    if not isinstance(value, pydicom.Sequence):
        problem = "has no" if value is None else "has no valid"
        raise InputError(f"{path}: {problem} {keyword}; export the file again")
    return value


def whole_number(dataset: pydicom.Dataset, keyword: str) -> int | None:
    """Return an integer of a DICOM data set; None if it is missing or not an integer."""
    try:
        value = dataset.get(keyword)
        return None if value is None or isinstance(value, str | bytes) and not str(value).strip() else int(value)
    except (TypeError, ValueError, OverflowError):
        return None
