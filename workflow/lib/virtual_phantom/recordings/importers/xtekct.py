"""Import of a cone-beam scan of a Nikon (X-Tek) scanner: its parameter file (.xtekct) and its images.

Offsets have the signs of the reader in CIL (release 21) [1]_: positive ones displace the detector along its columns and
upwards, and the axis of rotation along the columns.

References
----------
.. [1] J. S. Jorgensen et al., Phil. Trans. R. Soc. A 379, 20200192, 2021.
"""

from __future__ import annotations

import configparser
import math
from pathlib import Path

import numpy as np

from ...base.console import note
from ...base.errors import InputError
from ..projections import BITS_8, quantized
from ..recording import Recording
from ..scan import SIZE
from .arrays import read_frames
from .projections import (
    angle_keys,
    arranged,
    binned,
    center_offsets,
    check_angles,
    check_bin,
    read_angles,
    read_field,
    source_files,
    write_recording,
)

ANODES = {"tungsten": "W", "molybdenum": "Mo", "copper": "Cu", "silver": "Ag", "rhodium": "Rh"}
TOP_ROW_FIRST = "vRc"  # images start with the top row


def import_xtekct(
    source: str | Path,
    folder: str | Path,
    phantom: str | None = None,
    *,
    images: str | None = None,
    flat: str | None = None,
    dark: str | None = None,
    bin: int = 1,
) -> Recording:
    """Write a recording of a scan and load it.

    Parameters
    ----------
    source : str or Path
        Parameter file. A file of angles (.ang) with the same name is used if there is one.
    images : str, optional
        Folder of the images. Default: the folder of the parameter file.
    flat, dark : str, optional
        As `import_projections`. Default: WhiteLevel, or the largest value of 8-bit images; no dark signal.
    bin : int, optional
        Number of pixels, along columns and rows, that are averaged to one.

    Raises
    ------
    InputError
        If the parameter file lacks a number, or does not fit the images.
    """
    source = Path(source)
    stated = _read(source)
    images_at = Path(images) if images else source.parent
    stack = read_frames(images_at, others=[name for name in (flat, dark) if name is not None]).data
    if stack.ndim != 3:
        raise InputError(f"{images_at}: has shape {stack.shape}; give the folder of the images with --images")
    data = arranged(stack, TOP_ROW_FIRST, images_at)
    check_bin(bin, data.shape)
    size = tuple(int(_length(source, stated, f"DetectorPixels{axis}")) for axis in "YX")
    if data.shape[1:] != size:
        raise InputError(
            f"{images_at}: images have {data.shape[1]} x {data.shape[2]} pixels (rows x columns), but {source.name} "
            f"states {size[0]} x {size[1]}; give the images of this scan"
        )
    listed = source.with_suffix(".ang")
    if listed.is_file():
        angles = check_angles(read_angles(listed), len(data), listed)
        if (angles[-1] - angles[0]) * _number(source, stated, "AngularStep") < 0:
            angles = -angles  # right for the six balls of a real scan, and CIL only uses AngularStep
            note(f"{listed}: its angles have the opposite sign of AngularStep, whose direction is used")
    else:
        angles = _number(source, stated, "InitialAngle") + _number(source, stated, "AngularStep") * np.arange(len(data))
        check_angles(angles, len(data), source)
    white = read_field(flat, None, "flat", data.shape, source, TOP_ROW_FIRST)
    if white is None:
        level = BITS_8 - 1 if data.dtype.itemsize == 1 else _length(source, stated, "WhiteLevel")
        white = np.full(size, float(level))
        note(f"{source}: no flat field; the white level is taken as {level:g}, the same in all pixels")
    black = read_field(dark, None, "dark", data.shape, source, TOP_ROW_FIRST)
    arrays = [binned(array, bin) for array in (data, white, np.zeros(size) if black is None else black)]
    pixel = [_length(source, stated, f"DetectorPixelSize{axis}") for axis in "XY"]
    offsets = [mm / side for mm, side in zip(_offsets_mm(source, stated), pixel, strict=True)]
    top, bottom = (_optional(source, stated, f"CentreOfRotation{end}") for end in ("Top", "Bottom"))
    turned = {key: _optional(source, stated, key) for key in ("ObjectRoll", "ObjectTilt")}
    if top != bottom or any(turned.values()):
        note(f"{source}: the axis of rotation is tilted (ObjectRoll, ObjectTilt, CentreOfRotation), which is not used")
    scan = {
        "trajectory": "circular",
        "source_to_isocentre_mm": _length(source, stated, "SrcToObject"),
        "source_to_detector_mm": _length(source, stated, "SrcToDetector"),
        "columns": arrays[0].shape[2],
        "rows": arrays[0].shape[1],
        "column_pitch_mm": bin * pixel[0],
        "row_pitch_mm": bin * pixel[1],
        **center_offsets(data.shape, bin, offsets),
        **angle_keys(angles, len(data)),
    }
    nominal = {"manufacturer": "Nikon"}
    if anode := ANODES.get(stated.get("TargetMaterial", "").lower()):
        nominal["anode"] = anode
    for key, name in (("tube_kvp", "XraykV"), ("tube_current_ma", "XrayuA")):
        if (value := _optional(source, stated, name)) > 0:
            nominal[key] = value / (1000 if key == "tube_current_ma" else 1)
    if _optional(source, stated, "Filter_ThicknessMM") > 0:
        nominal["filtration"] = f"{stated['Filter_ThicknessMM']} mm {stated.get('Filter_Material', '')}".strip()
    if stated.get("Detector"):
        nominal["detector_model"] = stated["Detector"]
    files = source_files(source, listed, images_at, flat, dark)
    remarks = quantized(data) if bin > 1 else ()
    return write_recording(folder, phantom, arrays, scan, nominal, "xtekct", files, [SIZE], remarks)


def _read(path: Path) -> dict[str, str]:
    """Return the keys of all sections."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the parameter file of the scan (.xtekct)")
    parser = configparser.RawConfigParser(strict=False)
    parser.optionxform = str  # keys keep their case
    try:
        parser.read_string(path.read_text(encoding="utf-8-sig", errors="replace"))
    except configparser.Error as error:
        raise InputError(
            f"{path}: is no parameter file of a Nikon scanner ({type(error).__name__}); give the .xtekct "
            "file of the scan"
        ) from None
    return {key: value for section in parser.sections() for key, value in parser.items(section)}


def _offsets_mm(path: Path, stated: dict[str, str]) -> tuple[float, float]:
    """Return the displacement of the detector from the axis of rotation along columns and rows, mm at the detector."""
    axis = sum(_optional(path, stated, f"CentreOfRotation{end}") for end in ("Top", "Bottom")) / 2
    if "ObjectOffsetX" in stated:  # of newer files, mm at the object
        enlarged = _length(path, stated, "SrcToDetector") / _length(path, stated, "SrcToObject")
        axis = enlarged * _number(path, stated, "ObjectOffsetX")
    along, up = (_optional(path, stated, f"DetectorOffset{direction}") for direction in "XY")
    return along - axis, up


def _optional(path: Path, stated: dict[str, str], key: str) -> float:
    """Return a number, 0 if it is missing or empty."""
    return _number(path, stated | {key: stated.get(key) or "0"}, key)


def _length(path: Path, stated: dict[str, str], key: str) -> float:
    """Return a number that must be positive."""
    value = _number(path, stated, key)
    if value <= 0:
        raise InputError(f"{path}: {key} is {stated[key]}; give a number above 0")
    return value


def _number(path: Path, stated: dict[str, str], key: str) -> float:
    try:
        value = float(stated[key])
    except KeyError:
        raise InputError(f"{path}: has no {key}; give the parameter file of the scan (.xtekct)") from None
    except ValueError:
        raise InputError(f"{path}: {key} is {stated[key]!r}; give a number with a decimal point") from None
    if not math.isfinite(value):
        raise InputError(f"{path}: {key} is {stated[key]}; give a finite number")
    if stated.get("Units", "mm") != "mm":
        raise InputError(f"{path}: Units is {stated['Units']}; convert all lengths to mm")
    return value
