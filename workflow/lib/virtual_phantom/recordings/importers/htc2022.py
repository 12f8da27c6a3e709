"""Helsinki Tomography Challenge 2022 sinograms (MATLAB v5 .mat) to a recording of projections.

Data: Zenodo 6984868 (later versions: 8041800). By its description the sinograms are corrected for background and flat
field, compensated for a misaligned centre of rotation, and logged. They have one detector row: a fan beam.

The frame: with the source at -y in the first view and turning from -y towards +x, images come out as the data set's own
segmentations show them, row 0 at the top (+y), column 0 at the left (-x). The detector's columns then run the other way
than in the files. That the source is on that side, and not on the other with the columns as they are, shows where the
fan diverges: a part of the object that is nearer to the source casts a wider shadow.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat, whosmat

from ...base.errors import InputError
from ...io.files import sha256
from ...io.hdf5 import new_file
from ...io.volumes import write_nifti
from ..recording import Recording
from . import write_folder
from .htc2022_object import read_object

VARIABLES = ("CtDataFull", "CtDataLimited")
CITATION = "Helsinki Tomography Challenge 2022 (HTC2022) open tomographic dataset, Zenodo, 10.5281/zenodo.6984868"
FIRST_DEG = 180.0  # of the frame here, where the files have 0
OBJECT = "object.nii.gz"
STEP_TOLERANCE_DEG = 1e-3  # between steps from view to view, which the files have evenly


def import_htc2022(
    mat_file: str | Path, folder: str | Path, phantom: str | None = None, segmentation: str | Path | None = None
) -> Recording:
    """Write a recording of projections (line integrals, one detector row) and load it.

    Parameters
    ----------
    mat_file : str or Path
        A sinogram of the data set.
    folder : str or Path
        The recording's, which is made.
    phantom : str, optional
        What was scanned, for recording.yaml.
    segmentation : str or Path, optional
        The data set's own (.mat), which becomes OBJECT, the mask of what was scanned.

    Raises
    ------
    InputError
        If the file is missing, truncated or something else, lacks a field, is not in mm, or has angles that are not
        evenly spaced.
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
        with new_file(target / "projections.h5") as file:
            stored = file.create_dataset(
                "exchange/data", data=sinogram[:, None, ::-1], compression="gzip", shuffle=True
            )
            stored.attrs["log"] = True
            file.create_dataset("exchange/theta", data=angles + FIRST_DEG).attrs["units"] = "degree"
        if scanned is not None:
            write_nifti(scanned, target / OBJECT)

    content = {
        "kind": "projections",
        **({"phantom": phantom} if phantom else {}),
        "scan": scan,
        "nominal": _nominal(mat_file, parameters),
        "origin": {"citation": CITATION, "importer": "htc2022", "sha256": [sha256(source) for source in sources]},
        "repeats": ["projections.h5"],
    }
    return write_folder(folder, content, write)


def _read(mat_file: Path):
    if not mat_file.is_file():
        raise InputError(f"{mat_file}: no such file; give a sinogram of the HTC 2022 data set (.mat)")
    try:
        # One-by-one arrays of objects, as MATLAB stores structs, come back as the struct itself.
        content = loadmat(mat_file, struct_as_record=False, squeeze_me=True, variable_names=VARIABLES)
    except Exception as error:  # scipy raises many types on broken files
        raise InputError(f"{mat_file}: cannot be read as MATLAB v5 ({error}); is the file complete?") from None
    for name in VARIABLES:
        if name in content:
            return content[name]
    there = ", ".join(name for name, *_ in whosmat(mat_file))
    raise InputError(f"{mat_file}: holds no {' or '.join(VARIABLES)} but {there or 'nothing'}; give a sinogram file")


def _field(mat_file: Path, struct, name: str):
    if not hasattr(struct, name):
        raise InputError(f"{mat_file}: has no field {name}; is it a sinogram of the HTC 2022 data set?")
    return getattr(struct, name)


def _numbers(mat_file: Path, struct, name: str, *dimensions: int) -> np.ndarray:
    """The numbers of a field, with one of these numbers of dimensions; by default a single number."""
    value = _field(mat_file, struct, name)
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        array = None
    # Line integrals that are not finite are counted where the recording is read.
    finite = array is not None and (2 in dimensions or np.isfinite(array).all())
    if not finite or array.ndim not in (dimensions or (0,)):
        kind = "a matrix of numbers" if 2 in dimensions else "finite numbers" if dimensions else "a finite number"
        raise InputError(
            f"{mat_file}: the field {name} does not hold {kind}; restore the file of the HTC 2022 data set"
        )
    return array


def _scan(mat_file: Path, parameters, shape: tuple[int, ...], angles: np.ndarray) -> dict:
    if (unit := str(_field(mat_file, parameters, "distanceUnit"))) != "mm":
        raise InputError(f"{mat_file}: distances are in {unit}, not mm")
    columns = int(_numbers(mat_file, parameters, "numDetectorsPost"))
    if shape != (angles.size, columns):
        raise InputError(f"{mat_file}: sinogram of {shape} for {angles.size} angles and {columns} detector columns")
    steps = np.diff(angles)
    if angles.size < 2 or np.ptp(steps) > STEP_TOLERANCE_DEG or steps[0] == 0:
        raise InputError(f"{mat_file}: angles are not evenly spaced")
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
        "start_angle_deg": float(angles[0]) + FIRST_DEG,
        "direction": 1 if step > 0 else -1,
        # That of a view; how long the bench turns and waits from view to view is not stated.
        **(
            {"exposure_ms": float(_numbers(mat_file, parameters, "exposureTime"))}
            if hasattr(parameters, "exposureTime")
            else {}
        ),
    }


def _nominal(mat_file: Path, parameters) -> dict:
    """What the file says of tube and detector; fields that it leaves out are left out."""
    texts = {"model": "scanner", "anode": "target", "detector_model": "detector"}
    numbers = {"tube_kvp": "voltage", "tube_current_ma": "current", "exposure_time_ms": "exposureTime"}
    found = {key: str(getattr(parameters, name)) for key, name in texts.items() if hasattr(parameters, name)}
    found |= {
        key: float(_numbers(mat_file, parameters, name)) for key, name in numbers.items() if hasattr(parameters, name)
    }
    if hasattr(parameters, "xRayFilter") and hasattr(parameters, "xRayFilterThickness"):
        found["filtration"] = f"{parameters.xRayFilterThickness} mm {parameters.xRayFilter}"
    return found
