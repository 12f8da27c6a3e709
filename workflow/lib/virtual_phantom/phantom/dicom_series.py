"""Read one axial CT series from DICOM files, and refuse anything that would be read wrongly.

Attributes as in DICOM PS3.3, C.7.6.2 (image plane) and C.8.2.1 (CT image). DICOM's patient frame is LPS: x
and y have the opposite sign of the NIfTI world frame used here.
"""

from __future__ import annotations

import itertools
import math
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.console import note
from ..base.errors import InputError
from ..base.geometry import Grid
from ..base.words import counted
from ..io.volumes import LARGEST_TILT, LPS_TO_RAS, ORTHOGONAL, Volume, check_fits, is_small_rotation, upright
from .dicom_files import NEEDED, Slice, Unused, files_in, folders_under, not_dicom, slices_of
from .dicom_pixels import check_pixels, read_into, same_pixels

__all__ = ["Series", "find_series", "read_series", "read_slices", "series_among"]

POSITION_TOLERANCE_MM = 0.01  # headers give positions as decimal text, often rounded to this
# Largest disagreement between slices, in voxels at the border of a slice or in distance between slices. A missing slice
# moves its neighbors by at least a third of a voxel from the line that fits best (3 slices), by more with more slices.
LARGEST_DISAGREEMENT = 0.1
SQUARE = 0.01  # share by which sides of a pixel may differ: reconstructed CT has square pixels, up to rounding
LISTED = 4  # series that a message names


@dataclass(frozen=True)
class Series:
    """The slices of one series.

    Attributes
    ----------
    name : str
        What messages begin with: its folder, and its number where the folder has several.
    """

    name: str
    slices: tuple[Slice, ...]


def read_series(folder: str | Path) -> Volume:
    """Read a series as HU on an upright grid, whatever the order of the files.

    Parameters
    ----------
    folder : str or Path
        Files of one CT series. What else is in it is not used, and a note says so.

    Returns
    -------
    Volume
        float32.

    Raises
    ------
    InputError
        If the folder has no CT slice or more than one series, or as `read_slices`.
    """
    return read_slices(find_series(folder))


def find_series(folder: str | Path) -> Series:
    """The one axial CT series in a folder.

    Raises
    ------
    InputError
        If there is none or more than one, or a file cannot be read.
    """
    folder, unused = Path(folder), Unused()
    slices = slices_of(files_in(folder), unused)
    if not slices:
        raise InputError(_nothing(folder, unused))
    found = series_among(slices, unused, folder)
    if len(found) > 1:
        raise InputError(
            f"{folder}: holds more than one DICOM series: {described(found)}; copy or link the files of one series "
            "into a new folder and give that"
        )
    inner = [path for path in folders_under(folder, Unused()) if path != folder and files_in(path)]
    if inner:
        names = ", ".join(str(path.relative_to(folder)) for path in inner[:LISTED])
        more = f" and {len(inner) - LISTED} more" if len(inner) > LISTED else ""
        note(f"{folder}: folders in it are not read ({names}{more})")
    unused.report(folder)
    return found[0]


def _nothing(folder: Path, unused: Unused) -> str:
    """The message about a folder without CT slices: what is in it, and which folders below have some."""
    lines = unused.lines(folder)
    below = []
    for inner in itertools.islice(folders_under(folder, Unused()), 1, 200):
        if any(not not_dicom(path) for path in files_in(inner)):
            below.append(str(inner))
    any_dicom = "CT slice in HU" if unused.headers else "DICOM file"
    there = f" ({'; '.join(lines)})" if lines else ""
    more = f" and {len(below) - LISTED} more" if len(below) > LISTED else ""
    if below:
        return f"{folder}: holds no {any_dicom}{there}; folders below have DICOM files, give one: " + (
            ", ".join(below[:LISTED]) + more
        )
    return f"{folder}: holds no {any_dicom}{there}; give a folder with one CT series"


def series_among(slices: Sequence[Slice], unused: Unused, top: Path) -> list[Series]:
    """Group slices by series, and separate series that are not a stack of axial slices.

    Parameters
    ----------
    slices : sequence of Slice
        Of one folder or of a tree.
    unused : Unused
        Series that are not used are added. Its files are compared with the series that are.
    top : Path
        The folder, for messages.

    Returns
    -------
    list of Series
        In the order of folders, then of series numbers. If none is a stack of axial slices, all are returned, and
        `read_slices` says why each cannot be read.

    Raises
    ------
    InputError
        If a file that is not used continues a series that is.
    """
    groups = _groups(slices)
    stacks = [group for group in groups if _is_stack(group)] or groups
    for group in groups:
        if group in stacks:
            continue
        if not group[0].has("SeriesInstanceUID"):
            raise InputError(f"{group[0].path}: has no SeriesInstanceUID, as other slices have; is the file complete?")
        if continued := next((stack for stack in stacks if _continues(group[0], stack)), None):
            series = f"{_label(group)}, which continues the series of {continued[0].path.name}"
            raise InputError(
                f"{top}: holds more than one DICOM series: {series}; give them one SeriesInstanceUID, or move it "
                "elsewhere"
            )
        for one in group:
            unused.add(one.path, f"another series ({_label(group)}), not a stack of axial slices")
    for header, reason in unused.headers:
        for stack in stacks:
            if header.values.get("SeriesInstanceUID") == stack[0].values.get("SeriesInstanceUID"):
                if len(stack) < 2 or _continues(header, stack):
                    raise InputError(
                        f"{header.path}: {reason}, but it continues the CT series of {stack[0].path.name}; correct it, "
                        "or move it elsewhere"
                    )
    several = defaultdict(int)
    for stack in stacks:
        several[_folder(stack)] += 1
    named = []
    for stack in sorted(stacks, key=lambda one: (_folder(one), _series_number(one), one[0].path)):
        folder = _folder(stack)
        number = "" if several[folder] == 1 else f" ({_label(stack)}, {stack[0].path.name})"
        named.append(Series(f"{folder}{number}", tuple(stack)))
    return named


def _groups(slices: Sequence[Slice]) -> list[list[Slice]]:
    """Slices by SeriesInstanceUID; by folder too if folders have slices of one UID at the same position."""
    # Exports spread one series over folders; anonymization may give one UID to all series.
    by_uid = defaultdict(lambda: defaultdict(list))
    for one in slices:
        uid = one.values.get("SeriesInstanceUID", ())
        by_uid[uid if isinstance(uid, tuple) else ()][one.path.parent].append(one)
    groups = []
    for folders in by_uid.values():
        sets = [{one.values.get("ImagePositionPatient") for one in group} for group in folders.values()]
        if sum(map(len, sets)) == len(set().union(*sets)):
            groups.append([one for group in folders.values() for one in group])
        else:
            groups += folders.values()
    return groups


def _folder(group: Sequence[Slice]) -> str:
    return os.path.commonpath([one.path.parent for one in group])


def _series_number(group: Sequence[Slice]) -> float:
    try:
        return group[0].number("SeriesNumber", math.inf)
    except InputError:
        return math.inf


def _label(group: Sequence[Slice]) -> str:
    """A series in words, by facts about the scan: a SeriesDescription may name the patient."""
    number = _series_number(group)
    words = [f"series {number:g}" if math.isfinite(number) else "a series without number"]
    words.append(counted(len(group), "slice"))
    try:
        words += [f"kernel {kernel}" for kernel in [group[0].text("ConvolutionKernel")] if 0 < len(kernel) <= 64]
        words += [f"{group[0].number('SliceThickness'):g} mm"] if group[0].has("SliceThickness") else []
    except InputError:
        pass
    return " of ".join((words[0], ", ".join(words[1:])))


def described(series: Sequence[Series]) -> str:
    """Series in words, for messages: number, slices, kernel, thickness and the first file of each."""
    words = [f"{_label(one.slices)} ({one.slices[0].path.name})" for one in series[:LISTED]]
    more = [f"{len(series) - LISTED} more"] if len(series) > LISTED else []
    return "; ".join(words + more)


def _frame(one: Slice) -> tuple[np.ndarray, ...] | None:
    """Position, direction cosines, spacing and size; None if an attribute is missing or wrong."""
    try:
        return tuple(
            np.array(one.numbers(keyword, count)) for keyword, count in zip(NEEDED, (3, 6, 2, 1, 1), strict=True)
        )
    except InputError:
        return None


def _is_stack(group: Sequence[Slice]) -> bool:
    """True for axial slices at two positions at least."""
    frames = [frame for one in group if (frame := _frame(one)) is not None]
    axial = [frame for frame in frames if _axes(frame[1]) is not None]
    return len({float(frame[0][2]) for frame in axial}) > 1


def _continues(one: Slice, stack: Sequence[Slice]) -> bool:
    """True if a slice has the size, place in-plane and orientation of a stack, or does not tell."""
    mine = _frame(one)
    theirs = next((frame for other in stack if (frame := _frame(other)) is not None), None)
    if theirs is None:
        return False
    if mine is None:  # a slice whose header is damaged; an RTSTRUCT or a report has no pixels
        return one.has("Rows")
    return all(
        np.allclose(a, b, atol=1e-2)
        for a, b in zip((mine[0][:2], *mine[1:]), (theirs[0][:2], *theirs[1:]), strict=True)
    )


def _axes(cosines: np.ndarray) -> np.ndarray | None:
    """Directions of rows and columns rounded to the patient's axes, shape (2, 3); None if slices are not axial."""
    axes = cosines.round().reshape(2, 3)
    along = np.abs(axes[:, :2])
    return (
        axes
        if np.array_equal(along, np.eye(2)) or np.array_equal(along, np.eye(2)[::-1]) and not axes[:, 2].any()
        else None
    )


def read_slices(series: Series) -> Volume:
    """Read the slices of one series as HU on an upright grid.

    Returns
    -------
    Volume
        float32.

    Raises
    ------
    InputError
        If an attribute is missing, wrong or differs between slices, slices are tilted, one is missing, two are at one
        position, or pixels are not in HU.
    """
    slices = list(series.slices)
    _check_geometry(slices)
    check_pixels(slices, series.name)
    slices = _without_copies(series.name, slices)
    affine = _affine(series.name, slices)
    rows, columns = slices[0].whole("Rows"), slices[0].whole("Columns")
    check_fits(4 * len(slices) * rows * columns, series.name)
    array = np.empty((len(slices), rows, columns), np.float32)
    read_into(slices, array, series.name)
    volume = upright(array.T, LPS_TO_RAS @ affine, series.name)
    return Volume(volume.array, replace(volume.grid, directions=_directions(slices, volume.grid)))


def _check_geometry(slices: Sequence[Slice]) -> None:
    """Check that all slices have the attributes of the image plane, and the same size, spacing and orientation."""
    first = slices[0]
    frames = {id(one): one.text("FrameOfReferenceUID") for one in slices if one.has("FrameOfReferenceUID")}
    if len(set(frames.values())) > 1:
        odd = next(one for one in slices if frames.get(id(one), "") not in ("", next(iter(frames.values()))))
        raise InputError(f"{odd.path}: FrameOfReferenceUID differs from the other slices'; give one uniform series")
    for one in slices:
        for keyword in NEEDED:
            if not one.has(keyword):
                raise InputError(
                    f"{one.path}: has no {keyword}; give plain CT slices (multi-frame CT: convert it to NIfTI)"
                )
        size = one.whole("Rows"), one.whole("Columns")
        if min(size) < 1:
            raise InputError(f"{one.path}: Rows and Columns are {size[0]} and {size[1]}; is the file complete?")
        spacing = np.array(one.numbers("PixelSpacing", 2))
        if spacing.min() <= 0:
            raise InputError(f"{one.path}: PixelSpacing{one.quoted('PixelSpacing')} is not positive; correct it")
        theirs = np.array(first.numbers("PixelSpacing", 2))
        away = np.abs(spacing - theirs) / theirs * max(size) / 2
        if size != (first.whole("Rows"), first.whole("Columns")) or away.max() > LARGEST_DISAGREEMENT:
            raise InputError(
                f"{one.path}: slice size or pixel spacing differs from the others'; give one uniform series"
            )
        one.numbers("ImagePositionPatient", 3)
        axes = _axes(np.array(one.numbers("ImageOrientationPatient", 6)))
        if axes is None:
            raise InputError(
                f"{one.path}: slices are tilted or not axial; resample the series onto upright axial slices first"
            )
        if not np.array_equal(axes, _axes(np.array(first.numbers("ImageOrientationPatient", 6)))):
            raise InputError(f"{one.path}: orientation differs from the other slices'; give one uniform series")


def _without_copies(name: str, slices: Sequence[Slice]) -> list[Slice]:
    """Slices from inferior to superior. Of two with the same position and pixels one is left out."""
    ordered = sorted(slices, key=lambda one: one.numbers("ImagePositionPatient", 3)[2])
    kept, copies = ordered[:1], []
    for one in ordered[1:]:
        low, high = (each.numbers("ImagePositionPatient", 3)[2] for each in (kept[-1], one))
        if high - low > POSITION_TOLERANCE_MM:
            kept.append(one)
        elif same_pixels(kept[-1], one):
            copies.append(one.path)
        else:
            numbers = {each.text("AcquisitionNumber") for each in (kept[-1], one)}
            why = (
                f" (AcquisitionNumber {' and '.join(sorted(numbers))})"
                if len(numbers) > 1 and "" not in numbers
                else ""
            )
            raise InputError(
                f"{name}: two slices at z = {low:g} mm, {kept[-1].path.name} and {one.path.name}{why}; give one series "
                "with one slice per position"
            )
    if copies:
        count = f"{len(copies)} files, the first of them {copies[0].name}" if len(copies) > 1 else copies[0].name
        note(f"{name}: not used: {count}: a copy of another slice")
    return kept


def _affine(name: str, slices: Sequence[Slice]) -> np.ndarray:
    """From voxel index (column, row, slice) to mm in LPS, upright; InputError if that moves a voxel too far."""
    positions = np.array([one.numbers("ImagePositionPatient", 3) for one in slices])
    step = _slice_spacing(name, positions)
    cosines = np.array([one.numbers("ImageOrientationPatient", 6) for one in slices]).reshape(-1, 2, 3)
    spacings = np.array([one.numbers("PixelSpacing", 2) for one in slices])
    axes, (row_spacing, column_spacing) = _axes(cosines[0].ravel()), spacings[0]
    ends = np.array([slices[0].whole("Columns") - 1, slices[0].whole("Rows") - 1])
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) * ends
    own = np.einsum("sa,ca,sav->scv", spacings[:, ::-1], corners, cosines) + positions[:, None]
    nominal = (corners * (column_spacing, row_spacing)) @ axes
    nominal = positions[0] + nominal + np.arange(len(slices))[:, None, None] * [0, 0, step]
    difference = (own - nominal).reshape(-1, 3)
    shift = (difference.max(axis=0) + difference.min(axis=0)) / 2
    shift[np.abs(shift) <= POSITION_TOLERANCE_MM] = 0
    away = np.abs(difference - shift).max(axis=0)
    size = np.abs(axes.T @ [column_spacing, row_spacing]) + [0, 0, step]
    # A tilt of the gantry that the orientation does not show moves voxels along z, most at the border of the slices.
    tilts = [abs(one.number("GantryDetectorTilt", 0.0)) for one in slices]
    turned = math.sin(math.radians(min(max(tilts), 90))) * ends[1] * row_spacing / 2
    sideways = np.ptp(positions[:, :2], axis=0).max() / 2
    rotated = turned == 0 and _rotated_together(cosines, positions, axes)
    if not rotated and (np.append(away, turned) / np.append(size, step)).max() > LARGEST_TILT:
        if sideways > (away.max() + turned) / 2:
            raise InputError(
                f"{name}: slices are shifted sideways against each other (gantry tilt); resample the series onto "
                "upright axial slices first"
            )
        raise InputError(
            f"{slices[0].path}: slices are tilted or not axial; resample the series onto upright axial slices first"
        )
    if (moved := max(away.max(), turned)) > max(POSITION_TOLERANCE_MM, 0.01 * step):
        what = "the volume is slightly rotated" if rotated else "slices are slightly tilted or unevenly placed"
        note(f"{name}: {what}; reading it as upright moves voxels by at most {moved:.2g} mm")
    if abs(row_spacing / column_spacing - 1) > SQUARE:
        note(f"{name}: PixelSpacing is {row_spacing:g} x {column_spacing:g} mm; CT pixels are square: is it right?")
    affine = np.eye(4)
    affine[:3, 0], affine[:3, 1] = axes[0] * column_spacing, axes[1] * row_spacing
    affine[:3, 2], affine[:3, 3] = (0, 0, step), positions[0] + shift
    return affine


def _directions(slices: Sequence[Slice], grid: Grid) -> tuple[tuple[float, ...], ...] | None:
    """Directions of the axes x, y and z by the slices' own geometry; None if the upright grid is the same."""
    cosines = np.mean([one.numbers("ImageOrientationPatient", 6) for one in slices], axis=0).reshape(2, 3)
    first, last = (np.array(one.numbers("ImagePositionPatient", 3)) for one in (slices[0], slices[-1]))
    axes = _axes(cosines.ravel())
    actual = np.column_stack([*cosines, last - first])
    nominal = np.column_stack([*axes, (0, 0, 1)])  # slices go from inferior to superior
    turn = LPS_TO_RAS[:3, :3] @ (actual / np.linalg.norm(actual, axis=0)) @ nominal.T @ LPS_TO_RAS[:3, :3]
    moved = np.abs(turn - np.eye(3)) @ np.array(grid.extent_mm[::-1]) / 2
    return tuple(map(tuple, turn.T.tolist())) if moved.max() > POSITION_TOLERANCE_MM else None


def _rotated_together(cosines: np.ndarray, positions: np.ndarray, axes: np.ndarray) -> bool:
    """Whether all slices lie above each other along their common normal, rotated as a whole by a small angle."""
    if np.ptp(cosines, axis=0).max() > ORTHOGONAL:
        return False
    normal = np.cross(*cosines[0])
    offsets = positions - positions[0]
    if np.abs(offsets - np.outer(offsets @ normal, normal)).max() > POSITION_TOLERANCE_MM:
        return False
    # The frame's axes in their order: what remains is the rotation.
    actual, upright_axes = (np.column_stack([*one, np.cross(*one)]) for one in (cosines[0], axes))
    return is_small_rotation(actual @ upright_axes.T)


def _slice_spacing(name: str, positions: np.ndarray) -> float:
    if len(positions) < 2:
        raise InputError(f"{name}: holds one slice only; give a series of at least two")
    z = positions[:, 2]
    steps = np.diff(z)
    usual = float(np.median(steps))
    index = np.arange(len(z))
    regular = np.polyval(np.polyfit(index, z - z[0], 1), index) + z[0]
    if np.abs(z - regular).max() > max(LARGEST_DISAGREEMENT * usual, POSITION_TOLERANCE_MM):
        wrong = int(np.abs(steps - usual).argmax())
        raise InputError(
            f"{name}: slices are {usual:g} mm apart, but those at z = {z[wrong]:g} and {z[wrong + 1]:g} mm "
            f"{steps[wrong]:g} mm: a slice is missing or spacing is uneven"
        )
    return float(steps.mean())
