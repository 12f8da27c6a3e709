"""DICOM RT Structure Sets (PS3.3, A.19): planar contours, filled slice by slice.

How contours of one slice make a region (PS3.3, C.8.8.6):

* CLOSED_PLANAR, and INTERPOLATED_PLANAR, which some systems write for contours that they interpolated: a contour within
  another one is a hole, one within the hole is part of the region again, and so on. Contours that overlap in part are
  united. The standard knows only the keyhole, but treatment planning systems export nested contours in this way.
* CLOSEDPLANAR_XOR: contours are combined by exclusive or, as the standard says.
* The same contour stored again, in either direction, counts once.
* A voxel belongs to a contour if its center lies within or on it. Contours cross themselves by the even-odd rule, so
  that a keyhole stays open.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pydicom
from skimage.measure import points_in_poly

from ..base.errors import InputError, meant, reading
from ..base.geometry import Grid
from ..base.words import counted
from .regions import Drawn, Regions, Remark, boxed, sequence_of, to_voxels, whole_number

XOR = "CLOSEDPLANAR_XOR"
CLOSED = ("CLOSED_PLANAR", "INTERPOLATED_PLANAR", XOR)
OPEN = ("POINT", "OPEN_PLANAR", "OPEN_NONPLANAR")
POINTS = 3  # a closed contour has at least
PLANAR = 0.1  # of a slice; contours that span more along z are not planar
IN_SLICE = 0.25  # of the distance of slices: a contour is nearer to one slice than to the middle between two
SAME_PLANE = 0.1  # of the distance of slices: contours nearer than this along z belong together, and to the slice
# Outlines that are nowhere farther apart than half a voxel are one: a wall between them would be no voxel wide.
SAME = 0.5
# Coordinates within this length of a voxel center are on it: headers often give them as text with two decimals.
ON_CENTER_MM = 0.01
ROUNDING = 1e-9  # voxels, of a crossing worked out in double precision
ADVICE = "is this the CT on which it was drawn?"


@dataclass
class Structure:
    """One ROI of a structure set.

    Attributes
    ----------
    problem : str
        Why its contours cannot be assigned; empty if they can.
    """

    number: int | None
    name: str
    contours: list[pydicom.Dataset] = field(default_factory=list)
    problem: str = ""

    @property
    def title(self) -> str:
        """Name and, where there is no name, number, for messages."""
        return f"ROI {self.name}" if self.name else f"ROI number {self.number}"


@dataclass(frozen=True)
class Contour:
    """A closed contour in voxels of the CT.

    Attributes
    ----------
    points : ndarray, shape (points, 2)
        Row and column.
    z : float
        Slice.
    xor : bool
        Combined by exclusive or.
    """

    points: np.ndarray
    z: float
    xor: bool

    @property
    def area(self) -> float:
        """Enclosed area, in voxels."""
        row, column = self.points.T
        return abs(float(row @ np.roll(column, -1) - column @ np.roll(row, -1))) / 2


class StructRegions(Regions):
    """ROIs of a structure set, each by its name or, where several have one name, by its number."""

    def __init__(self, path: Path, dataset: pydicom.Dataset, grid: Grid):
        super().__init__(path, grid)
        self._remarks: list[Remark] = []
        with reading(path, "DICOM RTSTRUCT"):  # pydicom parses items when they are read
            self._rois = self._structures(dataset)

    def _structures(self, dataset: pydicom.Dataset) -> list[Structure]:
        listed = sequence_of(self.path, dataset, "StructureSetROISequence")
        found = []
        for position, item in enumerate(listed, 1):
            name, number = _name(item, dataset), whole_number(item, "ROINumber")
            problem = "" if number is not None else f"item {position} of StructureSetROISequence has no valid ROINumber"
            found.append(Structure(number, name, problem=problem))
        drawn: dict[int, list[pydicom.Dataset]] = {}
        items = Counter()
        for position, item in enumerate(sequence_of(self.path, dataset, "ROIContourSequence"), 1):
            number = whole_number(item, "ReferencedROINumber")
            contours = item.get("ContourSequence")
            contours = list(contours) if isinstance(contours, pydicom.Sequence) else []
            if number is None:
                text = f"item {position} of ROIContourSequence has no valid ReferencedROINumber"
                self._remarks.append(
                    Remark(text, "", f"{text}; its {counted(len(contours), 'contour')} cannot be assigned to an ROI")
                )
                continue
            drawn.setdefault(number, []).extend(contours)
            items[number] += 1
        numbers = Counter(roi.number for roi in found if roi.number is not None)
        for roi in found:
            if roi.number is None:
                continue
            if numbers[roi.number] > 1:
                names = ", ".join(other.name or "(no name)" for other in found if other.number == roi.number)
                roi.problem = f"ROI number {roi.number} is given to several ROIs ({names})"
            roi.contours = drawn.get(roi.number, [])
            if items[roi.number] > 1:
                text = f"{items[roi.number]} items of ROIContourSequence refer to it; their contours are put together"
                self._remarks.append(Remark("several items of contours", roi.title, text))
        for number in drawn.keys() - numbers.keys():
            orphan = Structure(number, "", drawn[number])
            text = "is not in StructureSetROISequence, so it has no name"
            self._remarks.append(Remark("not in StructureSetROISequence", orphan.title, text))
            found.append(orphan)
        return found

    def there(self) -> dict[int | str, str | None]:
        """Every region: {ROI name, or where it is missing or not the only one, number: name}."""
        names = Counter(roi.name for roi in self._rois)
        labels: dict[int | str, str | None] = {}
        for roi in self._rois:
            named = roi.name and names[roi.name] == 1
            if not named and roi.number is None:
                continue
            # The configuration takes whole numbers from 1 on, and others as text.
            number = roi.number if roi.number is not None and roi.number > 0 else str(roi.number)
            labels[roi.name if named else number] = roi.name or f"roi {roi.number}"
        return labels

    def aliases(self, label: int | str) -> tuple[str, ...]:
        """The number of an ROI."""
        return (str(self._find(label).number),)

    def _find(self, label: int | str | None) -> Structure:
        if label is None and len(self._rois) == 1:
            return self._rois[0]
        by_name = [roi for roi in self._rois if label is not None and roi.name and roi.name == str(label).strip()]
        by_number = [roi for roi in self._rois if label is not None and str(roi.number) == str(label)]
        first, second = (by_number, by_name) if isinstance(label, int) else (by_name, by_number)
        matching = first or second
        if len(matching) == 1:
            return matching[0]
        there = ", ".join(f"{roi.name or '(no name)'} ({roi.number})" for roi in self._rois) or "none"
        if label is None:
            raise InputError(f"{self.path}: label is needed; there are: {there}")
        if matching:
            numbers = " and ".join(str(roi.number) for roi in matching)
            what = f"{len(matching)} ROIs are called {label!r}; give the number as the label: {numbers}"
            raise InputError(f"{self.path}: {what}; there are: {there}")
        names = [roi.name for roi in self._rois if roi.name]
        near = meant(str(label), names, "there are")
        advice = near if near.startswith("did") else f"there are: {there}"
        raise InputError(f"{self.path}: ROI {label!r} is not there; {advice}")

    def _draw(self, label: int | str | None) -> tuple[str, Drawn | None, bool]:
        roi = self._find(label)
        if roi.problem:
            raise InputError(f"{self.path}: {roi.problem}, so its contours cannot be assigned; export it again")
        remarks = [one for one in self._remarks if one.name in ("", roi.title)]
        with reading(self.path, "DICOM RTSTRUCT"):
            slices = self._slices(roi, self._contours(roi, remarks), remarks)
        if not slices:
            if roi.contours:  # the remarks say why; a region without voxels is passed over and they with it
                why = "; ".join(one.text for one in remarks if one.name) or "they enclose no area"
                raise InputError(f"{self.path}: {roi.title} has no closed contour that can be filled ({why})")
            return roi.title, None, True
        return roi.title, self._filled(roi, slices, remarks), True

    def _filled(self, roi: Structure, slices: dict[int, list[Contour]], remarks: list[Remark]) -> Drawn | None:
        low, high = min(slices), max(slices)
        corners = [one.points for contours in slices.values() for one in contours]
        first = np.maximum(np.ceil(np.min([p.min(axis=0) for p in corners], axis=0)), 0).astype(int)
        last = np.minimum(np.floor(np.max([p.max(axis=0) for p in corners], axis=0)) + 1, self.grid.shape[1:]).astype(
            int
        )
        if (last <= first).any():
            raise InputError(f"{self.path}: {roi.title} encloses no voxel center; draw it larger, or take a finer CT")
        mask = np.zeros((high - low + 1, *(last - first)), bool)
        again = overlaps = 0
        for k, contours in slices.items():
            same, crossing = _combine(contours, mask[k - low], first)
            again, overlaps = again + same, overlaps + crossing
        if again:
            stored = f"{counted(again, 'contour')} of it {'is' if again == 1 else 'are'} stored more than once"
            text = f"{stored}; each counts once"
            remarks.append(Remark("contours stored more than once", roi.title, text))
        if overlaps:
            verb = "overlaps" if overlaps == 1 else "overlap"
            text = f"{counted(overlaps, 'contour')} of it {verb} another one in part; they are united"
            remarks.append(Remark("contours that overlap in part", roi.title, text))
        if not mask.any():
            raise InputError(f"{self.path}: {roi.title} encloses no voxel center; draw it larger, or take a finer CT")
        return boxed(mask, (low, *first), remarks)

    def _contours(self, roi: Structure, remarks: list[Remark]) -> list[Contour]:
        """Closed contours in voxels; what is passed over goes to `remarks`."""
        found, passed = [], Counter()
        affines = to_voxels(self.grid)
        for position, item in enumerate(roi.contours, 1):
            kind = str(item.get("ContourGeometricType") or "").strip().upper()
            points = self._points(roi, position, item)
            if kind in OPEN:
                passed[f"of type {kind}, which encloses no area,"] += 1
            elif kind and kind not in CLOSED:
                passed[f"of the unknown type {kind if len(kind) <= 16 and kind.isascii() else '?'}"] += 1
            elif len(points) == 0:
                passed["without points"] += 1
            elif len(points) < POINTS:
                passed[f"of fewer than {POINTS} points, which encloses no area,"] += 1
            else:
                if not kind:
                    passed[""] += 1
                placed = [(one @ np.column_stack([points, np.ones(len(points))]).T)[:3] for one in affines]
                x, y, z = next((one for one in placed if np.ptp(one[2]) <= PLANAR), placed[0])
                if np.ptp(z) > PLANAR:
                    raise InputError(
                        f"{self.path}: contour {position} of {roi.title} spans {np.ptp(z) * self.grid.spacing[0]:.3g} "
                        "mm along z; contours in axial planes are read"
                    )
                found.append(Contour(_on_centers(np.column_stack([y, x]), self.grid), float(z.mean()), kind == XOR))
        for what, count in passed.items():
            contours = counted(count, "contour")
            if what:
                text = f"{contours} {what} {'is' if count == 1 else 'are'} passed over"
            else:
                text = f"{contours} without ContourGeometricType {'is' if count == 1 else 'are'} read as CLOSED_PLANAR"
            remarks.append(Remark(f"contours {what or 'without ContourGeometricType'}", roi.title, text))
        return found

    def _points(self, roi: Structure, position: int, item: pydicom.Dataset) -> np.ndarray:
        """Points of a contour, LPS, mm; shape (points, 3)."""
        try:
            values = item.get("ContourData")
            numbers = np.array([] if values is None else values, float).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.array([np.nan])
        stated = whole_number(item, "NumberOfContourPoints")
        what = f"{self.path}: contour {position} of {roi.title}"
        if not np.isfinite(numbers).all() or len(numbers) % 3:
            raise InputError(f"{what} has no valid ContourData (x, y, z of each point); export it again")
        if stated is not None and 3 * stated != len(numbers):
            raise InputError(
                f"{what} has {len(numbers) // 3} points in ContourData and {stated} by NumberOfContourPoints; "
                "export it again"
            )
        return numbers.reshape(-1, 3)

    def _slices(self, roi: Structure, contours: Sequence[Contour], remarks: list[Remark]) -> dict[int, list[Contour]]:
        """Contours of each slice; what lies between slices goes to `remarks`."""
        wide = self.grid.spacing[0]
        near: dict[int, list[Contour]] = {}
        between: list[Contour] = []
        for one in contours:
            k = round(one.z)
            self._check_inside(roi, one, k)
            if abs(one.z - k) > IN_SLICE:
                between.append(one)
            else:
                near.setdefault(k, []).append(one)
        passed = 0
        for one in between:
            if not {int(np.floor(one.z)), int(np.ceil(one.z))} <= near.keys():
                raise InputError(
                    f"{self.path}: a contour of {roi.title} at z = {self._z_mm(one):g} mm does not lie in a slice of "
                    f"the CT; {ADVICE}"
                )
            passed += 1
        slices, farthest = {}, 0.0
        for k, there in near.items():
            plane = min((one.z for one in there), key=lambda z: abs(z - k))
            slices[k] = [one for one in there if abs(one.z - plane) <= SAME_PLANE]
            passed += len(there) - len(slices[k])
            farthest = max(farthest, *(abs(one.z - k) for one in slices[k]))
        if passed:
            text = (
                f"{counted(passed, 'contour')} between slices of the CT {'is' if passed == 1 else 'are'} passed over, "
            )
            remarks.append(Remark("contours between slices", roi.title, text + "as the slices beside have their own"))
        if farthest > SAME_PLANE:
            text = (
                f"its contours lie up to {farthest * wide:.3g} mm from the CT's slices; each is put in the nearest one"
            )
            remarks.append(Remark("contours beside slices", roi.title, text))
        return slices

    def _check_inside(self, roi: Structure, contour: Contour, k: int) -> None:
        if not 0 <= k < self.grid.shape[0]:
            raise InputError(
                f"{self.path}: a contour of {roi.title} at z = {self._z_mm(contour):g} mm does not lie in a slice of "
                f"the CT; {ADVICE}"
            )
        edges = np.array(self.grid.shape[1:]) - 0.5
        if contour.points.min() < -0.5 or (contour.points > edges).any():
            raise InputError(
                f"{self.path}: a contour of {roi.title} at z = {self._z_mm(contour):g} mm leaves the CT; {ADVICE}"
            )

    def _z_mm(self, contour: Contour) -> float:
        return round(float(self.grid.affine[2, 3] + contour.z * self.grid.spacing[0]), 3)


def _on_centers(points: np.ndarray, grid: Grid) -> np.ndarray:
    """Points (row, column) with coordinates that are on a voxel center but for rounding moved onto it."""
    centers = points.round()
    return np.where(np.abs(points - centers) * np.array(grid.spacing[1:]) <= ON_CENTER_MM, centers, points)


def _name(item: pydicom.Dataset, dataset: pydicom.Dataset) -> str:
    """Name of an ROI; UTF-8 is recognized where the file states no character set."""
    name = str(item.get("ROIName") or "").strip()
    if not dataset.get("SpecificCharacterSet"):
        try:
            return name.encode("latin-1").decode("utf-8")
        except UnicodeError:
            pass
    return name


def _combine(contours: Sequence[Contour], plane: np.ndarray, first: np.ndarray) -> tuple[int, int]:
    """Fill the contours of one slice.

    Parameters
    ----------
    plane : ndarray of bool, shape (y, x)
        Part of the slice, empty; it is changed.
    first : ndarray
        Row and column of the slice that the plane begins at.

    Returns
    -------
    again : int
        Contours that are stored more than once.
    overlaps : int
        Contours that overlap another one in part.
    """
    distinct: list[Contour] = []
    for one in contours:
        if not any(_same(one, other) for other in distinct):
            distinct.append(one)
    distinct.sort(key=lambda one: -one.area)
    depths: list[int] = []
    overlaps = 0
    for n, one in enumerate(distinct):
        around = [m for m in range(n) if _within(one, distinct[m])]
        depths.append(1 + max((depths[m] for m in around), default=-1))
        hole = depths[-1] % 2 == 1
        box, inside, on = _rasterized(one.points - first, plane.shape)
        part = plane[box]
        if one.xor:
            part ^= inside if hole else inside | on
        elif hole:  # the outline of a hole belongs to the region, as that of the region does
            part &= ~inside
        else:
            overlaps += bool((part & inside).any())
            part |= inside | on
    return len(contours) - len(distinct), overlaps


def _rasterized(points: np.ndarray, shape: tuple[int, int]) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
    """A box of a plane, and the voxels in it whose centers lie within a contour and on it.

    A center is within if an odd number of edges cross its row to the left of it. This takes a time in proportion to the
    length of the outline, where skimage.measure.grid_points_in_poly compares each voxel with each edge: 0.2 s for each
    slice of a body.

    Returns
    -------
    box : tuple of 2 slice
    """
    low = np.clip(np.ceil(points.min(axis=0)), 0, shape).astype(int)
    high = np.clip(np.floor(points.max(axis=0)) + 1, low, shape).astype(int)
    box = (slice(low[0], high[0]), slice(low[1], high[1]))
    rows, columns = high - low
    on = np.zeros((rows, columns), bool)
    if not on.size:
        return box, on, on
    start = points - low
    end = np.roll(start, -1, axis=0)
    upper, lower = np.minimum(start[:, 0], end[:, 0]), np.maximum(start[:, 0], end[:, 0])
    first, last = np.ceil(upper).astype(int), np.floor(lower).astype(int)
    count = np.where(lower > upper, np.maximum(last - first + 1, 0), 0)
    edge = np.repeat(np.arange(len(start)), count)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + first[edge]
    seen = (row >= 0) & (row < rows)
    edge, row = edge[seen], row[seen]
    slope = (end[edge, 1] - start[edge, 1]) / (end[edge, 0] - start[edge, 0])
    crossing = start[edge, 1] + (row - start[edge, 0]) * slope
    # An edge crosses the row of its upper end and not that of its lower end, so that a vertex is crossed once.
    crossed = row < lower[edge]
    flips = np.zeros((rows, columns + 1), np.uint8)
    np.add.at(flips, (row[crossed], np.clip(np.ceil(crossing[crossed]), 0, columns).astype(int)), 1)
    nearest = crossing.round()
    touched = (np.abs(crossing - nearest) < ROUNDING) & (nearest >= 0) & (nearest < columns)
    on[row[touched], nearest[touched].astype(int)] = True
    for n in np.flatnonzero((lower == upper) & (first == last) & (first >= 0) & (first < rows)):
        left, right = sorted((start[n, 1], end[n, 1]))
        on[first[n], max(int(np.ceil(left)), 0) : max(int(np.floor(right)) + 1, 0)] = True
    within = np.cumsum(flips, axis=1, dtype=np.uint8)[:, :columns] % 2 == 1
    return box, within & ~on, on


def _same(one: Contour, other: Contour) -> bool:
    """Whether two outlines are nowhere farther apart than SAME."""
    for reach in (np.min, np.max):
        if np.abs(reach(one.points, axis=0) - reach(other.points, axis=0)).max() > SAME:
            return False
    return bool(_distance(one.points, other.points).max() <= SAME and _distance(other.points, one.points).max() <= SAME)


def _within(one: Contour, other: Contour) -> bool:
    """Whether a contour lies within another one, up to SAME beyond its outline."""
    slack = SAME
    if (one.points.min(axis=0) < other.points.min(axis=0) - slack).any():
        return False
    if (one.points.max(axis=0) > other.points.max(axis=0) + slack).any():
        return False
    edge = _refined(one.points)
    inside = points_in_poly(edge, other.points)
    if not inside.any():
        return False
    return bool(inside.all() or _distance(edge[~inside], other.points).max() <= slack)


def _refined(points: np.ndarray) -> np.ndarray:
    """The outline at steps of SAME at most, and a point within each step."""
    following = np.roll(points, -1, axis=0)
    steps = np.maximum(np.ceil(np.linalg.norm(following - points, axis=1) / SAME).astype(int), 1)
    start = np.repeat(points, steps, axis=0)
    share = np.concatenate([np.arange(n) / n for n in steps])[:, None]
    return start + share * (np.repeat(following, steps, axis=0) - start)


def _distance(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Distance of each point to a closed outline."""
    start, step = outline, np.roll(outline, -1, axis=0) - outline
    length = np.maximum((step**2).sum(axis=1), 1e-30)
    nearest = np.full(len(points), np.inf)
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) // 256)):
        away = points[chunk][:, None] - start
        share = np.clip((away * step).sum(axis=2) / length, 0, 1)
        nearest[chunk] = np.linalg.norm(away - share[..., None] * step, axis=2).min(axis=1)
    return nearest
