"""Read regions drawn on a CT: masks and label maps (NIfTI, NRRD, MetaImage), DICOM SEG and RTSTRUCT.

`open_regions` selects the reader by the file. The label that selects a region depends on the kind of file:

* label map: value (None: all voxels that are not zero)
* DICOM SEG: number or label of a segment (None: the only one)
* RTSTRUCT: name or number of an ROI (None: the only one)
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pydicom
from pydicom.errors import InvalidDicomError
from scipy.ndimage import find_objects

from ..base.console import note
from ..base.errors import InputError
from ..base.geometry import Grid
from ..io.volumes import Volume, read_layers, suffix_of
from .contours import StructRegions
from .dicom_files import modality
from .regions import CroppedRegion, Regions, Remark, crop_to_box, voxel_offset
from .segments import SegRegions

KINDS = {
    "1.2.840.10008.5.1.4.1.1.66.4": SegRegions,
    "1.2.840.10008.5.1.4.1.1.66.7": SegRegions,  # Label Map Segmentation
    "1.2.840.10008.5.1.4.1.1.481.3": StructRegions,
}
MODALITIES = {"SEG": SegRegions, "RTSTRUCT": StructRegions}
# Tolerance of integer labels: half precision, the coarsest type, has a relative error of 5e-4.
INTEGER_TOLERANCE = 1e-3
# Largest number of different labels: TotalSegmentator has 117, FreeSurfer's Destrieux parcellation 192. A CT has
# thousands of values.
MOST_LABELS = 1000
MOST_NEGATIVE = 10  # different values below 0: some programs mark unlabeled voxels by -1, a CT has hundreds of values
LARGEST_LABEL = 65_535  # larger labels are renumbered before bounding boxes are found


def open_regions(path: str | Path, grid: Grid) -> Regions:
    """Open a file of regions (NIfTI, NRRD, MetaImage, DICOM SEG or RTSTRUCT) that were drawn on the grid of a CT.

    Raises
    ------
    InputError
        If the file is missing, of another kind, or on another grid.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of the ROIs (NIfTI, NRRD, DICOM SEG or RTSTRUCT)")
    if suffix_of(path):
        return LabelRegions(path, grid)
    dataset = _dicom(path)
    reader = KINDS.get(str(dataset.get("SOPClassUID", ""))) or MODALITIES.get(str(dataset.get("Modality", "")))
    if reader is None:
        raise InputError(
            f"{path}: modality is {modality(dataset)}; ROIs are read from DICOM SEG or RTSTRUCT, or from NIfTI or NRRD"
        )
    return reader(path, dataset, grid)


def report_other_frame(regions: str | Path, ct: str | Path) -> None:
    """Report a DICOM SEG or RTSTRUCT with another frame of reference than the CT in a folder (PS3.3, C.7.4.1).

    This is not an error: positions show whether regions fit, and anonymization often replaces the identifiers of only
    one of both. Files other than DICOM have no frame of reference.
    """
    regions, ct = Path(regions), Path(ct)
    if not ct.is_dir() or not regions.is_file() or suffix_of(regions):
        return
    drawn, scanned = _frames(regions), None
    for path in sorted(ct.iterdir()):
        if drawn and path.is_file() and (scanned := _frames(path)):
            break
    if drawn and scanned and not drawn & scanned:
        note(
            f"{regions}: was drawn in another frame of reference than {ct} has (FrameOfReferenceUID); compare its "
            "outlines with the CT"
        )


def _frames(path: Path) -> set[str]:
    """Return the frames of reference in a DICOM file; none for other files."""
    keys = ("FrameOfReferenceUID", "ReferencedFrameOfReferenceUID")
    sections = ("ReferencedFrameOfReferenceSequence", "StructureSetROISequence")
    try:
        header = pydicom.dcmread(path, stop_before_pixels=True, specific_tags=[*keys, *sections])
        parts = [header, *(item for section in sections for item in header.get(section) or [])]
        return {str(part.get(key)) for part in parts for key in keys if part.get(key)}
    except (InvalidDicomError, OSError, ValueError, TypeError, AttributeError, EOFError, struct.error):
        return set()  # its reader reports the problem


def _dicom(path: Path) -> pydicom.Dataset:
    """Read a DICOM file, with or without a preamble."""
    try:
        try:
            return pydicom.dcmread(path)
        except InvalidDicomError:
            dataset = pydicom.dcmread(path, force=True)
            if "SOPClassUID" in dataset:
                return dataset
    except Exception as error:  # of many types; truncated, or not DICOM
        raise InputError(
            f"{path}: neither an image of labels nor readable DICOM ({type(error).__name__}); is the file complete?"
        ) from None
    raise InputError(f"{path}: neither NIfTI nor readable DICOM; give NIfTI, NRRD, DICOM SEG or RTSTRUCT")


class LabelRegions(Regions):
    """Masks and label maps whose voxels coincide with the CT's."""

    def __init__(self, path: Path, grid: Grid):
        super().__init__(path, grid)
        layers, header = read_layers(path)
        self._remarks: list[Remark] = []
        self._layers: list[np.ndarray] = []
        self._values: list[dict[int, tuple[int, tuple[slice, slice, slice]]]] = []  # {value: (stored, box)} per layer
        self._offset = voxel_offset(layers[0].grid, grid, path)
        for layer in layers:
            self._add(layer)
        self._report_part()
        self._names = _slicer_names(header, self._values)

    def _add(self, layer: Volume) -> None:
        labels, names = self._integer_labels(layer.array)
        boxes = find_objects(labels)
        found = {names[stored - 1] if names else stored: (stored, box) for stored, box in enumerate(boxes, 1) if box}
        if len(found) > MOST_LABELS:
            raise InputError(
                f"{self.path}: has {len(found)} different values above 0, up to {layer.array.max():g}: an image, not "
                "regions; give a label map or a mask"
            )
        self._layers.append(labels)
        self._values.append(found)

    def _integer_labels(self, array: np.ndarray) -> tuple[np.ndarray, list[int]]:
        """Return labels from 1 on, 0 elsewhere, and the original labels if they were renumbered."""
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise InputError(f"{self.path}: holds NaN or infinite values; give whole numbers")
        low, high = float(array.min()), float(array.max())
        fractions = array.dtype.kind == "f" and any(
            np.abs(plane - np.rint(plane)).max() > INTEGER_TOLERANCE for plane in array
        )
        if fractions or (low < 0 and high <= 0):
            value = low if high <= 0 else high
            tolerance = INTEGER_TOLERANCE * abs(value)
            if all((np.minimum(np.abs(plane), np.abs(plane - value)) <= tolerance).all() for plane in array):
                self._remarks.append(
                    Remark("two values", "", f"has the two values 0 and {value:.6g}; it is read as a mask, label 1")
                )
                return (np.abs(array) > abs(value) / 2).astype(np.uint8), []
        if fractions:
            raise InputError(
                f"{self.path}: holds fractions from {low:.4g} to {high:.4g}, as probabilities or an interpolated mask "
                "do; give whole numbers (threshold it first, for example at half of its maximum)"
            )
        if low < 0:
            below = np.unique(array[array < 0].round())
            if len(below) > MOST_NEGATIVE:
                raise InputError(
                    f"{self.path}: has {len(below)} different values below 0, from {low:g} on: an image, not regions; "
                    "give a label map or a mask"
                )
            listed = ", ".join(f"{value:g}" for value in below)
            self._remarks.append(Remark("negative", "", f"labels below 0 are skipped: {listed}"))
        if low > INTEGER_TOLERANCE:
            text = f"no voxel is 0: every voxel belongs to a region, and the lowest label is {low:g}"
            self._remarks.append(Remark("no background", "", text))
        if high > LARGEST_LABEL:
            names, stored = np.unique(np.rint(array), return_inverse=True)
            first = int(np.searchsorted(names, 0.5))
            stored = np.maximum(stored.reshape(array.shape) - (first - 1), 0).astype(np.int32)
            return stored, names[first:].astype(int).tolist()
        kind = np.uint8 if high <= np.iinfo(np.uint8).max else np.uint16
        labels = np.empty(array.shape, kind)
        for plane, out in zip(array, labels, strict=True):
            out[:] = np.maximum(np.rint(plane) if array.dtype.kind == "f" else plane, 0)
        return labels, []

    def _report_part(self) -> None:
        """Add a remark if the file covers only a part of the CT."""
        shape = self._layers[0].shape
        if self._offset != (0, 0, 0) or shape != self.grid.shape:
            sizes = " x ".join(map(str, shape[::-1])), " x ".join(map(str, self.grid.shape[::-1]))
            text = f"has {sizes[0]} voxels (x, y, z) of the CT's grid, which has {sizes[1]}; the rest is empty"
            self._remarks.append(Remark("part of the CT", "", text))

    def list_regions(self) -> dict[int | str, str | None]:
        """Return {label: name} of every region; only files of 3D Slicer have names."""
        if self._names:
            return {key: name for key, (name, _, _) in self._names.items()}
        return {value: None for found in self._values for value in sorted(found)}

    def _draw(self, label: int | str | None) -> tuple[str, CroppedRegion | None, bool]:
        if label is None:
            mask = np.logical_or.reduce([layer > 0 for layer in self._layers])
            found = crop_to_box(mask, self._offset, self._remarks)
            return "the mask", self._inside(found, "the mask"), False
        layer, value, name = self._find(label)
        stored, box = self._values[layer].get(value, (None, None))
        if box is None:
            return name, None, False
        moved = tuple(slice(s.start + n, s.stop + n) for s, n in zip(box, self._offset, strict=True))
        drawn = CroppedRegion(moved, self._layers[layer][box] == stored, tuple(self._remarks))
        return name, self._inside(drawn, name), False

    def _inside(self, drawn: CroppedRegion | None, name: str) -> CroppedRegion | None:
        """Check that a region lies within the CT."""
        if drawn is not None and any(
            s.start < 0 or s.stop > n for s, n in zip(drawn.box, self.grid.shape, strict=True)
        ):
            raise InputError(
                f"{self.path}: lies on another grid than the CT, and {name} goes beyond the CT; resample it onto the CT"
            )
        return drawn

    def _find(self, label: int | str) -> tuple[int, int, str]:
        """Return layer, value and name of a region."""
        if self._names:
            matching = [k for k, (name, _, value) in self._names.items() if str(label) in (str(k), name, str(value))]
            matching = [label] if label in self._names else matching
            if len(matching) != 1:
                listed = ", ".join(f"{key} ({name})" for key, (name, _, _) in self._names.items())
                problem = "is not there" if not matching else f"means {len(matching)} segments"
                raise InputError(f"{self.path}: segment {label!r} {problem}; there are: {listed}")
            name, layer, value = self._names[matching[0]]
            return layer, value, name
        if isinstance(label, bool) or not isinstance(label, int):
            raise InputError(f"{self.path}: label {label!r} must be a whole number, as it is in the file")
        for layer, found in enumerate(self._values):
            if label in found:
                return layer, label, f"label {label}"
        listed = ", ".join(str(value) for found in self._values for value in sorted(found))
        raise InputError(f"{self.path}: no voxel has the label {label}; there are: {listed or 'none'}")


def _slicer_names(header: dict[str, str], values: list[dict]) -> dict[int | str, tuple[str, int, int]]:
    """Return the segments {label: (name, layer, value)} in the header of a file of 3D Slicer."""
    segments = []
    while (start := f"Segment{len(segments)}_") and f"{start}Name" in header:
        numbers = [header.get(f"{start}{key}", default) for key, default in (("Layer", "0"), ("LabelValue", "1"))]
        layer, value = (int(number) if number.isdecimal() else -1 for number in numbers)
        segments.append((header[f"{start}Name"].strip(), layer, value))
    segments = [segment for segment in segments if segment[1] < len(values)]
    described = {(layer, value) for _, layer, value in segments}
    segments += [
        (f"label {value}", layer, value)
        for layer, found in enumerate(values)
        for value in sorted(found)
        if segments and (layer, value) not in described
    ]
    keys = [value for _, _, value in segments]
    names = [name for name, _, _ in segments]
    return {
        (value if keys.count(value) == 1 else name if names.count(name) == 1 else f"{name} {n}"): (name, layer, value)
        for n, (name, layer, value) in enumerate(segments, 1)
    }
