"""Recordings of projections: HDF5 in the Data Exchange layout, counts with their fields or line integrals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ..base.errors import InputError
from ..base.geometry import OrbitGeometry
from ..base.words import counted
from ..io.exchange import opened
from ..io.volumes import check_fits
from .document import Document
from .provenance import checksums
from .recording import Provenance, Recording, Repeats
from .scan import scan_geometry, view_time_note

ADVICE = "copy it again from where it was made"
# By the attribute units of theta; without it, angles are in degrees, as the Data Exchange format has them.
TO_DEGREES = dict.fromkeys(("", "deg", "degs", "degree", "degrees", "°"), 1.0)
TO_DEGREES |= dict.fromkeys(("rad", "rads", "radian", "radians"), 180 / math.pi)
THETA_TOLERANCE = 0.05  # of the step between views: more is another scan, or other units
LARGEST_LINE_INTEGRAL = 30.0  # exp(-30) is no photon of any scan: what is above are counts
MOST_DEAD = 0.01  # share of pixels without signal; more means that fields are swapped or saturated


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
        """True for line integrals."""
        return self.white is None

    @property
    def dead(self) -> np.ndarray:
        """Pixels that measure nothing, shape (rows, columns): where the white field does not exceed the dark one."""
        if self.log:
            return np.zeros(self.data.shape[1:], bool)
        return self.white <= self.dark

    def line_integrals(self, smallest_transmission: float) -> np.ndarray:
        """-ln((data - dark) / (white - dark)). Data that are line integrals already come back as they are.

        Parameters
        ----------
        smallest_transmission : float
            What lower transmissions, zero and negative ones among them, are read as.

        Returns
        -------
        ndarray of float32, shape (views, rows, columns)
            NaN at dead pixels.

        Raises
        ------
        InputError
            If `smallest_transmission` is not between 0 and 1.
        """
        if self.log:
            return self.data
        if not 0 < smallest_transmission < 1:
            raise InputError(f"smallest transmission {smallest_transmission}: must be over 0 and under 1")
        signal = np.where(self.dead, np.nan, self.white - self.dark).astype(np.float32)
        transmission = (self.data - self.dark.astype(np.float32)) / signal
        return -np.log(np.maximum(transmission, np.float32(smallest_transmission)))


@dataclass(frozen=True)
class ProjectionsRecording(Recording):
    """Repeated acquisitions in one known geometry.

    Attributes
    ----------
    log : bool
        True for line integrals.
    """

    repeats: Repeats[Projections]
    held_out: Repeats[Projections]
    log: bool


def load_projections(document: Document) -> ProjectionsRecording:
    """Read every acquisition once.

    Raises
    ------
    InputError
        If any is not what recording.yaml says.
    """
    geometry = scan_geometry(document.content["scan"], str(document.path))
    notes, logs = [], {}
    again = geometry.views - math.ceil(geometry.views_per_rotation)
    if again > 0 and geometry.feed_per_rotation_mm == 0:
        notes.append(f"{counted(again, 'view')} along directions of the first turn again")
    if words := view_time_note(document.content["scan"]):
        notes.append(words)
    for path in (*document.repeats, *document.held_out):
        acquisition = read_acquisition(path, geometry)
        logs[path] = acquisition.log
        if dead := int(acquisition.dead.sum()):
            notes.append(f"{document.relative(path)}: {counted(dead, 'dead pixel')} (white field not above dark field)")
        if not _has_theta(path):
            notes.append(f"{document.relative(path)}: no /exchange/theta; angles are those of {document.path.name}")
    first = document.repeats[0]
    for path, log in logs.items():
        if log != logs[first]:
            words = {True: "line integrals", False: "counts"}
            raise InputError(f"{path}: holds {words[log]}, {first.name} {words[logs[first]]}; bring all to one of them")
    provenance = Provenance(document.content["origin"], checksums(document))
    repeats = Repeats(document.repeats, lambda path: read_acquisition(path, geometry))
    held_out = Repeats(document.held_out, lambda path: read_acquisition(path, geometry))
    return ProjectionsRecording(document, provenance, geometry, tuple(notes), repeats, held_out, logs[first])


def read_acquisition(path: Path, geometry: OrbitGeometry) -> Projections:
    """Read one acquisition of a known geometry.

    Raises
    ------
    InputError
        If the file is missing, truncated or another; if views, rows, columns or angles are not the geometry's; if
        counts lack their white or dark field; if values are not finite, or not what the attribute log says.
    """
    with opened(path, ADVICE) as file:
        if not isinstance(file.get("exchange/data"), h5py.Dataset):
            raise InputError(f"{path}: has no /exchange/data; give HDF5 in the Data Exchange layout")
        data = file["exchange/data"]
        _check_shape(path, data, geometry)
        _check_theta(path, file, geometry)
        if _is_log(path, data.attrs.get("log", False)):
            values = data[...].astype(np.float32, copy=False)
            _check_line_integrals(path, values)
            return Projections(values, None, None)
        if float(data.attrs.get("line_integral_scale", 1.0)) != 1.0:
            raise InputError(
                f"{path}: holds counts of noise.model astra, which no detector reads; simulate with physical"
            )
        white, dark = (_field(path, file, name, data.shape[1:]) for name in ("data_white", "data_dark"))
        acquisition = Projections(data[...], white, dark)
    _check_counts(path, acquisition)
    return acquisition


def _is_log(path: Path, value) -> bool:
    words = {"true": True, "1": True, "false": False, "0": False}
    word = (value.decode() if isinstance(value, bytes) else str(value)).lower()  # some writers store flags as text
    if word not in words:
        raise InputError(f"{path}: the attribute log of /exchange/data is {word!r}; set it to true or false")
    return words[word]


def _check_shape(path: Path, data: h5py.Dataset, geometry: OrbitGeometry) -> None:
    if data.dtype.kind not in "uif":
        raise InputError(f"{path}: /exchange/data holds {data.dtype}, not numbers")
    if data.ndim != 3:
        raise InputError(
            f"{path}: /exchange/data has {data.ndim} dimensions; give view, row, column (a fan beam has one row)"
        )
    check_fits(data.size * max(data.dtype.itemsize, 4), path)
    for name, here, expected in zip(
        ("views", "rows", "columns"), data.shape, (geometry.views, geometry.rows, geometry.columns), strict=True
    ):
        if here != expected:
            raise InputError(f"{path}: holds {here} {name}, recording.yaml says {expected}; correct one of them")


def _has_theta(path: Path) -> bool:
    with opened(path, ADVICE) as file:
        return "exchange/theta" in file


def _check_theta(path: Path, file: h5py.File, geometry: OrbitGeometry) -> None:
    if "exchange/theta" not in file:
        return
    theta = _theta(path, file["exchange/theta"])
    if theta.shape != (geometry.views,):
        raise InputError(f"{path}: /exchange/theta holds {theta.size} angles for {geometry.views} views")
    off = (theta - np.rad2deg(geometry.angles_rad) + 180) % 360 - 180
    worst = int(np.abs(off).argmax())
    if not np.abs(off).max() <= THETA_TOLERANCE * 360 / geometry.views_per_rotation:  # not: NaN is refused too
        raise InputError(
            f"{path}: /exchange/theta of view {worst} is {theta[worst]:g}, recording.yaml makes it "
            f"{np.rad2deg(geometry.angles_rad[worst]):g} degrees; correct start, direction, views_per_rotation or units"
        )


def _theta(path: Path, data: h5py.Dataset) -> np.ndarray:
    """Angles in degrees, shape (angles,), of a dataset in degrees or, by its attribute units, in radians."""
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in "uif":
        held = data.dtype if isinstance(data, h5py.Dataset) else "a group"
        raise InputError(f"{path}: /exchange/theta holds {held}, not numbers; store one angle per view, in degrees")
    if data.shape is None or max(data.shape, default=1) != data.size:
        raise InputError(
            f"{path}: /exchange/theta has the shape {data.shape}; store one angle per view, as one row or column"
        )
    units = data.attrs.get("units", "")
    units = np.ravel(units)[0] if np.size(units) == 1 else str(units)  # some writers store text in arrays of one
    word = (units.decode(errors="replace") if isinstance(units, bytes) else str(units)).strip().lower().rstrip(".")
    if word not in TO_DEGREES:
        raise InputError(f"{path}: the attribute units of /exchange/theta is {word!r}; state degrees or radians")
    return np.asarray(data[...], float).ravel() * TO_DEGREES[word]


def _field(path: Path, file: h5py.File, name: str, frame: tuple[int, ...]) -> np.ndarray:
    if f"exchange/{name}" not in file:
        raise InputError(
            f"{path}: has no /exchange/{name}, which counts need; line integrals need the attribute log = true on "
            "/exchange/data"
        )
    check_fits(8 * file[f"exchange/{name}"].size, path)
    field = np.asarray(file[f"exchange/{name}"][...], np.float64)
    if field.ndim == 3:
        field = field.mean(axis=0)
    if field.shape != frame:
        raise InputError(f"{path}: /exchange/{name} is {field.shape}, the projections {frame} (rows, columns)")
    if not np.isfinite(field).all():
        raise InputError(f"{path}: /exchange/{name} holds NaN or infinite values")
    return field


def _check_line_integrals(path: Path, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        bad = np.count_nonzero(~np.isfinite(values))
        raise InputError(f"{path}: {bad} line integrals are NaN or infinite; repair them")
    if values.max() > LARGEST_LINE_INTEGRAL:
        raise InputError(f"{path}: line integrals reach {values.max():g}; if they are counts, drop the attribute log")
    if values.mean(dtype=np.float64) < 0:
        raise InputError(f"{path}: line integrals are negative on the whole; store -ln(I/I0), not ln(I/I0)")


def _check_counts(path: Path, acquisition: Projections) -> None:
    if not np.isfinite(acquisition.data).all():
        bad = np.count_nonzero(~np.isfinite(acquisition.data))
        raise InputError(f"{path}: {bad} counts are NaN or infinite; repair them")
    if (share := acquisition.dead.mean()) > MOST_DEAD:
        raise InputError(
            f"{path}: the white field is not above the dark one in {100 * share:.0f} % of pixels; swapped?"
        )
    if np.median(acquisition.data) > 2 * np.median(acquisition.white):
        raise InputError(f"{path}: counts exceed twice the white field; bring both to the same exposure")
