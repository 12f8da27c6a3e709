"""Projection files: HDF5 in the Data Exchange layout.

Content of a file::

    /exchange/data        counts, or line integrals (attribute log = True), [view, row, column]
    /exchange/data_white  mean counts without an object, [1, row, column]      (counts only)
    /exchange/data_dark   counts without X-rays, [1, row, column]              (counts only)
    /exchange/theta       view angles, degrees
    /physics              with effects: mean signals with and without the object, and parameters of the noise
    /acquisition          other scan geometry: attributes in mm, source_z_mm per view, spots_mm of a flying focal spot

References
----------
F. De Carlo et al., J. Synchrotron Rad. 21, 1224, 2014.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import h5py
import numpy as np

from ..base.counts import Counts
from ..base.errors import InputError, refusing
from ..base.geometry import OrbitGeometry, ScanGeometry, orbit_of
from .files import check_unchanged
from .hdf5 import new_file

# view_times is not stored: views are successive.
_ARRAYS = ("angles_rad", "source_z_mm", "spots_mm", "view_times")
_SCALARS = [f.name for f in fields(OrbitGeometry) if f.name not in _ARRAYS]
# Fast and lossless: the low bytes of noisy counts do not compress, but their high bytes, which are zero, do.
_COMPRESSION = dict(compression="gzip", compression_opts=1, shuffle=True)


@dataclass(frozen=True)
class Physics:
    """Stored state of an acquisition chain, by name; arrays are stored as float32."""

    arrays: dict[str, np.ndarray]
    numbers: dict[str, float | tuple[float, ...]]


def write_line_integrals(
    path: str | Path, line_integrals: np.ndarray, geometry: ScanGeometry, physics: Physics | None = None
) -> None:
    """Write line integrals.

    Parameters
    ----------
    line_integrals : ndarray, shape (views, rows, columns)
        Stored as float32.
    geometry : ScanGeometry
        Nominal geometry, which reconstructions use.
    physics : Physics, optional
        State of the acquisition chain if effects are switched on.

    Raises
    ------
    InputError
        If the scan is neither circular nor helical, or the file cannot be written.
    """
    with new_file(path) as file:
        data = _write(file, line_integrals.astype(np.float32, copy=False), geometry)
        data.attrs["log"] = True
        if physics is not None:
            group = file.create_group("physics")
            for name, array in physics.arrays.items():
                group.create_dataset(name, data=np.asarray(array, np.float32), **_COMPRESSION)
            group.attrs.update(physics.numbers)


def read_physics(path: str | Path) -> tuple[Physics, OrbitGeometry] | None:
    """Return the stored state of an acquisition chain (float64) and the geometry; None without effects.

    Raises
    ------
    InputError
        If the file is missing, damaged or of another kind.
    """
    with opened(path) as file:
        if "physics" not in file:
            return None
        group = file["physics"]
        arrays = {name: data[...].astype(np.float64) for name, data in group.items()}
        numbers = {name: tuple(map(float, value)) if np.ndim(value) else value for name, value in group.attrs.items()}
        return Physics(arrays, numbers), _geometry(file)


def write_counts(path: str | Path, counts: Counts, geometry: ScanGeometry) -> None:
    """Write one noisy acquisition with its nominal geometry, which reconstructions use.

    Raises
    ------
    InputError
        If the scan is neither circular nor helical, or the file cannot be written.
    """
    with new_file(path) as file:
        data = _write(file, counts.data, geometry)
        data.attrs["log"] = False
        data.attrs["line_integral_scale"] = counts.scale
        frame = (1, geometry.rows, geometry.columns)
        white = np.broadcast_to(counts.white, frame)
        file["exchange"].create_dataset("data_white", data=white, **_COMPRESSION)
        file["exchange"].create_dataset("data_dark", data=np.zeros(frame), **_COMPRESSION)


def read_line_integrals(path: str | Path) -> tuple[np.ndarray, OrbitGeometry]:
    """Return line integrals, float32 of shape (views, rows, columns), and their geometry.

    Raises
    ------
    InputError
        If the file is missing, damaged or of another kind.
    """
    with opened(path) as file:
        data = file["exchange/data"]
        if not data.attrs["log"]:
            raise InputError(f"{path}: holds counts, not line integrals (attribute log of /exchange/data is false)")
        return data[...], _geometry(file)


def read_counts(path: str | Path) -> tuple[Counts, OrbitGeometry]:
    """Return the counts of one noisy acquisition and its geometry.

    Raises
    ------
    InputError
        If the file is missing, damaged or of another kind.
    """
    with opened(path) as file:
        data = file["exchange/data"]
        if data.attrs["log"]:
            raise InputError(f"{path}: holds line integrals, not counts (attribute log of /exchange/data is true)")
        white = file["exchange/data_white"][0]
        white = float(white[0, 0]) if (white == white[0, 0]).all() else white
        return Counts(data[...], white, float(data.attrs["line_integral_scale"])), _geometry(file)


def _write(file, data, geometry):
    geometry = orbit_of(geometry, "a file of projections")
    exchange = file.create_group("exchange")
    dataset = exchange.create_dataset("data", data=data, chunks=(1, *data.shape[1:]), **_COMPRESSION)
    exchange.create_dataset("theta", data=np.rad2deg(geometry.angles_rad)).attrs["units"] = "degree"
    acquisition = file.create_group("acquisition")
    acquisition.create_dataset("source_z_mm", data=geometry.source_z_mm)
    # Degrees do not convert back to exactly the same radians, which the reconstruction must use.
    acquisition.create_dataset("angles_rad", data=geometry.angles_rad)
    if geometry.has_focal_spot_offset:
        acquisition.create_dataset("spots_mm", data=geometry.spots_mm)
    for name in _SCALARS:
        if (value := getattr(geometry, name)) is not None:
            acquisition.attrs[name] = value
    return dataset


def _geometry(file):
    acquisition = file["acquisition"]
    scalars = {name: np.asarray(acquisition.attrs[name]).item() for name in _SCALARS if name in acquisition.attrs}
    spots = {"spots_mm": acquisition["spots_mm"][...]} if "spots_mm" in acquisition else {}
    return OrbitGeometry(
        angles_rad=acquisition["angles_rad"][...], source_z_mm=acquisition["source_z_mm"][...], **spots, **scalars
    )


@contextlib.contextmanager
def opened(path: str | Path, advice: str = "delete it and run again") -> Iterator[h5py.File]:
    """Open an HDF5 file for reading; failures in the block become InputErrors that name the file.

    Raises
    ------
    InputError
        If the file is missing, incomplete or changed, or lacks what the block reads.
    """
    if not Path(path).exists():
        raise InputError(f"{path}: no such file")
    check_unchanged(path, advice)
    with refusing(f"{path}: not a complete HDF5 file", OSError, advice=advice):
        file = h5py.File(path, "r")
    # h5py raises many types of exceptions.
    with file, refusing(f"{path}: not a complete projection file", Exception, advice=advice):
        yield file
