"""Read regions from DICOM RT Structure Sets (PS3.3, A.19): planar contours are filled slice by slice.

Contours of one slice are combined as follows (PS3.3, C.8.8.6):

* CLOSED_PLANAR, and INTERPOLATED_PLANAR of some systems: a contour within another contour is a hole, a contour within
  the hole belongs to the region, and so on. Contours that overlap partly are united. The standard only defines
  keyholes, but treatment planning systems export nested contours in this way.
* CLOSEDPLANAR_XOR: contours are combined by exclusive or.
* Repeated contours, in either direction, count once.
* A voxel belongs to a contour if its center lies within or on it. The even-odd rule applies to contours that cross
  themselves, so keyholes stay open.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pydicom
from skimage.measure import points_in_poly

from ..base.errors import InputError, did_you_mean, reading
from ..base.geometry import Grid
from ..base.names import counted
from .regions import CroppedRegion, Regions, Remark, crop_to_box, sequence_of, to_voxels, whole_number

XOR = "CLOSEDPLANAR_XOR"
CLOSED = ("CLOSED_PLANAR", "INTERPOLATED_PLANAR", XOR)
OPEN = ("POINT", "OPEN_PLANAR", "OPEN_NONPLANAR")
POINTS = 3  # least number of points of a closed contour
PLANAR = 0.1  # of the slice spacing: contours that extend more along z are not planar
IN_SLICE = 0.25  # of the slice spacing: contours within this distance belong to a slice
SAME_PLANE = 0.1  # of the slice spacing: contours within this distance are in one plane
# Voxels: outlines within this distance everywhere are the same contour.
SAME = 0.5
# Coordinates this close to a voxel center are on it: headers often store two decimals.
ON_CENTER_MM = 0.01
ROUNDING = 1e-9  # voxels, of crossings in double precision
ADVICE = "is this the CT on which it was drawn?"


@dataclass
class Structure:
    """An ROI of a structure set; `problem` tells why its contours cannot be assigned, and is empty if they can."""

    number: int | None
    name: str
    contours: list[pydicom.Dataset] = field(default_factory=list)
    problem: str = ""

    @property
    def title(self) -> str:
        """Name for messages, or number if there is no name."""
        return f"ROI {self.name}" if self.name else f"ROI number {self.number}"


@dataclass(frozen=True)
class Contour:
    """A closed contour: points (row, column) and slice z in voxels of the CT, and whether it is combined by XOR."""

    points: np.ndarray
    z: float
    xor: bool

    @property
    def area(self) -> float:
        """Enclosed area in voxels."""
        row, column = self.points.T
        return abs(float(row @ np.roll(column, -1) - column @ np.roll(row, -1))) / 2


class StructRegions(Regions):
    """ROIs of a structure set, by name, or by number if several have the same name."""

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
                text = f"{items[roi.number]} items of ROIContourSequence refer to it; their contours are merged"
                self._remarks.append(Remark("several items of contours", roi.title, text))
        for number in drawn.keys() - numbers.keys():
            orphan = Structure(number, "", drawn[number])
            text = "is not in StructureSetROISequence, so it has no name"
            self._remarks.append(Remark("not in StructureSetROISequence", orphan.title, text))
            found.append(orphan)
        return found

    def list_regions(self) -> dict[int | str, str | None]:
        """Return {ROI name, or number if the name is missing or not unique: name}."""
        names = Counter(roi.name for roi in self._rois)
        labels: dict[int | str, str | None] = {}
        for roi in self._rois:
            named = roi.name and names[roi.name] == 1
            if not named and roi.number is None:
                continue
            # The configuration accepts integers from 1 on; other numbers are text.
            number = roi.number if roi.number is not None and roi.number > 0 else str(roi.number)
            labels[roi.name if named else number] = roi.name or f"roi {roi.number}"
        return labels

    def aliases(self, label: int | str) -> tuple[str, ...]:
        """Return the number of an ROI."""
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
        listed = ", ".join(f"{roi.name or '(no name)'} ({roi.number})" for roi in self._rois) or "none"
        if label is None:
            raise InputError(f"{self.path}: label is needed; there are: {listed}")
        if matching:
            numbers = " and ".join(str(roi.number) for roi in matching)
            what = f"{len(matching)} ROIs are called {label!r}; give the number as the label: {numbers}"
            raise InputError(f"{self.path}: {what}; there are: {listed}")
        names = [roi.name for roi in self._rois if roi.name]
        suggestion = did_you_mean(str(label), names, "there are")
        advice = suggestion if suggestion.startswith("did") else f"there are: {listed}"
        raise InputError(f"{self.path}: ROI {label!r} is not there; {advice}")

    def _draw(self, label: int | str | None) -> tuple[str, CroppedRegion | None, bool]:
        roi = self._find(label)
        if roi.problem:
            raise InputError(f"{self.path}: {roi.problem}, so its contours cannot be assigned; export it again")
        remarks = [remark for remark in self._remarks if remark.name in ("", roi.title)]
        with reading(self.path, "DICOM RTSTRUCT"):
            slices = self._slices(roi, self._contours(roi, remarks), remarks)
        if not slices:
            if roi.contours:  # the remarks explain why; they are not reported for a region without voxels
                why = "; ".join(remark.text for remark in remarks if remark.name) or "they enclose no area"
                raise InputError(f"{self.path}: {roi.title} has no closed contour that can be filled ({why})")
            return roi.title, None, True
        return roi.title, self._filled(roi, slices, remarks), True

    def _filled(self, roi: Structure, slices: dict[int, list[Contour]], remarks: list[Remark]) -> CroppedRegion | None:
        low, high = min(slices), max(slices)
        corners = [contour.points for contours in slices.values() for contour in contours]
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
            text = f"{counted(overlaps, 'contour')} of it {verb} another contour partly; they are united"
            remarks.append(Remark("contours that overlap partly", roi.title, text))
        if not mask.any():
            raise InputError(f"{self.path}: {roi.title} encloses no voxel center; draw it larger, or take a finer CT")
        return crop_to_box(mask, (low, *first), remarks)

    def _contours(self, roi: Structure, remarks: list[Remark]) -> list[Contour]:
        """Return the closed contours in voxels; add a remark about skipped contours."""
        found, skipped = [], Counter()
        affines = to_voxels(self.grid)
        for position, item in enumerate(roi.contours, 1):
            kind = str(item.get("ContourGeometricType") or "").strip().upper()
            points = self._points(roi, position, item)
            if kind in OPEN:
                skipped[f"of type {kind}, which encloses no area,"] += 1
            elif kind and kind not in CLOSED:
                skipped[f"of the unknown type {kind if len(kind) <= 16 and kind.isascii() else '?'}"] += 1
            elif len(points) == 0:
                skipped["without points"] += 1
            elif len(points) < POINTS:
                skipped[f"of fewer than {POINTS} points, which encloses no area,"] += 1
            else:
                if not kind:
                    skipped[""] += 1
                positions = [(affine @ np.column_stack([points, np.ones(len(points))]).T)[:3] for affine in affines]
                x, y, z = next((xyz for xyz in positions if np.ptp(xyz[2]) <= PLANAR), positions[0])
                if np.ptp(z) > PLANAR:
                    raise InputError(
                        f"{self.path}: contour {position} of {roi.title} spans {np.ptp(z) * self.grid.spacing[0]:.3g} "
                        "mm along z; only contours in axial planes are supported"
                    )
                found.append(Contour(_on_centers(np.column_stack([y, x]), self.grid), float(z.mean()), kind == XOR))
        for what, count in skipped.items():
            contours = counted(count, "contour")
            if what:
                text = f"{contours} {what} {'is' if count == 1 else 'are'} skipped"
            else:
                text = f"{contours} without ContourGeometricType {'is' if count == 1 else 'are'} read as CLOSED_PLANAR"
            remarks.append(Remark(f"contours {what or 'without ContourGeometricType'}", roi.title, text))
        return found

    def _points(self, roi: Structure, position: int, item: pydicom.Dataset) -> np.ndarray:
        """Return the points of a contour, LPS, mm, shape (points, 3)."""
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
        """Assign contours to slices; add a remark about skipped contours between slices."""
        near: dict[int, list[Contour]] = {}
        between: list[Contour] = []
        for contour in contours:
            k = round(contour.z)
            self._check_inside(roi, contour, k)
            if abs(contour.z - k) > IN_SLICE:
                between.append(contour)
            else:
                near.setdefault(k, []).append(contour)
        for contour in between:
            if not {int(np.floor(contour.z)), int(np.ceil(contour.z))} <= near.keys():
                raise InputError(self._not_in_slice(roi, contour))
        skipped = len(between)
        slices, farthest = {}, 0.0
        for k, candidates in near.items():
            plane = min((contour.z for contour in candidates), key=lambda z: abs(z - k))
            slices[k] = [contour for contour in candidates if abs(contour.z - plane) <= SAME_PLANE]
            skipped += len(candidates) - len(slices[k])
            farthest = max(farthest, *(abs(contour.z - k) for contour in slices[k]))
        if skipped:
            text = f"{counted(skipped, 'contour')} between slices of the CT {'is' if skipped == 1 else 'are'} skipped, "
            remarks.append(Remark("contours between slices", roi.title, text + "as the adjacent slices have contours"))
        if farthest > SAME_PLANE:
            text = f"its contours lie up to {farthest * self.grid.spacing[0]:.3g} mm from the slices of the CT; "
            remarks.append(Remark("contours beside slices", roi.title, text + "each is moved to the nearest slice"))
        return slices

    def _not_in_slice(self, roi: Structure, contour: Contour) -> str:
        z = self._z_mm(contour)
        return f"{self.path}: a contour of {roi.title} at z = {z:g} mm does not lie in a slice of the CT; {ADVICE}"

    def _check_inside(self, roi: Structure, contour: Contour, k: int) -> None:
        if not 0 <= k < self.grid.shape[0]:
            raise InputError(self._not_in_slice(roi, contour))
        edges = np.array(self.grid.shape[1:]) - 0.5
        if contour.points.min() < -0.5 or (contour.points > edges).any():
            raise InputError(
                f"{self.path}: a contour of {roi.title} at z = {self._z_mm(contour):g} mm leaves the CT; {ADVICE}"
            )

    def _z_mm(self, contour: Contour) -> float:
        return round(float(self.grid.affine[2, 3] + contour.z * self.grid.spacing[0]), 3)


def _on_centers(points: np.ndarray, grid: Grid) -> np.ndarray:
    """Move coordinates (row, column) that equal a voxel center up to rounding onto it."""
    centers = points.round()
    return np.where(np.abs(points - centers) * np.array(grid.spacing[1:]) <= ON_CENTER_MM, centers, points)


def _name(item: pydicom.Dataset, dataset: pydicom.Dataset) -> str:
    """Return the name of an ROI; UTF-8 is recognized if the file has no character set."""
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
        Part of the slice that is filled in place.
    first : ndarray
        First row and column of the plane in the slice.

    Returns
    -------
    repeated, overlaps : int
        Numbers of contours that are stored more than once, and that overlap another contour partly.
    """
    distinct: list[Contour] = []
    for contour in contours:
        if not any(_same(contour, other) for other in distinct):
            distinct.append(contour)
    distinct.sort(key=lambda contour: -contour.area)
    depths: list[int] = []
    overlaps = 0
    for n, contour in enumerate(distinct):
        around = [m for m in range(n) if _within(contour, distinct[m])]
        depths.append(1 + max((depths[m] for m in around), default=-1))
        hole = depths[-1] % 2 == 1
        box, inside, on = _rasterized(contour.points - first, plane.shape)
        part = plane[box]
        if contour.xor:
            part ^= inside if hole else inside | on
        elif hole:  # the outline of a hole belongs to the region
            part &= ~inside
        else:
            overlaps += bool((part & inside).any())
            part |= inside | on
    return len(contours) - len(distinct), overlaps


def _rasterized(points: np.ndarray, shape: tuple[int, int]) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray]:
    """Return a box of the plane, and its voxels whose centers lie within a contour and on it.

    A center is inside if an odd number of edges cross its row to the left of it. The time is proportional to the length
    of the outline; skimage.measure.grid_points_in_poly takes 0.2 s per slice of a body.
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
    # An edge crosses the row of its upper end but not the row of its lower end, so vertices are crossed once.
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


def _same(contour: Contour, other: Contour) -> bool:
    """Return whether two outlines are within a distance of SAME everywhere."""
    for extreme in (np.min, np.max):
        if np.abs(extreme(contour.points, axis=0) - extreme(other.points, axis=0)).max() > SAME:
            return False
    return bool(
        _distance(contour.points, other.points).max() <= SAME and _distance(other.points, contour.points).max() <= SAME
    )


def _within(contour: Contour, other: Contour) -> bool:
    """Return whether a contour lies within another one, with a tolerance of SAME."""
    slack = SAME
    if (contour.points.min(axis=0) < other.points.min(axis=0) - slack).any():
        return False
    if (contour.points.max(axis=0) > other.points.max(axis=0) + slack).any():
        return False
    edge = _refined(contour.points)
    inside = points_in_poly(edge, other.points)
    if not inside.any():
        return False
    return bool(inside.all() or _distance(edge[~inside], other.points).max() <= slack)


def _refined(points: np.ndarray) -> np.ndarray:
    """Subdivide an outline into steps of SAME at most."""
    following = np.roll(points, -1, axis=0)
    steps = np.maximum(np.ceil(np.linalg.norm(following - points, axis=1) / SAME).astype(int), 1)
    start = np.repeat(points, steps, axis=0)
    share = np.concatenate([np.arange(n) / n for n in steps])[:, None]
    return start + share * (np.repeat(following, steps, axis=0) - start)


def _distance(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Return the distance of each point to a closed outline."""
    start, step = outline, np.roll(outline, -1, axis=0) - outline
    length = np.maximum((step**2).sum(axis=1), 1e-30)
    nearest = np.full(len(points), np.inf)
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) // 256)):
        away = points[chunk][:, None] - start
        share = np.clip((away * step).sum(axis=2) / length, 0, 1)
        nearest[chunk] = np.linalg.norm(away - share[..., None] * step, axis=2).min(axis=1)
    return nearest
