"""Import of projections from arrays: image stacks, NumPy, MATLAB and HDF5 files, with flat and dark fields."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...base.console import note
from ...base.errors import InputError
from ...base.geometry import PARALLEL
from ...io.files import files_of
from ..projections import THETA_TOLERANCE, quantized
from ..recording import Recording
from ..scan import ELEMENT, UNKNOWN
from . import one_checksum, write_folder, write_projections
from .arrays import FORMATS, Frames, read_frames

AXES = "vrc"  # view, row, column
RADIANS_TOLERANCE = 0.005  # angles that span 180 or 360 degrees within this, in radians, are taken as radians
UNITS = {"mm": 1.0, "um": 1e-3, ELEMENT: 1.0}  # lengths in recording.yaml per unit of the options


def import_projections(
    source: str | Path,
    folder: str | Path,
    phantom: str | None = None,
    *,
    dataset: str | None = None,
    axes: str | None = None,
    flat: str | None = None,
    dark: str | None = None,
    air_columns: int = 0,
    log: bool = False,
    bin: int = 1,
    angles: str | None = None,
    beam: str = "divergent",
    source_to_axis: float | None = None,
    source_to_detector: float | None = None,
    pixel: Sequence[float] = (1.0,),
    unit: str = "mm",
    tube_kvp: float | None = None,
    energy_kev: float | None = None,
    not_checked: Sequence[str] = (),
) -> Recording:
    """Write a recording of projections and load it.

    Parameters
    ----------
    source : str or Path
        File or folder (arrays.read_frames).
    axes : str, optional
        A letter of AXES for each axis of the array; a capital letter reverses it. Default: vrc, or vc for a fan beam.
    flat, dark : str, optional
        File, or number, of the counts without an object and without X-rays. Default: what the file states; no dark
        signal.
    air_columns : int, optional
        Number of columns at either edge that see air. Their mean replaces the flat field; if the values are line
        integrals, it is subtracted.
    log : bool, optional
        Whether the values are line integrals.
    bin : int, optional
        Number of pixels, along columns and rows, that are averaged to one.
    angles : str, optional
        "START,STEP" in degrees, a file with one angle per view, or "unknown". Default: what the file states.
    source_to_axis, source_to_detector, pixel, unit : optional
        Distances and width (and height) of a pixel in "mm", "um" or detector elements ("element": scale not known).
    not_checked : sequence of str, optional
        "size": lengths of small or large scanners are accepted.

    Raises
    ------
    InputError
        If a file cannot be read, shapes do not fit, options contradict each other, or the flat field, the angles or a
        distance are missing.
    """
    frames = read_frames(source, dataset, [name for name in (flat, dark) if name is not None])
    data = arranged(frames.data, axes, source)
    check_bin(bin, data.shape)
    log = log or frames.log
    given = {"--flat": flat, "--dark": dark, "--air-columns": air_columns or None}
    given |= {"--source-to-axis": source_to_axis, "--source-to-detector": source_to_detector}
    if log:
        _refuse_unused(given, ("--flat", "--dark"), "line integrals")
    if air_columns:
        _refuse_unused(given, ("--flat",), "--air-columns")
    if beam == PARALLEL:
        _refuse_unused(given, ("--source-to-axis", "--source-to-detector"), "--beam parallel")
    if not 1 <= len(pixel) <= 2:
        raise InputError(f"--pixel: has {len(pixel)} numbers; give the width, or the width and height")
    white, black = (
        read_field(given, stated, name, data.shape, source, axes)
        for given, stated, name in ((flat, frames.flat, "flat"), (dark, frames.dark, "dark"))
    )
    if log:
        if air_columns:
            level = float(_air(data, air_columns, source).mean())
            note(f"{source}: line integrals of air were {level:.4g} and are now 0")
            data = data - level
        white = None
    elif air_columns:
        white = np.full(data.shape[1:], _air(data, air_columns, source).mean())
    elif white is None:
        raise InputError(
            f"{source}: counts need a flat field; give --flat, --air-columns, or --log if these are line integrals"
        )
    scan = scan_section(
        binned(data, bin).shape,
        _angles(angles, frames, len(data), source),
        beam=beam,
        distances=(source_to_axis, source_to_detector),
        pixel=[bin * float(side) for side in pixel],
        unit=unit,
        source=source,
    )
    scan |= center_offsets(data.shape, bin)
    arrays = [None if array is None else binned(array, bin) for array in (data, white, black)]
    if white is not None and black is None:
        note(f"{source}: no dark field; the dark signal is taken as 0")
        arrays[2] = np.zeros(arrays[0].shape[1:])
    files = source_files(source, flat, dark, angles)
    stated = {"tube_kvp": tube_kvp, "energy_kev": energy_kev}
    nominal = {key: value for key, value in stated.items() if value is not None}
    remarks = quantized(frames.data) if bin > 1 else ()
    return write_recording(folder, phantom, arrays, scan, nominal, "projections", files, not_checked, remarks)


def write_recording(
    folder: str | Path,
    phantom: str | None,
    arrays: Sequence[np.ndarray | None],
    scan: dict,
    nominal: dict,
    importer: str,
    files: Sequence[Path],
    not_checked: Sequence[str] = (),
    remarks: Sequence[str] = (),
) -> Recording:
    """Write data, white and dark field (None for line integrals) as a recording with one repeat, and load it.

    `remarks` come from `quantized`, applied before values were averaged.
    """
    data, white, dark = arrays
    if remarks:
        nominal = nominal | {"notes": "before pixels were averaged, " + "; ".join(remarks)}
    shown = scan.get("angles_deg", 360 / scan["views_per_rotation"] * np.arange(scan["views"]))
    known = not isinstance(shown, str)
    theta = scan["start_angle_deg"] + scan["direction"] * np.asarray(shown) if known else None

    def write(target: Path) -> None:
        values = data if data.dtype.kind in "ui" and white is not None else data.astype(np.float32)
        write_projections(target / "projections.h5", values, theta, white, dark)

    content = {
        "scan": scan,
        **({"not_checked": list(not_checked)} if not_checked else {}),
        "nominal": nominal,
        "origin": {"importer": importer, **one_checksum(files)},
        "repeats": ["projections.h5"],
    }
    return write_folder(folder, "projections", phantom, content, write)


def _refuse_unused(given: dict, names: Sequence[str], other: str) -> None:
    """Check that options are absent which have no effect beside another one."""
    for name in names:
        if given[name] is not None:
            raise InputError(f"{name} has no effect with {other}; remove one of them")


def check_bin(factor: int, shape: Sequence[int]) -> None:
    """Check that pixels of an array [view, row, column] can be averaged.

    Raises
    ------
    InputError
        If they cannot.
    """
    _, rows, columns = shape
    for count, name in ((columns, "columns"), (rows, "rows"))[: 1 if rows == 1 else 2]:  # a fan beam has one row
        if not 1 <= factor <= count:
            raise InputError(f"--bin {factor}: use 1 to {count}, the number of detector {name}")


def source_files(*given: str | Path | None) -> list[Path]:
    """Return the files among options, with the files in folders."""
    return [path for name in given if name and Path(name).exists() for path in files_of(name)]


def arranged(array: np.ndarray, axes: str | None, source: str | Path) -> np.ndarray:
    """Return an array with the axes view, row and column.

    Raises
    ------
    InputError
        If it is empty, or the letters do not fit its axes.
    """
    if array is None or array.size == 0:
        raise InputError(f"{source}: has no projections; give the measured frames")
    axes = axes or {2: "vc", 3: AXES}.get(array.ndim, "")
    letters = axes.lower()
    if len(letters) != array.ndim or len(set(letters)) != len(letters) or not {"v", "c"} <= set(letters) <= set(AXES):
        raise InputError(
            f"{source}: --axes {axes or 'vrc'} does not fit the shape {array.shape}; name each axis once: v (view), "
            "r (row) and c (column), or v and c"
        )
    array = array[tuple(slice(None, None, -1 if letter.isupper() else None) for letter in axes)]
    if "r" not in letters:
        array, letters = array[..., None], letters + "r"
    return np.ascontiguousarray(array.transpose([letters.index(letter) for letter in AXES]))


def binned(array: np.ndarray, factor: int) -> np.ndarray:
    """Return means over blocks of pixels, float32; pixels of incomplete blocks at the end are dropped."""
    if factor == 1:
        return array
    *views, rows, columns = array.shape
    high = factor if rows >= factor else 1  # a fan beam has one row
    kept = array[..., : rows // high * high, : columns // factor * factor]
    return kept.reshape(*views, rows // high, high, columns // factor, factor).mean(axis=(-3, -1), dtype=np.float32)


def center_offsets(shape: Sequence[int], factor: int, stated_px: Sequence[float] = (0.0, 0.0)) -> dict[str, float]:
    """Return detector offsets along columns and rows, in binned pixels: those stated, and of pixels that are dropped.

    Parameters
    ----------
    shape : sequence of int
        Views, rows and columns before `binned`.
    stated_px : sequence of 2 float
        Offsets along columns and rows, in these pixels.
    """
    found = {}
    for name, count, offset in zip(("column", "row"), shape[:0:-1], stated_px, strict=True):
        high = factor if count >= factor else 1
        if center := (offset - count % high / 2) / high:
            found[f"{name}_offset_px"] = center
    return found


def read_field(
    given: str | None,
    stated: np.ndarray | None,
    name: str,
    shape: tuple[int, ...],
    source: str | Path,
    axes: str | None = None,
) -> np.ndarray | None:
    """Return the mean of flat or dark frames, shape (rows, columns); None if there are none.

    Rows and columns of frames are stored in the order and direction of `axes`, as in the projections. Frames whose
    shape only fits the other order have their rows first.

    Raises
    ------
    InputError
        If a file cannot be read, or frames have another size than the projections.
    """
    _, rows, columns = shape
    axes = axes or AXES
    if given is not None:
        try:
            return np.full((rows, columns), float(given))
        except ValueError:
            found = read_frames(given)
            source, stated = given, getattr(found, name)  # a Data Exchange file may have projections beside its fields
            if stated is None and (found.flat is not None or found.dark is not None):
                raise InputError(f"{given}: has no {name} field; give a file with {name} frames") from None
            stated = found.data if stated is None else stated
    if stated is None:
        return None
    field = np.asarray(stated, np.float64).reshape(-1, *stated.shape[-2:]).mean(axis=0) if stated.ndim > 2 else stated
    if rows == 1 and field.ndim == 2 and field.shape[-1] == columns:
        field = field.mean(axis=0)
    if field.shape == (columns, rows) and (rows == 1 or re.search("c.*r", axes.lower())):
        field = field.T
    if field.size != rows * columns or field.shape[-1] != columns:
        raise InputError(
            f"{source}: the {name} field has shape {np.shape(stated)}, but a projection has {rows} rows and {columns} "
            "columns; give frames of the same detector region"
        )
    field = np.asarray(field, np.float64).reshape(rows, columns)
    return field[:: -1 if "R" in axes else 1, :: -1 if "C" in axes else 1]


def _air(data: np.ndarray, count: int, source: str | Path) -> np.ndarray:
    if not 0 < 2 * count < data.shape[2]:
        raise InputError(f"{source}: --air-columns {count} does not fit {data.shape[2]} columns; give fewer")
    return np.concatenate([data[..., :count], data[..., -count:]], axis=-1).astype(np.float64)


def _angles(given: str | None, frames: Frames, views: int, source: str | Path) -> np.ndarray | str:
    """Return one angle per view, degrees, or UNKNOWN."""
    if given == UNKNOWN:
        return UNKNOWN
    if given is None:
        if frames.angles_deg is None:
            raise InputError(f"{source}: states no view angles; give --angles START,STEP, a file, or unknown")
        return _checked_list(frames.angles_deg, views, source)
    if os.path.isfile(given):
        if Path(given).suffix.lower() not in FORMATS:
            return _checked_list(read_angles(given), views, given)
        found = read_frames(given)
        listed = np.ravel(found.data).astype(float) if found.angles_deg is None else found.angles_deg
        return _checked_list(listed, views, given)
    try:
        start, step = map(float, given.split(","))
    except ValueError:
        raise InputError(
            f"--angles {given}: is neither a file nor START,STEP; give two numbers in degrees, a file, or unknown"
        ) from None
    return check_angles(start + step * np.arange(views), views, f"--angles {given}")


def check_angles(angles: np.ndarray, views: int, where: str | Path) -> np.ndarray:
    """Return the angles if there is one per view and the views differ in direction.

    Raises
    ------
    InputError
        If not.
    """
    if angles.shape != (views,):
        raise InputError(f"{where}: has {angles.size} angles for {views} views; give one angle per view, in degrees")
    if not np.isfinite(angles).all():
        raise InputError(f"{where}: an angle is not finite; give one angle per view, in degrees")
    if views > 1 and np.ptp(np.unwrap(angles, period=360)) == 0:
        raise InputError(
            f"{where}: all views have the angle {angles[0]:g}; give the angle of each view in degrees, or unknown"
        )
    return angles


def _checked_list(angles: np.ndarray, views: int, where: str | Path) -> np.ndarray:
    """Return listed angles if they are plausible in degrees."""
    angles = check_angles(angles, views, where)
    span = np.ptp(angles)
    for radians, name in ((np.pi, "pi"), (2 * np.pi, "2 pi")):
        # The last view repeats the first direction, or lies one step before it.
        if views > 2 and min(abs(span - radians), abs(span * views / (views - 1) - radians)) < RADIANS_TOLERANCE:
            raise InputError(
                f"{where}: the angles span {span:.4g}, about {name}, so they are in radians; convert them to degrees"
            )
    return angles


def read_angles(path: str | Path) -> np.ndarray:
    """Return the angles of a text file, degrees.

    Each line has an angle, or the number of a view and its angle. A single line may list all angles. Comments (#) and
    lines with words are skipped.

    Raises
    ------
    InputError
        If lines have several numbers, the first of which do not count the views. If the file is not UTF-8.
    """
    text, rows = Path(path).read_text(encoding="utf-8-sig", errors="replace"), []
    if "\0" in text:
        raise InputError(f"{path}: is not text in UTF-8 (perhaps in UTF-16); save it in UTF-8")
    for line in text.splitlines():
        words = re.sub("[,;:]", " ", line.partition("#")[0]).split()
        with contextlib.suppress(ValueError):
            rows += [[float(word) for word in words]] if words else []
    if len(rows) == 1:
        return np.array(rows[0])
    width = max(map(len, rows), default=1)
    counted = width == 2 and all(len(row) == 2 and row[0] == rows[0][0] + index for index, row in enumerate(rows))
    if width > 1 and not counted:
        raise InputError(
            f"{path}: has several numbers in a line; give one angle per line, with a decimal point, or the number of "
            "the view and its angle"
        )
    return np.array([row[-1] for row in rows])


def scan_section(
    shape: tuple[int, ...],
    angles_deg: np.ndarray | str,
    *,
    beam: str,
    distances: Sequence[float | None],
    pixel: Sequence[float],
    unit: str,
    source: str | Path,
) -> dict:
    """Return the scan section of recording.yaml.

    A detector on the axis, as some simulators define it, is moved to twice the distance and enlarged: the rays are the
    same.

    Raises
    ------
    InputError
        If a divergent beam has no distances.
    """
    views, rows, columns = shape
    scan: dict = {"trajectory": "circular", "columns": columns, "rows": rows}
    factor = UNITS[unit]
    if beam == PARALLEL:
        scan["beam"] = PARALLEL
    else:
        if None in distances:
            raise InputError(
                f"{source}: a divergent beam needs --source-to-axis and --source-to-detector; give --beam parallel if "
                "the rays are parallel"
            )
        axis, detector = (float(distance) * factor for distance in distances)
        if detector == axis:
            detector, pixel = 2 * axis, [2 * side for side in pixel]
        scan |= {"source_to_isocentre_mm": axis, "source_to_detector_mm": detector}
    scan |= {"column_pitch_mm": float(pixel[0] * factor), "row_pitch_mm": float(pixel[-1] * factor)}
    if unit == ELEMENT:
        scan["length_unit"] = ELEMENT
    return scan | angle_keys(angles_deg, views)


def angle_keys(angles_deg: np.ndarray | str, views: int) -> dict:
    """Return the angles as keys of the scan section: even steps, a list, or UNKNOWN."""
    if isinstance(angles_deg, str) or views < 2:
        return {
            "views": views,
            "views_per_rotation": views,
            "start_angle_deg": 0.0,
            "direction": 1,
            "angles_deg": UNKNOWN,
        }
    start = float(angles_deg[0])
    from_start = np.unwrap(angles_deg, period=360) - start
    step = float(from_start[-1]) / (views - 1) or 360.0
    scan = {
        "views": views,
        "views_per_rotation": abs(round(360 / step, 9)),
        "start_angle_deg": (start + 180) % 360 - 180,
        "direction": 1 if step > 0 else -1,
    }
    if np.abs(from_start - step * np.arange(views)).max() > THETA_TOLERANCE * abs(step):
        scan["angles_deg"] = [round(float(angle), 6) for angle in scan["direction"] * from_start]
    return scan
