"""Read one axial CT series from DICOM files, and reject ambiguous series.

Attributes as in DICOM PS3.3, C.7.6.2 (image plane) and C.8.2.1 (CT image). DICOM's patient frame is LPS: x and y have
the opposite sign of the NIfTI world frame of Virtual Phantom.
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
from ..base.names import counted
from ..io.volumes import LARGEST_TILT, LPS_TO_RAS, ORTHOGONAL, Volume, check_fits, is_small_rotation, upright
from .dicom_files import NEEDED, Slice, UnusedFiles, files_in, not_dicom, slices_of, walk_folders
from .dicom_pixels import check_pixels, read_into, same_pixels

POSITION_TOLERANCE_MM = 0.01  # headers often round positions to this
# Largest disagreement between slices, in voxels at the border of a slice or in slice spacings. A missing slice moves
# its neighbors by at least a third of the spacing from the best fitting line (3 slices), by more with more slices.
LARGEST_DISAGREEMENT = 0.1
SQUARE = 0.01  # relative difference of the sides of a pixel: CT has square pixels, up to rounding
LISTED = 4  # largest number of series or folders in a message


@dataclass(frozen=True)
class Series:
    """The slices of one series, and its name in messages: its folder, and its number if the folder has several."""

    name: str
    slices: tuple[Slice, ...]


def read_series(folder: str | Path) -> Volume:
    """Read the one CT series in a folder as HU (float32) on an upright grid; a note reports files that are not used.

    Raises
    ------
    InputError
        As `find_series` and `read_slices`.
    """
    return read_slices(find_series(folder))


def find_series(folder: str | Path) -> Series:
    """Find the one axial CT series in a folder; InputError if there is none or more than one."""
    folder, unused = Path(folder), UnusedFiles()
    slices = slices_of(files_in(folder), unused)
    if not slices:
        raise InputError(_nothing(folder, unused))
    found = series_among(slices, unused, folder)
    if len(found) > 1:
        raise InputError(
            f"{folder}: holds more than one DICOM series: {described(found)}; copy or link the files of one series "
            "into a new folder and give that"
        )
    inner = [path for path in walk_folders(folder, UnusedFiles()) if path != folder and files_in(path)]
    if inner:
        names = ", ".join(str(path.relative_to(folder)) for path in inner[:LISTED])
        more = f" and {len(inner) - LISTED} more" if len(inner) > LISTED else ""
        note(f"{folder}: folders in it are not read ({names}{more})")
    unused.report(folder)
    return found[0]


def _nothing(folder: Path, unused: UnusedFiles) -> str:
    """Return the message about a folder without CT slices, with its content and folders below that have DICOM files."""
    lines = unused.lines(folder)
    below = []
    for inner in itertools.islice(walk_folders(folder, UnusedFiles()), 1, 200):
        if any(not not_dicom(path) for path in files_in(inner)):
            below.append(str(inner))
    any_dicom = "CT slice in HU" if unused.headers else "DICOM file"
    content = f" ({'; '.join(lines)})" if lines else ""
    more = f" and {len(below) - LISTED} more" if len(below) > LISTED else ""
    if below:
        return f"{folder}: holds no {any_dicom}{content}; folders below have DICOM files, give one: " + (
            ", ".join(below[:LISTED]) + more
        )
    return f"{folder}: holds no {any_dicom}{content}; give a folder with one CT series"


def series_among(slices: Sequence[Slice], unused: UnusedFiles, top: Path) -> list[Series]:
    """Group slices of a folder or a tree by series, and exclude series that are not a stack of axial slices.

    Parameters
    ----------
    unused : UnusedFiles
        Excluded series are added.
    top : Path
        The folder, for messages.

    Returns
    -------
    list of Series
        Sorted by folder and series number. If none is a stack of axial slices, all are returned, and `read_slices`
        reports why they cannot be read.

    Raises
    ------
    InputError
        If an unused file continues a used series.
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
        for header in group:
            unused.add(header.path, f"another series ({_label(group)}), not a stack of axial slices")
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
    for stack in sorted(stacks, key=lambda group: (_folder(group), _series_number(group), group[0].path)):
        folder = _folder(stack)
        number = "" if several[folder] == 1 else f" ({_label(stack)}, {stack[0].path.name})"
        named.append(Series(f"{folder}{number}", tuple(stack)))
    return named


def _groups(slices: Sequence[Slice]) -> list[list[Slice]]:
    """Group slices by SeriesInstanceUID, and by folder if folders have slices of one UID at the same position."""
    # Exports may spread one series over folders. Anonymization may give one UID to all series.
    by_uid = defaultdict(lambda: defaultdict(list))
    for header in slices:
        uid = header.values.get("SeriesInstanceUID", ())
        by_uid[uid if isinstance(uid, tuple) else ()][header.path.parent].append(header)
    groups = []
    for folders in by_uid.values():
        sets = [{header.values.get("ImagePositionPatient") for header in group} for group in folders.values()]
        if sum(map(len, sets)) == len(set().union(*sets)):
            groups.append([header for group in folders.values() for header in group])
        else:
            groups += folders.values()
    return groups


def _folder(group: Sequence[Slice]) -> str:
    return os.path.commonpath([header.path.parent for header in group])


def _series_number(group: Sequence[Slice]) -> float:
    try:
        return group[0].number("SeriesNumber", math.inf)
    except InputError:
        return math.inf


def _label(group: Sequence[Slice]) -> str:
    """Describe a series without its SeriesDescription, which may name the patient."""
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
    """Describe series for messages: number, slices, kernel, thickness and the first file of each."""
    words = [f"{_label(found.slices)} ({found.slices[0].path.name})" for found in series[:LISTED]]
    more = [f"{len(series) - LISTED} more"] if len(series) > LISTED else []
    return "; ".join(words + more)


def _frame(header: Slice) -> tuple[np.ndarray, ...] | None:
    """Return position, direction cosines, spacing and size; None if an attribute is missing or wrong."""
    try:
        return tuple(
            np.array(header.numbers(keyword, count)) for keyword, count in zip(NEEDED, (3, 6, 2, 1, 1), strict=True)
        )
    except InputError:
        return None


def _is_stack(group: Sequence[Slice]) -> bool:
    """Return whether slices are axial, at two or more positions."""
    frames = [frame for header in group if (frame := _frame(header)) is not None]
    axial = [frame for frame in frames if _axes(frame[1]) is not None]
    return len({float(frame[0][2]) for frame in axial}) > 1


def _continues(header: Slice, stack: Sequence[Slice]) -> bool:
    """Return whether a slice has the size, in-plane position and orientation of a stack.

    If these attributes of the slice are missing or invalid, return whether it has pixels.
    """
    frame = _frame(header)
    expected = next((found for other in stack if (found := _frame(other)) is not None), None)
    if expected is None:
        return False
    if frame is None:  # a slice with a damaged header; an RTSTRUCT or a report has no pixels
        return header.has("Rows")
    pairs = zip((frame[0][:2], *frame[1:]), (expected[0][:2], *expected[1:]), strict=True)
    return all(np.allclose(a, b, atol=1e-2) for a, b in pairs)


def _axes(cosines: np.ndarray) -> np.ndarray | None:
    """Round the directions of rows and columns to the axes of the patient, shape (2, 3); None if not axial."""
    axes = cosines.round().reshape(2, 3)
    along = np.abs(axes[:, :2])
    return (
        axes
        if np.array_equal(along, np.eye(2)) or np.array_equal(along, np.eye(2)[::-1]) and not axes[:, 2].any()
        else None
    )


def read_slices(series: Series, one_slice: bool = False) -> Volume:
    """Read the slices of one series as HU (float32) on an upright grid.

    Parameters
    ----------
    one_slice : bool, optional
        Whether a series may have a single slice; its thickness is then the spacing along z.

    Raises
    ------
    InputError
        If an attribute is missing, wrong or differs between slices, slices are tilted, a slice is missing, two slices
        have the same position, or pixels are not in HU.
    """
    slices = list(series.slices)
    _check_geometry(slices)
    check_pixels(slices, series.name)
    slices = _without_copies(series.name, slices)
    affine = _affine(series.name, slices, one_slice)
    rows, columns = slices[0].integer("Rows"), slices[0].integer("Columns")
    check_fits(4 * len(slices) * rows * columns, series.name)
    array = np.empty((len(slices), rows, columns), np.float32)
    read_into(slices, array, series.name)
    volume = upright(array.T, LPS_TO_RAS @ affine, series.name)
    return Volume(volume.array, replace(volume.grid, directions=_directions(slices, volume.grid)))


def _check_geometry(slices: Sequence[Slice]) -> None:
    """Check that all slices have the attributes of an image plane, with the same size, spacing and orientation."""
    first = slices[0]
    frames = {id(header): header.text("FrameOfReferenceUID") for header in slices if header.has("FrameOfReferenceUID")}
    if len(set(frames.values())) > 1:
        odd = next(header for header in slices if frames.get(id(header), "") not in ("", next(iter(frames.values()))))
        raise InputError(f"{odd.path}: FrameOfReferenceUID differs from the other slices'; give one uniform series")
    for header in slices:
        for keyword in NEEDED:
            if not header.has(keyword):
                raise InputError(
                    f"{header.path}: has no {keyword}; give plain CT slices (multi-frame CT: convert it to NIfTI)"
                )
        size = header.integer("Rows"), header.integer("Columns")
        if min(size) < 1:
            raise InputError(f"{header.path}: Rows and Columns are {size[0]} and {size[1]}; is the file complete?")
        spacing = np.array(header.numbers("PixelSpacing", 2))
        if spacing.min() <= 0:
            raise InputError(f"{header.path}: PixelSpacing{header.quoted('PixelSpacing')} is not positive; correct it")
        expected = np.array(first.numbers("PixelSpacing", 2))
        shift = np.abs(spacing - expected) / expected * max(size) / 2
        if size != (first.integer("Rows"), first.integer("Columns")) or shift.max() > LARGEST_DISAGREEMENT:
            raise InputError(
                f"{header.path}: slice size or pixel spacing differs from the others'; give one uniform series"
            )
        header.numbers("ImagePositionPatient", 3)
        axes = _axes(np.array(header.numbers("ImageOrientationPatient", 6)))
        if axes is None:
            raise InputError(
                f"{header.path}: slices are tilted or not axial; resample the series onto upright axial slices first"
            )
        if not np.array_equal(axes, _axes(np.array(first.numbers("ImageOrientationPatient", 6)))):
            raise InputError(f"{header.path}: orientation differs from the other slices'; give one uniform series")


def _without_copies(name: str, slices: Sequence[Slice]) -> list[Slice]:
    """Sort slices from inferior to superior, and remove copies with the same position and pixels."""
    ordered = sorted(slices, key=lambda header: header.numbers("ImagePositionPatient", 3)[2])
    kept, copies = ordered[:1], []
    for header in ordered[1:]:
        low, high = (item.numbers("ImagePositionPatient", 3)[2] for item in (kept[-1], header))
        if high - low > POSITION_TOLERANCE_MM:
            kept.append(header)
        elif same_pixels(kept[-1], header):
            copies.append(header.path)
        else:
            numbers = {item.text("AcquisitionNumber") for item in (kept[-1], header)}
            why = (
                f" (AcquisitionNumber {' and '.join(sorted(numbers))})"
                if len(numbers) > 1 and "" not in numbers
                else ""
            )
            raise InputError(
                f"{name}: two slices at z = {low:g} mm, {kept[-1].path.name} and {header.path.name}{why}; give one "
                "series with one slice per position"
            )
    if copies:
        count = f"{len(copies)} files, the first of them {copies[0].name}" if len(copies) > 1 else copies[0].name
        note(f"{name}: not used: {count}: a copy of another slice")
    return kept


def _affine(name: str, slices: Sequence[Slice], one_slice: bool) -> np.ndarray:
    """Return the upright affine from voxel (column, row, slice) to mm in LPS; InputError if slices are tilted."""
    positions = np.array([header.numbers("ImagePositionPatient", 3) for header in slices])
    alone = one_slice and len(slices) == 1
    step = slices[0].number("SliceThickness") if alone else _slice_spacing(name, positions, one_slice)
    cosines = np.array([header.numbers("ImageOrientationPatient", 6) for header in slices]).reshape(-1, 2, 3)
    spacings = np.array([header.numbers("PixelSpacing", 2) for header in slices])
    axes, (row_spacing, column_spacing) = _axes(cosines[0].ravel()), spacings[0]
    ends = np.array([slices[0].integer("Columns") - 1, slices[0].integer("Rows") - 1])
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) * ends
    actual = np.einsum("sa,ca,sav->scv", spacings[:, ::-1], corners, cosines) + positions[:, None]
    nominal = (corners * (column_spacing, row_spacing)) @ axes
    nominal = positions[0] + nominal + np.arange(len(slices))[:, None, None] * [0, 0, step]
    difference = (actual - nominal).reshape(-1, 3)
    shift = (difference.max(axis=0) + difference.min(axis=0)) / 2
    shift[np.abs(shift) <= POSITION_TOLERANCE_MM] = 0
    away = np.abs(difference - shift).max(axis=0)
    size = np.abs(axes.T @ [column_spacing, row_spacing]) + [0, 0, step]
    # A gantry tilt that is not in the orientation moves voxels along z, most at the border of the slices.
    tilts = [abs(header.number("GantryDetectorTilt", 0.0)) for header in slices]
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
    """Return the directions of x, y and z by the geometry of the slices; None if the upright grid has the same."""
    cosines = np.mean([header.numbers("ImageOrientationPatient", 6) for header in slices], axis=0).reshape(2, 3)
    first, last = (np.array(header.numbers("ImagePositionPatient", 3)) for header in (slices[0], slices[-1]))
    if len(slices) == 1:
        return None
    axes = _axes(cosines.ravel())
    actual = np.column_stack([*cosines, last - first])
    nominal = np.column_stack([*axes, (0, 0, 1)])  # slices go from inferior to superior
    turn = LPS_TO_RAS[:3, :3] @ (actual / np.linalg.norm(actual, axis=0)) @ nominal.T @ LPS_TO_RAS[:3, :3]
    moved = np.abs(turn - np.eye(3)) @ np.array(grid.extent_mm[::-1]) / 2
    return tuple(map(tuple, turn.T.tolist())) if moved.max() > POSITION_TOLERANCE_MM else None


def _rotated_together(cosines: np.ndarray, positions: np.ndarray, axes: np.ndarray) -> bool:
    """Return whether all slices are aligned along their common normal, rotated as a whole by a small angle."""
    if np.ptp(cosines, axis=0).max() > ORTHOGONAL:
        return False
    normal = np.cross(*cosines[0])
    offsets = positions - positions[0]
    if np.abs(offsets - np.outer(offsets @ normal, normal)).max() > POSITION_TOLERANCE_MM:
        return False
    # With the axes of the frame in the same order, the difference is a rotation.
    actual, upright_axes = (np.column_stack([*pair, np.cross(*pair)]) for pair in (cosines[0], axes))
    return is_small_rotation(actual @ upright_axes.T)


def _slice_spacing(name: str, positions: np.ndarray, one_slice: bool) -> float:
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
            + ("; import single slices one by one, from a folder for each" if one_slice else "")
        )
    return float(steps.mean())
