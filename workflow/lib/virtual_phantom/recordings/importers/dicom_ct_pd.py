"""Import of a folder of DICOM-CT-PD files, with one or several views each, as a recording of projections.

Only listed attributes are copied from the headers: no patient data get into the recording. Redundant attributes are
compared with each other: sizes, angles and positions, field of view, focal spot mode and its shifts.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom
from pydicom.dataset import Dataset
from pydicom.multival import MultiValue
from pydicom.tag import Tag
from pydicom.uid import CTImageStorage, ImplicitVRLittleEndian

from ...base.errors import InputError, reading
from ...base.geometry import SPOT_KEYS
from ...base.vectors import CYLINDRICAL, FLAT
from ...io import dicom_ct_pd as pd
from ...io.volumes import check_fits
from ...phantom.dicom_files import UnusedFiles, add_not_dicom, files_in, split_dicom
from ...phantom.regions import whole_number
from ..recording import Recording
from . import one_checksum, write_folder, write_projections

FRAMES, SHARED_FRAMES = (0x5200, 0x9230), (0x5200, 0x9229)  # elements of single frames, and of all frames
# Elements that are constant in one scan, in words.
SAME = {
    (0x0020, 0x000E): "series",
    pd.ROWS: "detector rows",
    pd.COLUMNS: "detector columns",
    pd.WIDTH: "width of an element",
    pd.HEIGHT: "height of an element",
    pd.SHAPE: "shape of the detector",
    pd.FOCAL_RADIUS: "distance of the focal center from the axis",
    pd.DISTANCE: "distance from the focal center to the detector",
    pd.CENTRAL: "central element",
    pd.SPOT_MODE: "focal spot mode",
    pd.VIEWS_PER_TURN: "views per rotation",
    pd.SOURCES: "number of sources",
    pd.TRAJECTORY: "trajectory",
    pd.BEAM: "beam geometry",
    pd.LOGARITHM: "logarithm",
    **{tag: f"correction of {name.replace('_', ' ')}" for name, tag in pd.CORRECTIONS.items()},
    (0x0018, 0x0060): "tube voltage",
    (0x0018, 0x1150): "rotation time",
}
# Elements of DICOM: rescaling of pixels, and field of view.
SLOPE, INTERCEPT, FIELD = (0x0028, 0x1053), (0x0028, 0x1052), (0x0018, 0x0090)
# Elements that must be above 0.
POSITIVE = {pd.ROWS, pd.COLUMNS, pd.WIDTH, pd.HEIGHT, pd.FOCAL_RADIUS, pd.DISTANCE, pd.VIEWS_PER_TURN, SLOPE}
OPTIONAL = {(0x0018, 0x0060), (0x0018, 0x1150), (0x0020, 0x000E), pd.SOURCES, *pd.CORRECTIONS.values()}
STEP_TOLERANCE = 0.25  # share of the step between views; larger deviations mean missing or foreign views
POSITION_TOLERANCE_MM = 0.02  # rounding of focal spot positions, and of heights of a helix
FARTHEST_SPOT_MM, FARTHEST_SPOT_RAD = 50.0, 0.05  # of a flying focal spot from the focal center
FIELD_TOLERANCE = 0.02  # relative difference between the fields of view of header and detector
# Number of views after which a flying focal spot returns, by mode.
PERIODS = {"FFSNONE": 1, "FFSZ": 2, "FFSXY": 2, "FFSXYZ": 4}
# Mean line integral of the outermost columns above which the object is truncated: 2 mm of water.
CUT_OFF, EDGE_COLUMNS = 0.04, 3


@dataclass(frozen=True)
class View:
    """One view of a file.

    Attributes
    ----------
    number : int
        Instance number, or number of the frame.
    headers : tuple of Dataset
        Data sets that are searched for elements, in this order.
    frame : int
        Index in the file's pixels.
    """

    path: Path
    number: int
    headers: tuple[Dataset, ...]
    frame: int


def import_dicom_ct_pd(
    source: str | Path, folder: str | Path, phantom: str | None = None, swapped_shifts: bool = False
) -> Recording:
    """Write a recording of projections (line integrals) and load it.

    Parameters
    ----------
    source : str or Path
        Folder with the files of one scan.
    swapped_shifts : bool, optional
        Whether the files have the focal spot's shifts (7033,100B) and (7033,100C) swapped.

    Raises
    ------
    InputError
        If there are no files, files belong to several scans, views are missing, or headers contradict each other, the
        detector or the object.
    """
    source = Path(source)
    views = _read(source)
    first = views[0]
    common = _common(views)
    rows, columns, transposed = _sizes(first, common)
    positions = _positions(views)
    spots = _spots(source, common, positions, swapped_shifts)
    scan = _scan(source, common, positions, spots, rows, columns)
    if diameter := _value(first, FIELD):
        _check_shape(first.path, scan, diameter)
    lines = _lines(views, rows, columns, transposed)
    _check_field(source, lines)

    def write(target: Path) -> None:
        steps = scan["direction"] * 360 / scan["views_per_rotation"] * np.arange(len(views))
        write_projections(target / "projections.h5", lines, scan["start_angle_deg"] + steps, chunks=(1, rows, columns))

    content = {
        "scan": scan,
        "corrected": [name for name, tag in pd.CORRECTIONS.items() if common.get(tag) == "YES"],
        "nominal": _nominal(first, common, views),
        "origin": {"importer": "dicom-ct-pd", **one_checksum({view.path for view in views})},
        "repeats": ["projections.h5"],
    }
    return write_folder(folder, "projections", phantom, content, write)


def _read(source: Path) -> list[View]:
    """Return the views in their order, without pixels."""
    if not source.is_dir():
        raise InputError(f"{source}: no such folder; use one with the DICOM-CT-PD files of a scan")
    views: list[View] = []
    unused = UnusedFiles()
    candidates, others = split_dicom(files_in(source), unused)
    for path in candidates:
        with reading(path, "DICOM"):
            header = pydicom.dcmread(path, stop_before_pixels=True, force=True)
            kind = header.get("SOPClassUID") or header.file_meta.get("MediaStorageSOPClassUID")
        if pd.ROWS not in header and FRAMES not in header:
            if kind in (None, CTImageStorage):
                raise InputError(f"{path}: has no detector rows (7029,1010); use DICOM-CT-PD files only")
            unused.add(path, f"SOP class is {kind.name if kind.is_valid else 'not readable'}, not a projection")
            continue
        views += _views(path, header)
    add_not_dicom(others, {view.path for view in views}, unused)
    if not views:
        details = "; ".join(unused.lines(source))
        raise InputError(
            f"{source}: has no DICOM file of projections{f' ({details})' if details else ''}; use a folder with the "
            "DICOM-CT-PD files of a scan"
        )
    unused.report(source)
    views.sort(key=lambda view: view.number)
    for view, following in zip(views, views[1:], strict=False):
        if view.number == following.number:
            raise InputError(f"{following.path}: view {view.number} is also in {view.path.name}; remove one of them")
    for view, following in zip(views, views[1:], strict=False):
        if following.number != view.number + 1:
            raise InputError(
                f"{source}: view {view.number + 1} is missing, between {view.path.name} and {following.path.name}; "
                "copy all files of the scan"
            )
    if len(views) < 2:
        raise InputError(f"{source}: has only one view; copy all files of the scan")
    return views


def _views(path: Path, header: Dataset) -> Iterator[View]:
    if FRAMES not in header:
        yield View(path, _instance_number(path, header), (header,), 0)
        return
    shared = tuple(header[SHARED_FRAMES].value) if SHARED_FRAMES in header else ()
    number = _instance_number(path, header) if header.get("InstanceNumber") else 1
    start = (number - 1) * len(header[FRAMES].value)
    for frame, item in enumerate(header[FRAMES].value):
        yield View(path, start + frame + 1, (item, *shared, header), frame)


def _instance_number(path: Path, header: Dataset) -> int:
    if (number := whole_number(header, "InstanceNumber")) is None:
        raise InputError(f"{path}: has no valid InstanceNumber (0020,0013), the number of the view; export it again")
    return number


def _value(view: View, tag: tuple[int, int]):
    """Return the value of an element, whatever value representation it was written with; None if it is absent."""
    for header in view.headers:
        if (element := _element(header, tag, header is not view.headers[-1])) is not None:
            value = _plain(view.path, tag, element)
            if value is not None and not isinstance(value, str) and tag != pd.PHOTONS:
                _check_numbers(view.path, tag, value)
            return value
    return None


def _check_numbers(path: Path, tag: tuple[int, int], value) -> None:
    values, count = value if isinstance(value, tuple) else (value,), 2 if tag == pd.CENTRAL else 1
    if len(values) != count or not all(map(math.isfinite, values)) or (tag in POSITIVE and min(values) <= 0):
        kind = "a number above 0" if tag in POSITIVE else "a finite number" if count == 1 else f"{count} finite numbers"
        shown = ", ".join(f"{number:g}" for number in values)
        raise InputError(f"{path}: {SAME.get(tag, 'element')} {Tag(tag)} is {shown}, not {kind}; export the scan again")


def _element(header: Dataset, tag: tuple[int, int], deep: bool):
    if tag in header:
        return header[tag]
    for element in header if deep else ():
        if element.VR == "SQ":
            for item in element.value:
                if (found := _element(item, tag, deep)) is not None:
                    return found
    return None


def _plain(path: Path, tag: tuple[int, int], element):
    value = element.value
    with reading(path, "DICOM-CT-PD"):
        if isinstance(value, bytes) and tag in pd.FLOATS:
            value = list(struct.unpack(f"<{len(value) // 4}f", value))
        elif isinstance(value, bytes) and tag in pd.INTEGERS:
            value = list(struct.unpack(f"<{len(value) // 2}H", value))
        elif isinstance(value, bytes):
            value = value.decode("ascii").strip("\0 ")
        if isinstance(value, list | tuple | MultiValue):
            value = tuple(map(float, value))
            value = value[0] if len(value) == 1 and tag not in (pd.CENTRAL, pd.PHOTONS) else value
        if tag in pd.INTEGERS and value is not None:
            return int(value)
        if isinstance(value, tuple) or value is None:
            return value
        return value.strip().upper() if isinstance(value, str) else float(value)


def _needed(view: View, tag: tuple[int, int]):
    if (value := _value(view, tag)) is None or value == "":
        raise InputError(f"{view.path}: has no {SAME.get(tag, 'element')} {Tag(tag)}; is it DICOM-CT-PD?")
    return value


def _common(views: list[View]) -> dict:
    """Return the elements that all views share; InputError for a view of another scan."""
    first = views[0]
    common = {tag: (_value if tag in OPTIONAL else _needed)(first, tag) for tag in SAME}
    for view in views[1:]:
        if view.path == first.path and len(view.headers) == 1:
            continue
        for tag, words in SAME.items():
            here = _value(view, tag)
            if here != common[tag]:
                values = "differs" if words == "series" else f"is {here}, not {common[tag]}"
                raise InputError(
                    f"{view.path}: belongs to another scan than {first.path.name}, because its {words} {Tag(tag)} "
                    f"{values}; use a folder with one scan"
                )
    not_lines = ", so the values are not line integrals; export logarithmic data"
    for tag, accepted, name, advice in (
        (pd.LOGARITHM, ["YES"], "logarithm (7039,1009)", not_lines),
        (pd.BEAM, ["FANBEAM"], "beam (7037,100A)", "; only FANBEAM is supported"),
        (pd.SOURCES, [None, 0, 1], "number of sources (7033,1061)", "; only one is supported"),
        (pd.SHAPE, ["FLAT", "CYLINDRICAL"], "detector (7029,100B)", "; only FLAT and CYLINDRICAL are supported"),
    ):
        if common[tag] not in accepted:
            raise InputError(f"{first.path}: the {name} is {common[tag]}{advice}")
    return common


def _sizes(first: View, common: dict) -> tuple[int, int, bool]:
    """Return detector rows and columns, and whether pixels are stored column by column."""
    rows, columns = common[pd.ROWS], common[pd.COLUMNS]
    header = first.headers[-1]
    stored = int(header.get("Rows") or 0), int(header.get("Columns") or 0)
    if stored not in ((columns, rows), (rows, columns)):
        raise InputError(
            f"{first.path}: has {stored[0]} x {stored[1]} pixels (0028,0010 and 0011), but {rows} detector rows and "
            f"{columns} columns (7029,1010 and 1011); export the scan again"
        )
    if rows > columns:
        raise InputError(
            f"{first.path}: {rows} detector rows and {columns} columns (7029,1010 and 1011) look swapped, as the fan "
            "is wider than the cone; correct them"
        )
    return rows, columns, stored == (columns, rows)


def _positions(views: list[View]) -> dict[str, np.ndarray]:
    """Return, for all views, the position of the focal center and of the focal spot relative to it."""
    tags = {"angle": pd.FOCAL_ANGLE, "z": pd.FOCAL_Z}
    shifts = {"spot_angle": pd.SPOT_ANGLE, "spot_z": pd.SPOT_Z, "spot_radius": pd.SPOT_RADIUS}
    found = {name: np.array([_needed(view, tag) for view in views], float) for name, tag in tags.items()}
    found |= {name: np.array([_value(view, tag) or 0.0 for view in views], float) for name, tag in shifts.items()}
    return found


def _spots(source: Path, common: dict, positions: dict, swapped: bool) -> list[dict] | None:
    """Return the focal spot's positions as in recording.yaml; None if it stays at the focal center."""
    mode, radius = common[pd.SPOT_MODE], common[pd.FOCAL_RADIUS]
    if mode not in PERIODS:
        raise InputError(f"{source}: the focal spot mode (7033,100E) is {mode}; supported are {', '.join(PERIODS)}")
    angle, z, away = positions["spot_angle"], positions["spot_z"], positions["spot_radius"]
    if swapped:
        angle, z = z, angle
    along, outward = -(radius + away) * np.sin(angle), (radius + away) * np.cos(angle) - radius
    moved = np.stack([along, outward, z], axis=1)
    far = np.abs(angle).max() > FARTHEST_SPOT_RAD
    deflected = {"plane": np.ptp(along) > POSITION_TOLERANCE_MM, "z": np.ptp(z) > POSITION_TOLERANCE_MM}
    expected = {"plane": "XY" in mode, "z": mode.endswith("Z")}
    if far or (deflected != expected and deflected == {"plane": expected["z"], "z": expected["plane"]}):
        advice = "import without --swapped-shifts" if swapped else "import with --swapped-shifts if they are"
        raise InputError(
            f"{source}: the focal spot's shifts, {np.abs(angle).max():.3g} rad and {np.abs(z).max():.3g} mm at most, "
            f"do not fit its mode {mode}: (7033,100B) and (7033,100C) look swapped; {advice}"
        )
    if np.abs(moved).max() > FARTHEST_SPOT_MM:
        raise InputError(
            f"{source}: the focal spot is {np.abs(moved).max():.3g} mm from the focal center; check that all lengths "
            "are in mm"
        )
    if deflected != expected:
        raise InputError(
            f"{source}: the focal spot mode is {mode} (7033,100E), but its shifts vary by {np.ptp(along):.3g} mm in "
            f"the plane and {np.ptp(z):.3g} mm along z; correct one of them"
        )
    period = PERIODS[mode]
    spots = np.array([moved[phase::period].mean(axis=0) for phase in range(period)])
    off = np.abs(moved - spots[np.arange(len(moved)) % period]).max(axis=1)
    if off.max() > POSITION_TOLERANCE_MM:
        raise InputError(
            f"{source}: the focal spot of view {int(off.argmax()) + 1} is {off.max():.3g} mm from its position in mode "
            f"{mode}; check that no view is missing and that all belong to one scan"
        )
    spots = np.where(np.abs(spots) < POSITION_TOLERANCE_MM / 100, 0.0, spots)
    if not spots.any():
        return None
    spots = np.repeat(spots, 2, axis=0) if len(spots) == 1 else spots
    return [dict(zip(SPOT_KEYS, map(float, spot), strict=True)) for spot in spots]


def _scan(source: Path, common: dict, positions: dict, spots, rows: int, columns: int) -> dict:
    turn = common[pd.VIEWS_PER_TURN]
    angles = np.unwrap(positions["angle"])
    count = len(angles)
    step = (angles[-1] - angles[0]) / (count - 1)
    steps = np.diff(angles)
    if abs(abs(np.median(steps)) * turn / (2 * math.pi) - 1) > STEP_TOLERANCE:
        raise InputError(
            f"{source}: views are {math.degrees(abs(np.median(steps))):.4g} degrees apart, but {turn} views per "
            f"rotation (7033,1013) would be {360 / turn:.4g}; copy all files of the scan"
        )
    odd = np.abs(steps - np.median(steps)) > STEP_TOLERANCE * abs(np.median(steps))
    if odd.any():
        view = int(odd.argmax())
        raise InputError(
            f"{source}: from view {view + 1} to {view + 2} the angle changes by {math.degrees(steps[view]):.4g} "
            f"degrees instead of {math.degrees(np.median(steps)):.4g}; copy all files of the scan, and no others"
        )
    views_per_rotation = 2 * math.pi / abs(step)
    if abs(views_per_rotation - turn) < 1e-3 * turn and abs(views_per_rotation - turn) * count / turn < 0.5:
        views_per_rotation = float(turn)
    heights = positions["z"]
    slope, start = np.polyfit(np.arange(count), heights, 1)
    helical = common[pd.TRAJECTORY] == "HELICAL"
    away = np.abs(heights - (start + slope * np.arange(count) if helical else heights.mean()))
    if away.max() > POSITION_TOLERANCE_MM * (10 if helical else 1):
        raise InputError(
            f"{source}: the trajectory (7037,1009) is {common[pd.TRAJECTORY]}, but view {int(away.argmax()) + 1} is "
            f"{away.max():.3g} mm off along z (7031,1002); correct one of them"
        )
    feed = float(slope * views_per_rotation)
    scan = {
        "trajectory": "helical" if helical else "circular",
        "detector": common[pd.SHAPE].lower(),
        "source_to_isocentre_mm": common[pd.FOCAL_RADIUS],
        "source_to_detector_mm": common[pd.DISTANCE],
        **({} if spots is None else {"flying_focal_spot": spots}),
        "columns": columns,
        "rows": rows,
        "column_pitch_mm": common[pd.WIDTH],
        "row_pitch_mm": common[pd.HEIGHT],
        "column_offset_px": (columns + 1) / 2 - common[pd.CENTRAL][0],
        "row_offset_px": common[pd.CENTRAL][1] - (rows + 1) / 2,
        "views": count,
        "views_per_rotation": views_per_rotation,
        "start_angle_deg": math.degrees(float(angles[0] % (2 * math.pi))),
        "direction": 1 if step > 0 else -1,
        # The isocenter is placed in the middle of the scan: the table position has no meaning here.
        **({"table_feed_mm": feed, "start_z_mm": float(-slope * (count - 1) / 2)} if helical else {}),
    }
    if time := common[(0x0018, 0x1150)]:
        scan["rotation_time_ms"] = time
    return scan


def _check_field(source: Path, lines: np.ndarray) -> None:
    edges = np.concatenate([lines[..., :EDGE_COLUMNS], lines[..., -EDGE_COLUMNS:]], axis=-1).mean(axis=1)
    worst = max(float(np.median(edges[..., :EDGE_COLUMNS])), float(np.median(edges[..., EDGE_COLUMNS:])))
    if worst > CUT_OFF:
        raise InputError(
            f"{source}: line integrals in the outermost columns are {worst:.2g} in most views, so the object is larger "
            "than the field of view; use a scan of an object that fits"
        )


def _check_shape(path: Path, scan: dict, diameter_mm: float) -> None:
    """Compare the field of view stated in the header, mm, with the fields of a flat and of a cylindrical detector.

    Raises
    ------
    InputError
        If it is the field of view of the other detector shape.
    """
    half = scan["columns"] / 2 - abs(scan["column_offset_px"])
    fan = half * scan["column_pitch_mm"] / scan["source_to_detector_mm"]
    fields = {
        shape: 2 * scan["source_to_isocentre_mm"] * math.sin(angle)
        for shape, angle in ((FLAT, math.atan(fan)), (CYLINDRICAL, min(fan, math.pi / 2)))
    }
    off = {shape: abs(field / diameter_mm - 1) for shape, field in fields.items()}
    other = CYLINDRICAL if scan["detector"] == FLAT else FLAT
    if off[other] < FIELD_TOLERANCE < off[scan["detector"]]:
        raise InputError(
            f"{path}: the field of view (0018,0090) is {diameter_mm:.0f} mm, but a {scan['detector']} detector "
            f"(7029,100B) would see {fields[scan['detector']]:.0f} mm; check whether it is {other}"
        )


def _lines(views: list[View], rows: int, columns: int, transposed: bool) -> np.ndarray:
    """Return line integrals, [view, row, column], rows along +z."""
    check_fits(4 * len(views) * rows * columns, views[0].path)
    lines = np.empty((len(views), rows, columns), np.float32)
    shape, opened, frames = (columns, rows) if transposed else (rows, columns), None, None
    for index, view in enumerate(views):
        if view.path != opened:
            with reading(view.path, "DICOM-CT-PD"):
                dataset = pydicom.dcmread(view.path, force=True)
                syntax = dataset.file_meta.get("TransferSyntaxUID", ImplicitVRLittleEndian)
                if syntax.is_compressed or not syntax.is_little_endian:
                    raise InputError(
                        f"{view.path}: its pixels are stored as {syntax.name}; convert the files to Explicit VR Little "
                        "Endian (gdcmconv --raw)"
                    )
                kind = {0: "<u2", 1: "<i2"}[int(dataset.get("PixelRepresentation") or 0)]
                if int(dataset.BitsAllocated) != 16:
                    raise ValueError
                frames, opened = np.frombuffer(dataset.PixelData, kind).reshape(-1, *shape), view.path
        with reading(view.path, "DICOM-CT-PD"):
            slope, intercept = (_needed(view, tag) for tag in (SLOPE, INTERCEPT))
            image = frames[view.frame] * slope + intercept
        lines[index] = (image.T if transposed else image)[::-1]
    return lines


def _nominal(first: View, common: dict, views: list[View]) -> dict:
    header = first.headers[-1]
    found = {}
    for key, name in (("manufacturer", "Manufacturer"), ("model", "ManufacturerModelName")):
        if text := str(header.get(name) or ""):
            found[key] = text[:128]
    if common[(0x0018, 0x0060)]:
        found["tube_kvp"] = common[(0x0018, 0x0060)]
    currents = [value for view in views if (value := _value(view, (0x0018, 0x1151)))]
    if currents:
        found["tube_current_ma"] = float(np.mean(currents))
    if pitch := _value(first, (0x0018, 0x9311)):
        found["pitch"] = pitch
    photons = [np.mean(value) for view in views if (value := _value(view, pd.PHOTONS)) is not None]
    if photons and np.mean(photons) > 0:
        found["photons"] = float(np.mean(photons))
    return found
