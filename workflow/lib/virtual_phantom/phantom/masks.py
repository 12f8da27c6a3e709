"""Regions drawn on a CT: NIfTI masks and label maps, DICOM SEG and RTSTRUCT, as bool masks on the CT's grid.

`open_regions` picks the reader by the file. Every reader has `mask(label)`; the label is a value of a label
map (none: any non-zero voxel), the number or label of a segment, or the name of an RTSTRUCT ROI (none: the
only one there is).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pydicom
from skimage.draw import polygon2mask

from ..base.errors import InputError, reading
from ..base.geometry import Grid
from ..io.volumes import Volume, read_nifti, upright
from .dicom_series import LPS_TO_RAS, modality

GRID_TOLERANCE_MM = 0.02  # of positions read from different files: single precision and decimal text


def open_regions(path: str | Path, grid: Grid) -> NiftiRegions | SegRegions | StructRegions:
    """The reader for a file of regions drawn on a CT.

    Parameters
    ----------
    path : str or Path
        NIfTI, DICOM SEG or RTSTRUCT.
    grid : Grid
        The CT's.

    Returns
    -------
    NiftiRegions, SegRegions or StructRegions

    Raises
    ------
    InputError
        If the file is missing, of another kind, or does not lie on the CT's grid.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the path of the ROIs (NIfTI, DICOM SEG or RTSTRUCT)")
    if path.name.endswith((".nii", ".nii.gz")):
        return NiftiRegions(path, grid)
    try:
        dataset = pydicom.dcmread(path)
    except Exception as error:  # not DICOM at all, or cut short
        raise InputError(f"{path}: neither NIfTI nor readable DICOM ({type(error).__name__})") from None
    kind = dataset.get("Modality")
    if kind == "SEG":
        return SegRegions(path, dataset, grid)
    if kind == "RTSTRUCT":
        return StructRegions(path, dataset, grid)
    raise InputError(
        f"{path}: modality is {modality(dataset)}; ROIs are read from DICOM SEG or RTSTRUCT, or from NIfTI"
    )


class NiftiRegions:
    """A mask or label map on the CT's own grid."""

    def __init__(self, path: Path, grid: Grid):
        self._path = path
        volume = read_nifti(path, dtype=np.float64)
        if not np.isfinite(volume.array).all():
            raise InputError(f"{path}: holds NaN or infinite values; give whole numbers")
        if not volume.grid.matches(grid, GRID_TOLERANCE_MM):
            raise InputError(
                f"{path}: lies on another grid than the CT ({volume.grid}; CT: {grid}); resample it onto the CT"
            )
        if not np.array_equal(volume.array, volume.array.round()):
            raise InputError(f"{path}: holds fractions; give whole numbers (threshold it first)")
        self._labels = volume.array.astype(np.int32)

    def there(self) -> dict[int | str, str | None]:
        """Every region: {label, as `mask` takes it: its name; None, as the file has none}."""
        return dict.fromkeys(np.unique(self._labels[self._labels > 0]).tolist())

    def mask(self, label: int | str | None) -> np.ndarray:
        """The region of a value of the label map; None: of any but 0.

        Returns
        -------
        ndarray of bool, shape (z, y, x)

        Raises
        ------
        InputError
            If the label is no whole number, or no voxel has it.
        """
        if label is None:
            return self._labels != 0
        if isinstance(label, bool) or not isinstance(label, int):
            raise InputError(f"{self._path}: label {label!r} must be a whole number, as it is in the NIfTI file")
        mask = self._labels == label
        if not mask.any():
            there = ", ".join(map(str, np.unique(self._labels[self._labels != 0])))
            raise InputError(f"{self._path}: no voxel has the label {label}; there are: {there or 'none'}")
        return mask


class SegRegions:
    """A DICOM Segmentation (PS3.3, A.51); it may leave out slices but must meet the CT's voxels."""

    def __init__(self, path: Path, dataset: pydicom.Dataset, grid: Grid):
        import highdicom  # a third of a second, for those who have such a file

        self._path, self._grid = path, grid
        with reading(path, "DICOM SEG"):
            self._seg = highdicom.seg.Segmentation.from_dataset(dataset)
            self._names = {
                n: str(self._seg.get_segment_description(n).segment_label) for n in self._seg.segment_numbers
            }

    def there(self) -> dict[int | str, str | None]:
        """Every region: {segment number, as `mask` takes it: its label}."""
        return {int(number): name for number, name in self._names.items()}

    def mask(self, label: int | str | None) -> np.ndarray:
        """The region of a segment, by its number or label; None: of the only one.

        Returns
        -------
        ndarray of bool, shape (z, y, x)

        Raises
        ------
        InputError
            If there is no such segment, or two, or it lies on another grid than the CT.
        """
        number = self._number(label)
        try:
            volume = self._seg.get_volume(segment_numbers=[number])
        except Exception as error:  # frames that do not make a regular volume
            raise InputError(
                f"{self._path}: segment {number} cannot be read as a volume ({type(error).__name__})"
            ) from None
        # highdicom orders arrays (slice, row, column) with an affine in LPS to match
        part = upright(
            volume.array[..., 0] if volume.array.ndim == 4 else volume.array,
            LPS_TO_RAS @ volume.affine,
            self._path,
        )
        return _place(part, self._grid, self._path) >= 0.5

    def _number(self, label: int | str | None) -> int:
        matching = [n for n, name in self._names.items() if label in (n, name)]
        if label is None and len(self._names) == 1:
            matching = list(self._names)
        if len(matching) != 1:
            there = ", ".join(f"{n} ({name})" for n, name in self._names.items())
            problem = "label is needed" if label is None else f"segment {label!r} is not there, or there twice"
            raise InputError(f"{self._path}: {problem}; there are: {there}")
        return matching[0]


class StructRegions:
    """A DICOM RT Structure Set (PS3.3, A.19): closed contours, one or more per slice.

    A voxel is inside if its centre is within an odd number of the slice's contours, so that an inner contour
    is a hole. Nothing is filled in between slices.
    """

    def __init__(self, path: Path, dataset: pydicom.Dataset, grid: Grid):
        self._path, self._grid = path, grid
        with reading(path, "DICOM RTSTRUCT"):
            self._collect(dataset)

    def _collect(self, dataset: pydicom.Dataset) -> None:
        contours = {int(c.ReferencedROINumber): c for c in dataset.get("ROIContourSequence", [])}
        self._rois: dict[str, list[pydicom.Dataset | None]] = {}
        for roi in dataset.get("StructureSetROISequence", []):
            self._rois.setdefault(str(roi.ROIName), []).append(contours.get(int(roi.ROINumber)))

    def there(self) -> dict[int | str, str | None]:
        """Every region: {ROI name, as `mask` takes it: the same}; names that are there twice are left out."""
        return {name: name for name, contours in self._rois.items() if len(contours) == 1}

    def mask(self, label: int | str | None) -> np.ndarray:
        """The region of an ROI, by its name; None: of the only one.

        Returns
        -------
        ndarray of bool, shape (z, y, x)

        Raises
        ------
        InputError
            If there is no such ROI, or two, or a contour does not lie in a slice of the CT.
        """
        if label is None and len(self._rois) == 1:
            label = next(iter(self._rois))
        if label not in self._rois or len(self._rois[label]) != 1:
            problem = "label is needed" if label is None else f"ROI {label!r} is not there, or there twice"
            raise InputError(f"{self._path}: {problem}; there are: {', '.join(self._rois) or 'none'}")
        mask = np.zeros(self._grid.shape, bool)
        with reading(self._path, "DICOM RTSTRUCT"):
            for contour in getattr(self._rois[label][0], "ContourSequence", None) or []:
                if contour.get("ContourGeometricType", "CLOSED_PLANAR") == "CLOSED_PLANAR":
                    self._draw(np.array(contour.ContourData, float).reshape(-1, 3), label, mask)
        return mask

    def _draw(self, points_lps: np.ndarray, label: str, mask: np.ndarray) -> None:
        homogeneous = np.column_stack([points_lps, np.ones(len(points_lps))])
        x, y, z = (np.linalg.inv(self._grid.affine) @ LPS_TO_RAS @ homogeneous.T)[:3]
        k = int(round(float(z.mean())))
        if np.ptp(z) > 0.1 or abs(z.mean() - k) > 0.25 or not 0 <= k < self._grid.shape[0]:
            raise InputError(
                f"{self._path}: a contour of ROI {label} at z = {points_lps[:, 2].mean():g} mm does not lie "
                "in a slice of the CT; is this the CT on which it was drawn?"
            )
        ny, nx = self._grid.shape[1:]
        if min(x.min(), y.min()) < -0.5 or x.max() > nx - 0.5 or y.max() > ny - 0.5:
            raise InputError(
                f"{self._path}: a contour of ROI {label} leaves the CT; is this the CT on which it was drawn?"
            )
        mask[k] ^= polygon2mask((ny, nx), np.column_stack([y, x]))


def _place(part: Volume, grid: Grid, path: Path) -> np.ndarray:
    """Put a volume whose voxels coincide with some of the grid's in its place; zero elsewhere."""
    offset = (np.array(part.grid.affine[:3, 3]) - grid.affine[:3, 3])[::-1] / np.array(grid.spacing)
    index = offset.round().astype(int)
    last = index + np.array(part.grid.shape)
    steps = np.array(part.grid.shape) * (np.array(part.grid.spacing) - np.array(grid.spacing))
    if (
        np.abs((offset - index) * np.array(grid.spacing)).max() > GRID_TOLERANCE_MM
        or np.abs(steps).max() > GRID_TOLERANCE_MM
        or index.min() < 0
        or np.any(last > grid.shape)
    ):
        raise InputError(f"{path}: lies on another grid than the CT ({part.grid}; CT: {grid}); resample it onto the CT")
    full = np.zeros(grid.shape, np.float32)
    full[tuple(slice(a, b) for a, b in zip(index, last, strict=True))] = part.array
    return full
