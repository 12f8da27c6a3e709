"""Read regions from DICOM Segmentations (PS3.3, A.51)."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pydicom
from pydicom.pixels import get_decoder

from ..base.errors import InputError, reading, refusing
from ..base.geometry import Grid
from ..base.names import counted
from .regions import (
    GRID_TOLERANCE_MM,
    CroppedRegion,
    Regions,
    Remark,
    crop_to_box,
    sequence_of,
    to_voxels,
    whole_number,
)

INSIDE = 0.5  # least fraction of a voxel (or probability) for the voxel to belong to a segment
LABEL_MAP = "LABELMAP"


class SegRegions(Regions):
    """Segments whose pixels coincide with voxels of the CT, in any orientation along its axes.

    Slices without a frame are empty. Pixels outside the CT must be empty.
    """

    def __init__(self, path: Path, dataset: pydicom.Dataset, grid: Grid):
        super().__init__(path, grid)
        self._dataset, self._to_voxels = dataset, to_voxels(grid)
        self._remarks: list[Remark] = []
        with reading(path, "DICOM SEG"):  # pydicom parses items when they are read
            self._names = self._segments()
            self._type = self._segmentation_type()
            self._frames = self._frames_of()

    def _segments(self) -> dict[int, str]:
        names: dict[int, str] = {}
        for position, segment in enumerate(sequence_of(self.path, self._dataset, "SegmentSequence"), 1):
            number = whole_number(segment, "SegmentNumber")
            if number is None:
                raise InputError(
                    f"{self.path}: item {position} of SegmentSequence has no valid SegmentNumber; export the SEG again"
                )
            if number in names:
                raise InputError(f"{self.path}: SegmentNumber {number} is given twice; export the SEG again")
            names[number] = str(segment.get("SegmentLabel") or "").strip()
        if str(self._dataset.get("SegmentationType") or "") == LABEL_MAP:
            names.pop(0, None)  # the background
        if not names:
            raise InputError(f"{self.path}: has no SegmentSequence with segments; export the SEG again")
        return names

    def _segmentation_type(self) -> str:
        stated = str(self._dataset.get("SegmentationType") or "")
        if stated in ("BINARY", "FRACTIONAL", LABEL_MAP):
            return stated
        if not stated and self._dataset.get("BitsAllocated") == 1:
            return "BINARY"
        problem = f"is '{stated}'" if stated.isalpha() else "is missing"
        raise InputError(f"{self.path}: SegmentationType {problem}; BINARY, FRACTIONAL and LABELMAP are read")

    def _frames_of(self) -> dict[int, list[int]]:
        """Return the frames of each segment; all frames if pixel values are segment numbers."""
        with self._listing():
            groups = sequence_of(self.path, self._dataset, "PerFrameFunctionalGroupsSequence")
            count = whole_number(self._dataset, "NumberOfFrames")
            if count is not None and count != len(groups):
                raise InputError(
                    f"{self.path}: NumberOfFrames is {count}, and PerFrameFunctionalGroupsSequence describes "
                    f"{len(groups)}; is the file complete?"
                )
            self._groups = list(groups)
            shared = self._dataset.get("SharedFunctionalGroupsSequence") or []
            self._shared = shared[0] if isinstance(shared, pydicom.Sequence) and len(shared) else pydicom.Dataset()
            if self._type == LABEL_MAP:
                return {number: list(range(len(groups))) for number in self._names}
            frames: dict[int, list[int]] = {number: [] for number in self._names}
            unknown = []
            for frame in range(len(groups)):
                item = self._item(frame, "SegmentIdentificationSequence")
                number = None if item is None else whole_number(item, "ReferencedSegmentNumber")
                if number is None and len(self._names) == 1 and item is None:
                    number = next(iter(self._names))
                if number is None:
                    raise InputError(
                        f"{self.path}: frame {frame + 1} has no valid ReferencedSegmentNumber; export the SEG again"
                    )
                if number in frames:
                    frames[number].append(frame)
                else:
                    unknown.append(number)
            if unknown:
                numbers = ", ".join(map(str, sorted(set(unknown))))
                text = f"{counted(len(unknown), 'frame')} of no segment (number {numbers}) skipped"
                self._remarks.append(Remark("frames without a segment", "", text))
            return frames

    @contextlib.contextmanager
    def _listing(self) -> Iterator[None]:
        """Add the list of segments to error messages."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{error}; its segments: {self._listed()}") from None

    def _listed(self) -> str:
        return ", ".join(f"{n} ({name or 'no label'})" for n, name in self._names.items())

    def list_regions(self) -> dict[int | str, str | None]:
        """Return {segment number: label} of every segment."""
        return {number: name or f"segment {number}" for number, name in self._names.items()}

    def _draw(self, label: int | str | None) -> tuple[str, CroppedRegion | None, bool]:
        number = self._number(label)
        name = f"segment {number} ({self._names[number] or 'no label'})"
        remarks = list(self._remarks)
        with reading(self.path, "DICOM SEG"), self._listing():
            points, repeated = self._points(number)
        if not len(points):
            return name, None, False
        if self._type == "FRACTIONAL":
            text = f"is FRACTIONAL; voxels of at least {INSIDE:g} belong to it"
            remarks.append(Remark("fractional segments", name, text))
        if repeated:
            text = f"{counted(repeated, 'frame')} at the position of another frame of it; they are united"
            remarks.append(Remark("repeated frames", name, text))
        low, high = points.min(axis=0), points.max(axis=0) + 1
        mask = np.zeros(high - low, bool)
        mask[tuple((points - low).T)] = True
        return name, crop_to_box(mask, low, remarks), False

    def _points(self, number: int) -> tuple[np.ndarray, int]:
        """Return the voxels (z, y, x) of a segment, and the number of frames at the position of another frame."""
        frames = self._frames[number]
        parts, positions = [np.empty((0, 3), int)], set()
        for frame, pixels in zip(frames, self._pixels(frames), strict=True):
            first, per_row, per_column = self._position(frame, pixels.shape)
            positions.add(tuple(first))
            if self._type == LABEL_MAP:
                inside = pixels == number
            elif self._type == "FRACTIONAL":
                inside = pixels >= INSIDE * self._largest_fraction()
            else:
                inside = pixels != 0
            rows, columns = np.nonzero(inside)
            parts.append(first + rows[:, None] * per_row + columns[:, None] * per_column)
        points = np.concatenate(parts)
        if len(points) and (points.min() < 0 or (points >= self.grid.shape).any()):
            raise InputError(f"{self.path}: segment {number} goes beyond the CT; is this the CT on which it was drawn?")
        return points, len(frames) - len(positions)

    def _largest_fraction(self) -> int:
        largest = whole_number(self._dataset, "MaximumFractionalValue")
        if not largest or largest < 0:
            raise InputError(
                f"{self.path}: is FRACTIONAL and has no valid MaximumFractionalValue; export the SEG again"
            )
        return largest

    def _pixels(self, frames: list[int]) -> Iterator[np.ndarray]:
        if not frames:
            return
        # pydicom raises many types on broken pixel data.
        with refusing(f"{self.path}: its pixels cannot be read", Exception, advice="is the file complete?"):
            decoder = get_decoder(self._dataset.file_meta.TransferSyntaxUID)
            yield from (array for array, _ in decoder.iter_array(self._dataset, indices=frames))

    def _item(self, frame: int, keyword: str) -> pydicom.Dataset | None:
        """Return an item of the functional groups of a frame, or of the shared groups."""
        for group in (self._groups[frame], self._shared):
            items = group.get(keyword)
            if isinstance(items, pydicom.Sequence) and len(items):
                return items[0]
        return None

    def _position(self, frame: int, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the voxel (z, y, x) of the first pixel of a frame, and the steps between rows and columns."""
        position = self._numbers(frame, "PlanePositionSequence", "ImagePositionPatient", 3)
        axes = self._numbers(frame, "PlaneOrientationSequence", "ImageOrientationPatient", 6)
        spacing = self._numbers(frame, "PixelMeasuresSequence", "PixelSpacing", 2)
        for to_voxel in self._to_voxels:
            first = (to_voxel @ [*position, 1.0])[2::-1]
            # PS3.3, C.7.6.2.1.1: the first three cosines are along a row, from column to column
            per_column = (to_voxel[:3, :3] @ (axes[:3] * spacing[1]))[::-1]
            per_row = (to_voxel[:3, :3] @ (axes[3:] * spacing[0]))[::-1]
            steps = (first, 1), (per_row, shape[0] - 1), (per_column, shape[1] - 1)
            off = max(float(np.abs((step - step.round()) * n * self.grid.spacing).max()) for step, n in steps)
            lengths = [float(np.abs(step.round()).sum()) for step in (per_row, per_column)]
            if off <= GRID_TOLERANCE_MM and lengths == [1, 1] and per_row.round() @ per_column.round() == 0:
                return first.round().astype(int), per_row.round().astype(int), per_column.round().astype(int)
        raise InputError(
            f"{self.path}: lies on another grid than the CT: frame {frame + 1} has {shape[1]} x {shape[0]} pixels "
            f"of {spacing[1]:g} x {spacing[0]:g} mm at {tuple(position.tolist())} (LPS; CT: {self.grid}); "
            "resample it onto the CT"
        )

    def _numbers(self, frame: int, sequence: str, keyword: str, count: int) -> np.ndarray:
        item = self._item(frame, sequence)
        value = None if item is None else item.get(keyword)
        try:
            numbers = np.array(value, float).reshape(-1)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if value is None or len(numbers) != count or not np.isfinite(numbers).all():
            raise InputError(
                f"{self.path}: frame {frame + 1} has no valid {keyword}, so its position is not known; export the SEG "
                "again"
            )
        return numbers

    def _number(self, label: int | str | None) -> int:
        if label is None and len(self._names) == 1:
            return next(iter(self._names))
        if isinstance(label, int) and label in self._names:
            return label
        matching = [n for n, name in self._names.items() if label is not None and str(label) in (str(n), name)]
        if len(matching) != 1:
            if label is None:
                problem = "label is needed"
            elif matching:
                numbers = " and ".join(map(str, matching))
                problem = f"segment {label!r} is there {len(matching)} times; give its number, {numbers}"
            else:
                problem = f"segment {label!r} is not there"
            raise InputError(f"{self.path}: {problem}; there are: {self._listed()}")
        return matching[0]
