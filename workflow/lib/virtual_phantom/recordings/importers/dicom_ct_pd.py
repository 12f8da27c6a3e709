"""A folder of DICOM-CT-PD files, one view each or several, to a recording of projections.

Nothing but what is asked for by name leaves the headers: no patient data get into the recording. Headers are checked
against each other, as these data say some things twice: sizes, angles and positions, the field of view, the focal
spot's mode and its shifts.
"""

from __future__ import annotations

import hashlib
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
from pydicom.uid import CTImageStorage

from ...base.errors import InputError, reading
from ...base.geometry import SPOT_KEYS
from ...base.vectors import CYLINDRICAL, FLAT
from ...io import dicom_ct_pd as pd
from ...io.files import sha256
from ...io.hdf5 import new_file
from ...io.volumes import check_fits
from ...phantom.dicom_files import Unused, add_others, dicom_among, files_in
from ..recording import Recording
from . import write_folder

FRAMES, SHARED_FRAMES = (0x5200, 0x9230), (0x5200, 0x9229)  # elements: what each frame holds, and all of them
# What one scan has only one of, in words.
SAME = {
    (0x0020, 0x000E): "series",
    pd.ROWS: "detector rows",
    pd.COLUMNS: "detector columns",
    pd.WIDTH: "width of an element",
    pd.HEIGHT: "height of an element",
    pd.SHAPE: "shape of the detector",
    pd.FOCAL_RADIUS: "distance of the focal centre from the axis",
    pd.DISTANCE: "distance from the focal centre to the detector",
    pd.CENTRAL: "central element",
    pd.SPOT_MODE: "mode of the focal spot",
    pd.VIEWS_PER_TURN: "views per rotation",
    pd.SOURCES: "number of sources",
    pd.TRAJECTORY: "trajectory",
    pd.BEAM: "geometry of the beam",
    pd.LOGARITHM: "logarithm",
    **{tag: f"correction of {name.replace('_', ' ')}" for name, tag in pd.CORRECTIONS.items()},
    (0x0018, 0x0060): "tube voltage",
    (0x0018, 0x1150): "rotation time",
}
OPTIONAL = {(0x0018, 0x0060), (0x0018, 0x1150), (0x0020, 0x000E), pd.SOURCES, *pd.CORRECTIONS.values()}
STEP_TOLERANCE = 0.25  # of the step from view to view: by more, a view is missing or another
PLACE_TOLERANCE_MM = 0.02  # by which places of one focal spot, and heights of a helix, may be rounded
FARTHEST_SPOT_MM, FARTHEST_SPOT_RAD = 50.0, 0.05  # of a flying spot from the focal centre
FIELD_TOLERANCE = 0.02  # of the field of view, between that in the header and that of the detector
# Views after which the focal spot is where it was, by its mode.
PERIODS = {"FFSNONE": 1, "FFSZ": 2, "FFSXY": 2, "FFSXYZ": 4}
# Line integral behind the outermost columns, on average, from which on an object reaches beyond them: 2 mm of water.
CUT_OFF, EDGE_COLUMNS = 0.04, 3


@dataclass(frozen=True)
class View:
    """One view of a file.

    Attributes
    ----------
    number : int
        Instance number, or that of the frame.
    headers : tuple of Dataset
        Where elements are looked for, one after another.
    frame : int
        Of the file's pixels.
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
        A folder with the files of one scan.
    folder : str or Path
        The recording's, which is made.
    phantom : str, optional
        What was scanned, for recording.yaml.
    swapped_shifts : bool, optional
        The files have the focal spot's shifts (7033,100B) and (7033,100C) swapped.

    Raises
    ------
    InputError
        If there is no such file, files are of several scans, views are missing, or headers contradict each other, the
        detector or the object.
    """
    source = Path(source)
    views = _read(source)
    first = views[0]
    common = _common(views)
    rows, columns, transposed = _sizes(first, common)
    places = _places(views)
    scan = _scan(source, common, places, _spots(source, common, places, swapped_shifts), rows, columns)
    if diameter := _value(first, (0x0018, 0x0090)):
        _check_shape(first.path, scan, diameter)
    lines = _lines(views, rows, columns, transposed)
    _check_field(source, lines)

    def write(target: Path) -> None:
        with new_file(target / "projections.h5") as file:
            stored = file.create_dataset("exchange/data", data=lines, chunks=(1, rows, columns), compression="gzip")
            stored.attrs["log"] = True
            steps = scan["direction"] * 360 / scan["views_per_rotation"] * np.arange(len(views))
            file.create_dataset("exchange/theta", data=scan["start_angle_deg"] + steps).attrs["units"] = "degree"

    content = {
        "kind": "projections",
        **({"phantom": phantom} if phantom else {}),
        "scan": scan,
        "corrected": [name for name, tag in pd.CORRECTIONS.items() if common.get(tag) == "YES"],
        "nominal": _nominal(first, common, views),
        "origin": {"importer": "dicom-ct-pd", **_checksum({view.path for view in views})},
        "repeats": ["projections.h5"],
    }
    return write_folder(folder, content, write)


def _checksum(paths: set[Path]) -> dict:
    """One checksum of all files, of which there are thousands: sha256sum * | cut -d' ' -f1 | sort | sha256sum."""
    lines = "".join(f"{digest}\n" for digest in sorted(map(sha256, paths)))
    return {"files": len(paths), "sha256": [hashlib.sha256(lines.encode()).hexdigest()]}


def _read(source: Path) -> list[View]:
    """Views in their order, without pixels."""
    if not source.is_dir():
        raise InputError(f"{source}: no such folder; give one with the DICOM-CT-PD files of a scan")
    views: list[View] = []
    unused = Unused()
    candidates, others = dicom_among(files_in(source), unused)
    for path in candidates:
        with reading(path, "DICOM"):
            header = pydicom.dcmread(path, stop_before_pixels=True, force=True)
            kind = header.get("SOPClassUID") or header.file_meta.get("MediaStorageSOPClassUID")
        if pd.ROWS not in header and FRAMES not in header:
            if kind in (None, CTImageStorage):
                raise InputError(f"{path}: has no detector rows (7029,1010); is it DICOM-CT-PD?")
            unused.add(path, f"SOP class is {kind.name if kind.is_valid else 'not readable'}, and no projection")
            continue
        views += _views(path, header)
    add_others(others, {view.path for view in views}, unused)
    if not views:
        there = "; ".join(unused.lines(source))
        raise InputError(
            f"{source}: holds no DICOM file{f' of projections ({there})' if there else ''}; give a folder with the "
            "DICOM-CT-PD files of a scan"
        )
    unused.report(source)
    views.sort(key=lambda view: view.number)
    for one, following in zip(views, views[1:], strict=False):
        if one.number == following.number:
            raise InputError(f"{following.path}: view {one.number} is in {one.path.name} too; leave one of them out")
    for one, following in zip(views, views[1:], strict=False):
        if following.number != one.number + 1:
            raise InputError(
                f"{source}: view {one.number + 1} is missing, between {one.path.name} and {following.path.name}; copy "
                "all files of the scan"
            )
    if len(views) < 2:
        raise InputError(f"{source}: holds one view; give a folder with all files of a scan")
    return views


def _views(path: Path, header: Dataset) -> Iterator[View]:
    if FRAMES not in header:
        yield View(path, int(header.get("InstanceNumber") or 0), (header,), 0)
        return
    shared = tuple(header[SHARED_FRAMES].value) if SHARED_FRAMES in header else ()
    start = (int(header.get("InstanceNumber") or 1) - 1) * len(header[FRAMES].value)
    for frame, item in enumerate(header[FRAMES].value):
        yield View(path, start + frame + 1, (item, *shared, header), frame)


def _value(view: View, tag: tuple[int, int]):
    """What an element says, of whatever representation it was written with; None if it is not there."""
    for header in view.headers:
        if (element := _element(header, tag, header is not view.headers[-1])) is not None:
            return _plain(view.path, tag, element)
    return None


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
        elif isinstance(value, bytes) and tag in pd.WHOLE:
            value = list(struct.unpack(f"<{len(value) // 2}H", value))
        elif isinstance(value, bytes):
            value = value.decode("ascii").strip("\0 ")
        if isinstance(value, list | tuple | MultiValue):
            value = tuple(float(one) for one in value)
            value = value[0] if len(value) == 1 and tag not in (pd.CENTRAL, pd.PHOTONS) else value
        if tag in pd.WHOLE and value is not None:
            return int(value)
        return value if isinstance(value, tuple) or value is None else _number(value)


def _number(value):
    return value.strip().upper() if isinstance(value, str) else float(value)


def _needed(view: View, tag: tuple[int, int]):
    if (value := _value(view, tag)) is None or value == "":
        raise InputError(f"{view.path}: has no {SAME.get(tag, 'element')} {Tag(tag)}; is it DICOM-CT-PD?")
    return value


def _common(views: list[View]) -> dict:
    """What all views share; InputError for one of another scan."""
    first = views[0]
    common = {tag: (_value if tag in OPTIONAL else _needed)(first, tag) for tag in SAME}
    for view in views[1:]:
        if view.path == first.path and len(view.headers) == 1:
            continue
        for tag, words in SAME.items():
            here = _value(view, tag)
            if here != common[tag]:
                said = "" if words == "series" else f": {here} here, {common[tag]} there"
                raise InputError(
                    f"{view.path}: is of another scan than {first.path.name} by its {words} {Tag(tag)}{said}; put one "
                    "scan into a folder"
                )
    if common[pd.LOGARITHM] != "YES":
        raise InputError(f"{first.path}: its values are not line integrals (7039,1009 is {common[pd.LOGARITHM]})")
    if common[pd.BEAM] != "FANBEAM":
        raise InputError(f"{first.path}: the beam is {common[pd.BEAM]} (7037,100A); only FANBEAM is known")
    if (common[pd.SOURCES] or 1) != 1:
        raise InputError(
            f"{first.path}: the scan has {common[pd.SOURCES]} sources (7033,1061); only one can be simulated"
        )
    if common[pd.SHAPE] not in (FLAT.upper(), CYLINDRICAL.upper()):
        raise InputError(
            f"{first.path}: the detector is {common[pd.SHAPE]} (7029,100B); only flat and cylindrical ones are known"
        )
    return common


def _sizes(first: View, common: dict) -> tuple[int, int, bool]:
    """Rows and columns of the detector, and whether pixels hold one column after another."""
    rows, columns = common[pd.ROWS], common[pd.COLUMNS]
    header = first.headers[-1]
    stored = int(header.get("Rows") or 0), int(header.get("Columns") or 0)
    if stored not in ((columns, rows), (rows, columns)):
        raise InputError(
            f"{first.path}: holds {stored[0]} x {stored[1]} pixels (0028,0010 and 0011), its detector has {rows} rows "
            f"and {columns} columns (7029,1010 and 1011)"
        )
    if rows > columns:
        raise InputError(
            f"{first.path}: {rows} detector rows and {columns} columns (7029,1010 and 1011) look swapped: the fan is "
            "wider than the cone"
        )
    return rows, columns, stored == (columns, rows)


def _places(views: list[View]) -> dict[str, np.ndarray]:
    """Of all views, by name: where the focal centre is, and the spot from there."""
    tags = {"angle": pd.FOCAL_ANGLE, "z": pd.FOCAL_Z}
    shifts = {"spot_angle": pd.SPOT_ANGLE, "spot_z": pd.SPOT_Z, "spot_radius": pd.SPOT_RADIUS}
    found = {name: np.array([_needed(view, tag) for view in views], float) for name, tag in tags.items()}
    found |= {name: np.array([_value(view, tag) or 0.0 for view in views], float) for name, tag in shifts.items()}
    for name, values in found.items():
        if not np.isfinite(values).all():
            worst = views[int(np.argmin(np.isfinite(values)))]
            raise InputError(f"{worst.path}: {name.replace('_', ' ')} of the view is not a finite number")
    return found


def _spots(source: Path, common: dict, places: dict, swapped: bool) -> list[dict] | None:
    """The focal spot's places as recording.yaml has them; None if it rests at the focal centre."""
    mode, radius = common[pd.SPOT_MODE], common[pd.FOCAL_RADIUS]
    if mode not in PERIODS:
        raise InputError(f"{source}: the focal spot's mode {mode} (7033,100E) is none of {', '.join(PERIODS)}")
    angle, z, away = places["spot_angle"], places["spot_z"], places["spot_radius"]
    if swapped:
        angle, z = z, angle
    along, outward = -(radius + away) * np.sin(angle), (radius + away) * np.cos(angle) - radius
    moved = np.stack([along, outward, z], axis=1)
    far = np.abs(angle).max() > FARTHEST_SPOT_RAD
    flies = {"plane": np.ptp(along) > PLACE_TOLERANCE_MM, "z": np.ptp(z) > PLACE_TOLERANCE_MM}
    expected = {"plane": "XY" in mode, "z": mode.endswith("Z")}
    if far or (flies != expected and flies == {"plane": expected["z"], "z": expected["plane"]}):
        advice = "leave --swapped-shifts out" if swapped else "import with --swapped-shifts if they are"
        raise InputError(
            f"{source}: the focal spot's shifts, {np.abs(angle).max():.3g} rad and {np.abs(z).max():.3g} mm at most, "
            f"do not fit its mode {mode}: (7033,100B) and (7033,100C) look swapped; {advice}"
        )
    if np.abs(moved).max() > FARTHEST_SPOT_MM:
        raise InputError(f"{source}: the focal spot is {np.abs(moved).max():.3g} mm from the focal centre; in mm?")
    if flies != expected:
        raise InputError(
            f"{source}: the focal spot's mode is {mode} (7033,100E), but its shifts vary by {np.ptp(along):.3g} mm in "
            f"the plane and {np.ptp(z):.3g} mm along z; correct one of them"
        )
    period = PERIODS[mode]
    spots = np.array([moved[phase::period].mean(axis=0) for phase in range(period)])
    off = np.abs(moved - spots[np.arange(len(moved)) % period]).max(axis=1)
    if off.max() > PLACE_TOLERANCE_MM:
        raise InputError(
            f"{source}: view {int(off.argmax()) + 1} has another focal spot than {mode} puts there, "
            f"{off.max():.3g} mm beside it: views of several orders are mixed, or one is missing"
        )
    spots = np.where(np.abs(spots) < PLACE_TOLERANCE_MM / 100, 0.0, spots)
    if not spots.any():
        return None
    spots = np.repeat(spots, 2, axis=0) if len(spots) == 1 else spots
    return [dict(zip(SPOT_KEYS, map(float, spot), strict=True)) for spot in spots]


def _scan(source: Path, common: dict, places: dict, spots, rows: int, columns: int) -> dict:
    turn = common[pd.VIEWS_PER_TURN]
    angles = np.unwrap(places["angle"])
    count = len(angles)
    step = (angles[-1] - angles[0]) / (count - 1)
    steps = np.diff(angles)
    if abs(abs(np.median(steps)) * turn / (2 * math.pi) - 1) > STEP_TOLERANCE:
        raise InputError(
            f"{source}: views are {math.degrees(abs(np.median(steps))):.4g} degrees apart, {turn} per rotation "
            f"(7033,1013) would be {360 / turn:.4g}; are views missing?"
        )
    odd = np.abs(steps - np.median(steps)) > STEP_TOLERANCE * abs(np.median(steps))
    if odd.any():
        view = int(odd.argmax())
        raise InputError(
            f"{source}: from view {view + 1} to {view + 2} the angle changes by {math.degrees(steps[view]):.4g} "
            f"degrees instead of {math.degrees(np.median(steps)):.4g}; is a view missing, or of another scan?"
        )
    views_per_rotation = 2 * math.pi / abs(step)
    if abs(views_per_rotation - turn) < 1e-3 * turn and abs(views_per_rotation - turn) * count / turn < 0.5:
        views_per_rotation = float(turn)
    heights = places["z"]
    slope, start = np.polyfit(np.arange(count), heights, 1)
    helical = common[pd.TRAJECTORY] == "HELICAL"
    away = np.abs(heights - (start + slope * np.arange(count) if helical else heights.mean()))
    if away.max() > PLACE_TOLERANCE_MM * (10 if helical else 1):
        raise InputError(
            f"{source}: the scan is {common[pd.TRAJECTORY]} (7037,1009), but view {int(away.argmax()) + 1} lies "
            f"{away.max():.3g} mm off along z (7031,1002)"
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
        # The isocentre is put into the middle of the scan: where the table is there means nothing here.
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
            f"{source}: line integrals behind the outermost columns are {worst:.2g} in most views: the object is "
            "larger than the field of view, and what lies outside cannot be simulated"
        )


def _check_shape(path: Path, scan: dict, diameter_mm: float) -> None:
    """Hold the field of view that a header states against that of the detector, flat and cylindrical.

    Parameters
    ----------
    path : Path
        What messages name.
    scan : dict
        As recording.yaml has it.
    diameter_mm : float
        Of the field of view (0018,0090), mm.

    Raises
    ------
    InputError
        If the field is that of the other shape.
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
            f"{path}: a {scan['detector']} detector (7029,100B) would see {fields[scan['detector']]:.0f} mm, the field "
            f"of view is {diameter_mm:.0f} mm (0018,0090), as of a {other} one; correct one of them"
        )


def _lines(views: list[View], rows: int, columns: int, transposed: bool) -> np.ndarray:
    """Line integrals, [view, row, column], rows along +z."""
    check_fits(4 * len(views) * rows * columns, views[0].path)
    lines = np.empty((len(views), rows, columns), np.float32)
    shape, opened, frames = (columns, rows) if transposed else (rows, columns), None, None
    for place, view in enumerate(views):
        if view.path != opened:
            with reading(view.path, "DICOM-CT-PD"):
                dataset = pydicom.dcmread(view.path, force=True)
                kind = {0: "<u2", 1: "<i2"}[int(dataset.get("PixelRepresentation") or 0)]
                if int(dataset.BitsAllocated) != 16:
                    raise ValueError
                frames, opened = np.frombuffer(dataset.PixelData, kind).reshape(-1, *shape), view.path
        with reading(view.path, "DICOM-CT-PD"):
            slope, intercept = (_needed(view, tag) for tag in ((0x0028, 0x1053), (0x0028, 0x1052)))
            image = frames[view.frame] * slope + intercept
        lines[place] = (image.T if transposed else image)[::-1]
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
