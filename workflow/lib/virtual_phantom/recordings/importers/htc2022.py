"""Import sinograms of the Helsinki Tomography Challenge 2022 (MATLAB v5 .mat) as a recording of projections.

The data are on Zenodo (6984868; later versions: 8041800). According to the description there, sinograms are corrected
for background and flat field, compensated for a misaligned center of rotation, and logarithmic. The detector has one
row, so the beam is a fan beam.

Orientation: in the first view the source is at -y, and it rotates from -y towards +x. Images then match the data set's
segmentations, with row 0 at the top (+y) and column 0 at the left (-x). The detector columns must be reversed. The
divergence of the fan excludes the alternative (source on the other side, columns not reversed), because parts closer to
the source cast wider shadows.

Reconstructions and segmentations of the data set have 512 x 512 pixels. A pixel is the detector pitch divided by the
magnification, and the isocenter is in the middle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.io import loadmat, whosmat

from ...base.errors import InputError
from ...base.geometry import Grid
from ...io.files import sha256
from ...io.volumes import Volume, write_nifti
from ..recording import Recording
from . import write_folder, write_projections

VARIABLES = ("CtDataFull", "CtDataLimited")
CITATION = "Helsinki Tomography Challenge 2022 (HTC2022) open tomographic dataset, Zenodo, 10.5281/zenodo.6984868"
FIRST_DEG = 180.0  # start angle here, 0 in the files
OBJECT = "object.nii.gz"
STEP_TOLERANCE_DEG = 1e-3  # the files have equal steps between views
SEGMENTATION = "reconFullFbpSeg"
SMOOTH_PX = 1.0  # standard deviation; smooths the steps of the threshold, shifts an edge of radius r by 1/(2 r) pixels
SLICE_MM = 1.0  # arbitrary: the objects are uniform along z


def import_htc2022(
    mat_file: str | Path, folder: str | Path, phantom: str | None = None, segmentation: str | Path | None = None
) -> Recording:
    """Write a recording of projections (line integrals, one detector row) and load it.

    Parameters
    ----------
    mat_file : str or Path
        Sinogram of the data set.
    segmentation : str or Path, optional
        Segmentation of the data set (.mat), which becomes OBJECT, the mask of the scanned object.

    Raises
    ------
    InputError
        If a file is missing or damaged, lacks a field, is not in mm, or has angles that are not evenly spaced.
    """
    mat_file = Path(mat_file)
    data = _read(mat_file)
    sinogram = _numbers(mat_file, data, "sinogram", 2).astype(np.float32)
    parameters = _field(mat_file, data, "parameters")
    angles = np.atleast_1d(_numbers(mat_file, parameters, "angles", 0, 1))
    scan = _scan(mat_file, parameters, sinogram.shape, angles)
    scanned = None if segmentation is None else read_object(segmentation, scan)
    sources = [mat_file] if segmentation is None else [mat_file, Path(segmentation)]

    def write(target: Path) -> None:
        line_integrals = sinogram[:, None, ::-1]
        write_projections(target / "projections.h5", line_integrals, angles + FIRST_DEG, shuffle=True)
        if scanned is not None:
            write_nifti(scanned, target / OBJECT)

    content = {
        "scan": scan,
        "nominal": _nominal(mat_file, parameters),
        "origin": {"citation": CITATION, "importer": "htc2022", "sha256": [sha256(source) for source in sources]},
        "repeats": ["projections.h5"],
    }
    return write_folder(folder, "projections", phantom, content, write)


def _read(mat_file: Path):
    # squeeze_me: arrays of one struct become the struct itself.
    content = read_mat(mat_file, "sinogram", VARIABLES, struct_as_record=False, squeeze_me=True)
    for name in VARIABLES:
        if name in content:
            return content[name]
    present = ", ".join(name for name, *_ in whosmat(mat_file))
    raise InputError(f"{mat_file}: has no {' or '.join(VARIABLES)} but {present or 'nothing'}; use a sinogram file")


def _field(mat_file: Path, struct, name: str):
    if not hasattr(struct, name):
        raise InputError(f"{mat_file}: has no field {name}; use a sinogram of the HTC 2022 data set")
    return getattr(struct, name)


def _numbers(mat_file: Path, struct, name: str, *dimensions: int) -> np.ndarray:
    """Return the values of a field and check its number of dimensions (default: a single value)."""
    value = _field(mat_file, struct, name)
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        array = None
    # Line integrals that are not finite are reported when the recording is loaded.
    finite = array is not None and (2 in dimensions or np.isfinite(array).all())
    if not finite or array.ndim not in (dimensions or (0,)):
        kind = "a matrix of numbers" if 2 in dimensions else "finite numbers" if dimensions else "a finite number"
        raise InputError(
            f"{mat_file}: the field {name} does not contain {kind}; restore the file of the HTC 2022 data set"
        )
    return array


def _scan(mat_file: Path, parameters, shape: tuple[int, ...], angles: np.ndarray) -> dict:
    if (unit := str(_field(mat_file, parameters, "distanceUnit"))) != "mm":
        raise InputError(f"{mat_file}: distanceUnit is {unit}; convert all distances to mm")
    columns = int(_numbers(mat_file, parameters, "numDetectorsPost"))
    if shape != (angles.size, columns):
        raise InputError(
            f"{mat_file}: sinogram has shape {shape}, but there are {angles.size} angles and {columns} detector "
            "columns; restore the file of the HTC 2022 data set"
        )
    steps = np.diff(angles)
    if angles.size < 2 or np.ptp(steps) > STEP_TOLERANCE_DEG or steps[0] == 0:
        raise InputError(f"{mat_file}: angles are not evenly spaced; use a sinogram with equal steps between views")
    pitch = float(_numbers(mat_file, parameters, "pixelSizePost"))
    step = float((angles[-1] - angles[0]) / (angles.size - 1))
    return {
        "trajectory": "circular",
        "detector": "flat",
        "source_to_isocentre_mm": float(_numbers(mat_file, parameters, "distanceSourceOrigin")),
        "source_to_detector_mm": float(_numbers(mat_file, parameters, "distanceSourceDetector")),
        "columns": columns,
        "rows": 1,
        "column_pitch_mm": pitch,
        "row_pitch_mm": pitch,
        "views": angles.size,
        "views_per_rotation": 360 / abs(step),
        "start_angle_deg": math.remainder(float(angles[0]) + FIRST_DEG, 360),
        "direction": 1 if step > 0 else -1,
        # The exposure of a view; the time between views is not stated.
        **(
            {"exposure_ms": float(_numbers(mat_file, parameters, "exposureTime"))}
            if hasattr(parameters, "exposureTime")
            else {}
        ),
    }


def _nominal(mat_file: Path, parameters) -> dict:
    """Return the stated properties of tube and detector."""
    texts = {"model": "scanner", "anode": "target", "detector_model": "detector"}
    numbers = {"tube_kvp": "voltage", "tube_current_ma": "current", "exposure_time_ms": "exposureTime"}
    found = {key: str(getattr(parameters, name)) for key, name in texts.items() if hasattr(parameters, name)}
    found |= {
        key: float(_numbers(mat_file, parameters, name)) for key, name in numbers.items() if hasattr(parameters, name)
    }
    if hasattr(parameters, "xRayFilter") and hasattr(parameters, "xRayFilterThickness"):
        found["filtration"] = f"{parameters.xRayFilterThickness} mm {parameters.xRayFilter}"
    return found


def read_object(mat_file: str | Path, scan: dict) -> Volume:
    """Return the share of every pixel that the object fills.

    The segmentation is a thresholded image. After smoothing with a Gaussian, the contour at 1/2 follows the edge of the
    object to a fraction of a pixel. The slope there, 1/(sqrt(2 pi) sigma) per pixel, is increased to 1 per pixel,
    the slope of an edge averaged over a pixel. The area of the segmentation is preserved.

    Parameters
    ----------
    mat_file : str or Path
        Segmentation of the data set.
    scan : dict
        Scan section of the recording.

    Returns
    -------
    Volume
        Shape (1, y, x), float32, 0 to 1.

    Raises
    ------
    InputError
        If the file is missing, damaged, or contains no segmentation.
    """
    stored = np.asarray(read_mat(Path(mat_file), "segmentation", [SEGMENTATION]).get(SEGMENTATION, ()))
    inside = stored > 0 if stored.dtype.kind in "buif" else np.zeros(0, bool)
    if inside.ndim != 2 or not inside.any():
        raise InputError(f"{mat_file}: has no segmentation {SEGMENTATION}; use a ..._recon_fbp_seg.mat of the data set")
    pixel = scan["column_pitch_mm"] * scan["source_to_isocentre_mm"] / scan["source_to_detector_mm"]
    share = with_partial_pixels(inside)[::-1]
    return Volume(share[None].astype(np.float32), Grid((1, *share.shape), (SLICE_MM, pixel, pixel)))


def read_mat(path: Path, content: str, names: Sequence[str], **options) -> dict:
    """Read variables of a MATLAB v5 file of the data set; `content` says in messages what the file should contain.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; use a {content} of the HTC 2022 data set (.mat)")
    try:
        return loadmat(path, variable_names=names, **options)
    except Exception as error:  # scipy raises many types on damaged files
        raise InputError(f"{path}: cannot be read as MATLAB v5 ({error}); copy the complete file again") from None


def with_partial_pixels(inside: np.ndarray) -> np.ndarray:
    """Return a thresholded mask [row, column] with an edge one pixel wide along its smoothed outline, 0 to 1."""
    smooth = ndimage.gaussian_filter(inside.astype(float), SMOOTH_PX, mode="nearest")
    return np.clip(0.5 + (smooth - 0.5) * math.sqrt(2 * math.pi) * SMOOTH_PX, 0, 1)
