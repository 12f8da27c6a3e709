"""Recordings of projections: HDF5 files in the Data Exchange layout, with counts and flat fields or line integrals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ..base.errors import InputError
from ..base.geometry import OrbitGeometry
from ..base.names import counted
from ..io.exchange import opened
from ..io.volumes import check_fits
from .document import Document
from .provenance import checksums
from .recording import Provenance, Recording, Repeats
from .scan import UNKNOWN, coverage_note, scale_note, scan_geometry, view_time_note

ADVICE = "copy it again from its source"
# {attribute `units` of theta: factor to degrees}. Without it, angles are in degrees, as in the Data Exchange format.
TO_DEGREES = dict.fromkeys(("", "deg", "degs", "degree", "degrees", "°"), 1.0)
TO_DEGREES |= dict.fromkeys(("rad", "rads", "radian", "radians"), 180 / math.pi)
THETA_TOLERANCE = 0.05  # share of the step between views; larger differences mean another scan or other units
LARGEST_LINE_INTEGRAL = 30.0  # exp(-30) is below one photon in any scan, so larger values are counts
BITS_8 = 256  # levels
CLIPPED = 1e-3  # share of values at the largest one, above which they are reported as clipped
LEAST_TRANSMISSION = 1e-3  # of the brightest pixel; less means a white field in another unit
MOST_DEAD = 0.01  # share of pixels, or of counts, without signal; more means wrong, swapped or saturated fields


@dataclass(frozen=True)
class Projections:
    """One acquisition.

    Attributes
    ----------
    data : ndarray, shape (views, rows, columns)
        Line integrals (float32), or counts as stored, in any linear unit.
    white : ndarray, shape (rows, columns), or None
        Mean counts without an object; None with line integrals.
    dark : ndarray, shape (rows, columns), or None
        Mean counts without X-rays; None with line integrals.
    """

    data: np.ndarray
    white: np.ndarray | None
    dark: np.ndarray | None

    @property
    def log(self) -> bool:
        """Whether the data are line integrals."""
        return self.white is None

    @property
    def dead(self) -> np.ndarray:
        """Pixels without signal, shape (rows, columns): the white field does not exceed the dark field."""
        if self.log:
            return np.zeros(self.data.shape[1:], bool)
        return self.white <= self.dark

    def line_integrals(self, smallest_transmission: float) -> np.ndarray:
        """Return -ln((data - dark) / (white - dark)), float32, NaN at dead pixels, or line integrals as stored.

        Parameters
        ----------
        smallest_transmission : float
            Lower limit of the transmission, which also replaces zero and negative values.

        Raises
        ------
        InputError
            If `smallest_transmission` is not between 0 and 1.
        """
        if self.log:
            return self.data
        if not 0 < smallest_transmission < 1:
            raise InputError(f"smallest transmission {smallest_transmission}: use a number between 0 and 1")
        signal = np.where(self.dead, np.nan, self.white - self.dark).astype(np.float32)
        transmission = (self.data - self.dark.astype(np.float32)) / signal
        return -np.log(np.maximum(transmission, np.float32(smallest_transmission)))


@dataclass(frozen=True)
class ProjectionsRecording(Recording):
    """Repeated acquisitions in one known geometry; `log` is True for line integrals."""

    repeats: Repeats[Projections]
    held_out: Repeats[Projections]
    log: bool


def load_projections(document: Document) -> ProjectionsRecording:
    """Read and check every acquisition once.

    Raises
    ------
    InputError
        If a file does not match recording.yaml, or counts and line integrals are mixed.
    """
    scan = document.content["scan"]
    geometry = scan_geometry(scan, str(document.path), document.content.get("not_checked", ()))
    notes, logs = [], {}
    repeated = geometry.views - math.ceil(geometry.views_per_rotation)
    if repeated > 0 and geometry.feed_per_rotation_mm == 0:
        notes.append(f"{counted(repeated, 'view')} beyond the first rotation, along the same directions")
    notes += filter(None, (scale_note(scan), coverage_note(scan, geometry.angles_rad), view_time_note(scan)))
    for path in (*document.repeats, *document.held_out):
        acquisition = read_acquisition(path, geometry)
        logs[path] = acquisition.log
        if dead := int(acquisition.dead.sum()):
            notes.append(f"{document.relative(path)}: {counted(dead, 'dead pixel')} (white field not above dark field)")
        if not acquisition.log and (share := np.mean(acquisition.data <= acquisition.dark)) > MOST_DEAD:
            notes.append(f"{document.relative(path)}: {100 * share:.0f} % of the counts do not exceed the dark field")
        notes += (f"{document.relative(path)}: {text}" for text in quantized(acquisition.data))
        if not _has_theta(path) and scan.get("angles_deg") != UNKNOWN:
            notes.append(f"{document.relative(path)}: no /exchange/theta; angles are taken from {document.path.name}")
    first = document.repeats[0]
    for path, log in logs.items():
        if log != logs[first]:
            names = {True: "line integrals", False: "counts"}
            raise InputError(
                f"{path}: contains {names[log]}, but {first.name} contains {names[logs[first]]}; convert all files to "
                "one of them"
            )
    provenance = Provenance(document.content["origin"], checksums(document))
    repeats = Repeats(document.repeats, lambda path: read_acquisition(path, geometry))
    held_out = Repeats(document.held_out, lambda path: read_acquisition(path, geometry))
    return ProjectionsRecording(document, provenance, geometry, tuple(notes), repeats, held_out, logs[first])


def quantized(data: np.ndarray) -> list[str]:
    """Return remarks on whole numbers with 8 bits, and on values that were clipped: the largest one piles up."""
    if data.dtype.kind not in "ui":
        return []
    found, largest = [], int(data.max())
    if data.dtype.itemsize == 1:
        found.append(f"values have 8 bits: steps between {BITS_8} levels hide noise and small differences")
    count, below = (np.count_nonzero(data == value) for value in (largest, largest - 1))
    if count > max(CLIPPED * data.size, below):
        found.append(f"{100 * count / data.size:.2g} % of the values are {largest}, the largest one: they were clipped")
    return found


def read_acquisition(path: Path, geometry: OrbitGeometry) -> Projections:
    """Read one acquisition of a known geometry.

    Raises
    ------
    InputError
        If the file is missing or damaged, its shape or angles differ from the geometry, fields are missing, or values
        are implausible.
    """
    with opened(path, ADVICE) as file:
        if not isinstance(file.get("exchange/data"), h5py.Dataset):
            raise InputError(f"{path}: has no /exchange/data; use HDF5 in the Data Exchange layout")
        data = file["exchange/data"]
        _check_shape(path, data, geometry)
        _check_theta(path, file, geometry)
        if _is_log(path, data.attrs.get("log", False)):
            values = data[...].astype(np.float32, copy=False)
            _check_line_integrals(path, values)
            return Projections(values, None, None)
        if float(data.attrs.get("line_integral_scale", 1.0)) != 1.0:
            raise InputError(
                f"{path}: contains counts of noise.model astra, which no detector measures; simulate with noise.model "
                "physical"
            )
        white, dark = (_field(path, file, name, data.shape[1:]) for name in ("data_white", "data_dark"))
        acquisition = Projections(data[...], white, dark)
    _check_counts(path, acquisition)
    return acquisition


def _is_log(path: Path, value) -> bool:
    flags = {"true": True, "1": True, "false": False, "0": False}
    text = (value.decode() if isinstance(value, bytes) else str(value)).lower()  # some writers store flags as text
    if text not in flags:
        raise InputError(f"{path}: the attribute log of /exchange/data is {text!r}; set it to true or false")
    return flags[text]


def _check_shape(path: Path, data: h5py.Dataset, geometry: OrbitGeometry) -> None:
    if data.dtype.kind not in "uif":
        raise InputError(f"{path}: /exchange/data has type {data.dtype}; store numbers")
    if data.ndim != 3:
        raise InputError(
            f"{path}: /exchange/data has {data.ndim} dimensions; store view, row, column (a fan beam has one row)"
        )
    check_fits(data.size * max(data.dtype.itemsize, 4), path)
    for name, present, expected in zip(
        ("views", "rows", "columns"), data.shape, (geometry.views, geometry.rows, geometry.columns), strict=True
    ):
        if present != expected:
            raise InputError(
                f"{path}: has {present} {name}, but recording.yaml says scan.{name} {expected}; correct one of them"
            )


def _has_theta(path: Path) -> bool:
    with opened(path, ADVICE) as file:
        return "exchange/theta" in file


def _check_theta(path: Path, file: h5py.File, geometry: OrbitGeometry) -> None:
    if "exchange/theta" not in file:
        return
    theta = theta_degrees(path, file["exchange/theta"])
    if theta.shape != (geometry.views,):
        raise InputError(
            f"{path}: /exchange/theta has {theta.size} angles for {geometry.views} views; store one angle per view"
        )
    difference = (theta - np.rad2deg(geometry.angles_rad) + 180) % 360 - 180
    worst = int(np.abs(difference).argmax())
    if not np.abs(difference).max() <= THETA_TOLERANCE * 360 / geometry.views_per_rotation:  # `not`: refuses NaN
        raise InputError(
            f"{path}: /exchange/theta of view {worst} is {theta[worst]:g} degrees, but recording.yaml gives "
            f"{np.rad2deg(geometry.angles_rad[worst]):g}; correct start_angle_deg, direction, views_per_rotation or "
            "the units"
        )


def theta_degrees(path: Path, data: h5py.Dataset) -> np.ndarray:
    """Return the angles of a dataset in degrees, shape (angles,). The attribute units may be radians."""
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in "uif":
        kind = f"type {data.dtype}" if isinstance(data, h5py.Dataset) else "the type group"
        raise InputError(f"{path}: {data.name} has {kind}; store one angle per view, in degrees")
    if data.shape is None or max(data.shape, default=1) != data.size:
        raise InputError(
            f"{path}: {data.name} has the shape {data.shape}; store one angle per view, as one row or column"
        )
    units = data.attrs.get("units", "")
    units = np.ravel(units)[0] if np.size(units) == 1 else str(units)  # some writers store text in arrays of one
    unit = (units.decode(errors="replace") if isinstance(units, bytes) else str(units)).strip().lower().rstrip(".")
    if unit not in TO_DEGREES:
        raise InputError(f"{path}: the attribute units of {data.name} is {unit!r}; use degrees or radians")
    return np.asarray(data[...], float).ravel() * TO_DEGREES[unit]


def _field(path: Path, file: h5py.File, name: str, frame: tuple[int, ...]) -> np.ndarray:
    if f"exchange/{name}" not in file:
        raise InputError(
            f"{path}: has no /exchange/{name}, which counts need; for line integrals, set the attribute log of "
            "/exchange/data to true"
        )
    check_fits(8 * file[f"exchange/{name}"].size, path)
    field = np.asarray(file[f"exchange/{name}"][...], np.float64)
    if field.size == 0:
        raise InputError(f"{path}: /exchange/{name} has no frames; store the measured field, or zeros")
    if field.ndim == 3:
        field = field.mean(axis=0)
    if field.shape != frame:
        raise InputError(
            f"{path}: /exchange/{name} has shape {field.shape}, but the projections have {frame} (rows, columns); "
            "correct one of them"
        )
    if not np.isfinite(field).all():
        raise InputError(f"{path}: /exchange/{name} contains NaN or infinite values; replace them")
    return field


def _check_line_integrals(path: Path, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        bad = np.count_nonzero(~np.isfinite(values))
        raise InputError(f"{path}: {bad} line integrals are NaN or infinite; replace them")
    if values.max() > LARGEST_LINE_INTEGRAL:
        raise InputError(
            f"{path}: line integrals reach {values.max():g}; if these are counts, remove the attribute log of "
            "/exchange/data (import: omit --log)"
        )
    if values.mean(dtype=np.float64) < 0:
        raise InputError(f"{path}: the mean line integral is negative; store -ln(I/I0), not ln(I/I0)")


def _check_counts(path: Path, acquisition: Projections) -> None:
    if not np.isfinite(acquisition.data).all():
        bad = np.count_nonzero(~np.isfinite(acquisition.data))
        raise InputError(f"{path}: {bad} counts are NaN or infinite; replace them")
    if (share := acquisition.dead.mean()) > MOST_DEAD:
        raise InputError(
            f"{path}: the white field does not exceed the dark field in {100 * share:.0f} % of the pixels; check "
            "whether data_white and data_dark are swapped"
        )
    if np.median(acquisition.data) > 2 * np.median(acquisition.white):
        raise InputError(f"{path}: the median count is over twice the white field; scale both to the same exposure")
    largest, white = (
        np.max(acquisition.data.max(axis=0) - acquisition.dark),
        np.median(acquisition.white - acquisition.dark),
    )
    if largest < LEAST_TRANSMISSION * white:
        raise InputError(
            f"{path}: the largest count is {largest:g} above the dark field, the white field {white:g}; scale both "
            "to the same exposure (white field of normalized data: 1)"
        )
