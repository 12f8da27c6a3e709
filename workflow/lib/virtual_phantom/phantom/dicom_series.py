"""Read one axial CT series from a folder of DICOM files, and refuse anything that would be read wrongly.

Attributes as in DICOM PS3.3, C.7.6.2 (image plane) and C.8.2.1 (CT image). DICOM's patient frame is LPS: x
and y have the opposite sign of the NIfTI world frame used here.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pydicom
import SimpleITK as sitk

from ..base.errors import InputError, reading
from ..io.volumes import Volume, check_fits, upright

POSITION_TOLERANCE_MM = 0.01  # headers give positions as decimal text, often rounded to this
LONGEST_CODE = 16  # characters of a DICOM code string
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])


def read_series(folder: str | Path) -> Volume:
    """Read a series as HU on an upright grid, whatever the order of the files.

    Parameters
    ----------
    folder : str or Path
        Files of one CT series.

    Returns
    -------
    Volume
        float32.

    Raises
    ------
    InputError
        If the folder holds no DICOM file, more than one series, anything but single-frame CT images with a rescale to
        HU, slices of different size, spacing or orientation, tilted slices, or a missing or doubled slice.
    """
    with reading(folder, "a DICOM series"):
        return _read_series(Path(folder))


def _read_series(folder: Path) -> Volume:
    headers = read_headers(folder)
    first = next(iter(headers.values()))
    if len({str(h.get("SeriesInstanceUID", "")) for h in headers.values()}) > 1:
        raise InputError(f"{folder}: holds more than one DICOM series; give a folder with one")
    for path, header in headers.items():
        _check_slice(path, header, first)
    check_fits(4 * len(headers) * first.Rows * first.Columns, folder)
    paths = sorted(headers, key=lambda path: float(headers[path].ImagePositionPatient[2]))
    positions = np.array([[float(v) for v in headers[path].ImagePositionPatient] for path in paths])
    spacing_z = _slice_spacing(folder, positions)

    reader = sitk.ImageSeriesReader()
    reader.SetFileNames([str(path) for path in paths])
    reader.SetOutputPixelType(sitk.sitkFloat32)  # the reader applies each slice's own rescale
    try:
        array = sitk.GetArrayFromImage(reader.Execute())
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise InputError(f"{folder}: pixel data cannot be read ({reason}); are the files complete?") from None
    row_spacing, column_spacing = (float(v) for v in first.PixelSpacing)
    orientation = np.array([float(v) for v in first.ImageOrientationPatient]).reshape(2, 3)
    affine = np.eye(4)
    affine[:3, 0], affine[:3, 1] = orientation[0] * column_spacing, orientation[1] * row_spacing
    affine[:3, 2], affine[:3, 3] = (0, 0, spacing_z), positions[0]
    return upright(array.T, LPS_TO_RAS @ affine, folder)


def modality(header: pydicom.Dataset) -> str:
    """The modality of a header, for messages: of a broken one it may hold all that follows, the patient's name too."""
    code = str(header.get("Modality", "not given"))
    return code if code.isalpha() and len(code) <= LONGEST_CODE else code if code == "not given" else "unreadable"


def read_headers(folder: Path) -> dict[Path, pydicom.Dataset]:
    """Headers of all DICOM files in a folder; other files are not part of a series and are passed over.

    Returns
    -------
    dict of Path to Dataset

    Raises
    ------
    InputError
        If there is none, one cannot be read, or one is not of CT.
    """
    headers = {}
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.name.startswith("."):
            continue
        try:
            header = pydicom.dcmread(path, stop_before_pixels=True)
        except pydicom.errors.InvalidDicomError:
            continue
        except Exception as error:  # of many types; its words may quote the header
            raise InputError(
                f"{path}: cannot be read as DICOM ({type(error).__name__}); is the file complete?"
            ) from None
        if header.get("Modality") != "CT":
            raise InputError(f"{path}: modality is {modality(header)}, not CT; keep only the CT series in this folder")
        headers[path] = header
    if not headers:
        raise InputError(f"{folder}: holds no DICOM file; give a folder with one CT series")
    return headers


def _check_slice(path: Path, header: pydicom.Dataset, first: pydicom.Dataset) -> None:
    for tag in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing", "Rows", "Columns"):
        if header.get(tag) is None:
            raise InputError(f"{path}: has no {tag}; give plain CT slices (multi-frame CT: convert it to NIfTI)")
    if header.get("RescaleSlope") is None or header.get("RescaleIntercept") is None:
        raise InputError(f"{path}: has no RescaleSlope and RescaleIntercept, so its values cannot be turned into HU")
    if (header.Rows, header.Columns) != (first.Rows, first.Columns) or not np.allclose(
        np.array(header.PixelSpacing, float), np.array(first.PixelSpacing, float), atol=1e-5
    ):
        raise InputError(f"{path}: slice size or pixel spacing differs from the others'; give one uniform series")
    pixels = header.Rows * header.Columns
    if not header.file_meta.TransferSyntaxUID.is_compressed:
        if pixels * header.get("BitsAllocated", 8) / 8 > path.stat().st_size:
            raise InputError(
                f"{path}: cannot be read as DICOM (its header says {header.Rows} x {header.Columns} pixels, which the "
                "file does not hold); is the file complete?"
            )
    axes = np.array(header.ImageOrientationPatient, float)
    if not np.allclose(axes, np.array(first.ImageOrientationPatient, float), atol=1e-4):
        raise InputError(f"{path}: orientation differs from the other slices'; give one uniform series")
    upright_axes = np.allclose(np.abs(axes), np.abs(axes).round(), atol=1e-3) and abs(axes[2]) + abs(axes[5]) < 1e-3
    if not upright_axes or abs(float(header.get("GantryDetectorTilt") or 0)) > 0.1:
        raise InputError(f"{path}: slices are tilted or not axial; resample the series onto upright axial slices first")


def _slice_spacing(folder: Path, positions: np.ndarray) -> float:
    if len(positions) < 2:
        raise InputError(f"{folder}: holds one slice only; give a series of at least two")
    if np.ptp(positions[:, :2], axis=0).max() > POSITION_TOLERANCE_MM:
        raise InputError(
            f"{folder}: slices are shifted sideways against each other (gantry tilt); "
            "resample the series onto upright axial slices first"
        )
    steps = np.diff(positions[:, 2])
    usual = float(np.median(steps))
    if steps.min() < POSITION_TOLERANCE_MM:
        z = positions[int(steps.argmin()), 2]
        raise InputError(f"{folder}: two slices at z = {z:g} mm; give one series with one slice per position")
    wrong = int(np.abs(steps - usual).argmax())
    if abs(steps[wrong] - usual) > max(0.01 * usual, POSITION_TOLERANCE_MM):
        raise InputError(
            f"{folder}: slices are {usual:g} mm apart, but those at z = {positions[wrong, 2]:g} and "
            f"{positions[wrong + 1, 2]:g} mm {steps[wrong]:g} mm: a slice is missing or spacing is uneven"
        )
    return float(steps.mean())
