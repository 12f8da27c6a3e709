"""Projections on disk: HDF5 in the Data Exchange layout.

A file holds::

    /exchange/data        counts, or line integrals (attribute log = True), [view, row, column]
    /exchange/data_white  mean counts without an object, [1, row, column]      (counts only)
    /exchange/data_dark   counts without X-rays, [1, row, column]              (counts only)
    /exchange/theta       view angles, degrees
    /physics              where effects are switched on: mean signals with and without the object, and the noise's law
    /acquisition          the rest of the scan geometry: attributes in mm, source_z_mm per view, and spots_mm of a focal
                          spot that flies

References
----------
F. De Carlo et al., J. Synchrotron Rad. 21, 1224, 2014.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import h5py
import numpy as np

from ..base.counts import Counts
from ..base.errors import InputError
from ..base.geometry import OrbitGeometry, ScanGeometry, orbit_of
from .files import check_unchanged
from .hdf5 import new_file

# The times are those of all views that follow each other: not stored.
_ARRAYS = ("angles_rad", "source_z_mm", "spots_mm", "view_times")
_SCALARS = [f.name for f in fields(OrbitGeometry) if f.name not in _ARRAYS]
# Cheap and lossless: the bytes of noise do not compress, the zeros above them do.
_COMPRESSION = dict(compression="gzip", compression_opts=1, shuffle=True)


@dataclass(frozen=True)
class Physics:
    """What a file keeps of an acquisition chain.

    Attributes
    ----------
    arrays : dict of str to ndarray
        By name; stored as float32.
    numbers : dict of str to float or tuple of float
        By name.
    """

    arrays: dict[str, np.ndarray]
    numbers: dict[str, float | tuple[float, ...]]


def write_line_integrals(
    path: str | Path, line_integrals: np.ndarray, geometry: ScanGeometry, physics: Physics | None = None
) -> None:
    """Write line integrals.

    Parameters
    ----------
    line_integrals : ndarray, shape (views, rows, columns)
        Dimensionless, stored as float32.
    geometry : ScanGeometry
        As stated: what a reconstruction goes by.
    physics : Physics, optional
        What the acquisition chain made of the scene, where effects are switched on.

    Raises
    ------
    InputError
        If the scan is no circle or helix, or the file cannot be written.
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
    """What `write_line_integrals` kept of an acquisition chain.

    Returns
    -------
    tuple of Physics and OrbitGeometry, or None
        Arrays as float64, and the geometry; None of the baseline.

    Raises
    ------
    InputError
        For a missing, broken or other file.
    """
    with opened(path) as file:
        if "physics" not in file:
            return None
        group = file["physics"]
        arrays = {name: data[...].astype(np.float64) for name, data in group.items()}
        numbers = {name: tuple(map(float, value)) if np.ndim(value) else value for name, value in group.attrs.items()}
        return Physics(arrays, numbers), _geometry(file)


def write_counts(path: str | Path, counts: Counts, geometry: ScanGeometry) -> None:
    """Write one noisy acquisition.

    Parameters
    ----------
    geometry : ScanGeometry
        As stated: what a reconstruction goes by.

    Raises
    ------
    InputError
        If the scan is no circle or helix, or the file cannot be written.
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
    """Line integrals and their geometry.

    Returns
    -------
    line_integrals : ndarray of float32, shape (views, rows, columns)
        Dimensionless.

    Raises
    ------
    InputError
        For a missing, broken or other file.
    """
    with opened(path) as file:
        data = file["exchange/data"]
        if not data.attrs["log"]:
            raise InputError(f"{path}: holds counts, not line integrals (attribute log of /exchange/data is false)")
        return data[...], _geometry(file)


def read_counts(path: str | Path) -> tuple[Counts, OrbitGeometry]:
    """One noisy acquisition and its geometry.

    Returns
    -------
    counts : Counts
        What the detector read.

    Raises
    ------
    InputError
        For a missing, broken or other file.
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
    # Degrees do not read back to the same radians; the reconstruction should see the very angles that were simulated.
    acquisition.create_dataset("angles_rad", data=geometry.angles_rad)
    if geometry.flies:
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


class opened:  # noqa: N801  used like a function, as contextlib.closing is
    """h5py.File for reading, whose failures are InputErrors that name the file.

    Raises
    ------
    InputError
        If the file is missing, incomplete or changed since it was written, or what the block reads is not there.
    """

    def __init__(self, path: str | Path, advice: str = "delete it and run again"):
        self.path, self.advice = Path(path), advice

    def __enter__(self):
        if not self.path.exists():
            raise InputError(f"{self.path}: no such file")
        check_unchanged(self.path, self.advice)
        try:
            self.file = h5py.File(self.path, "r")
        except OSError as error:
            raise InputError(f"{self.path}: not a complete HDF5 file ({error}); {self.advice}") from error
        return self.file

    def __exit__(self, kind, error, _):
        self.file.close()
        if isinstance(error, Exception) and not isinstance(error, InputError):  # h5py raises many types on broken files
            raise InputError(
                f"{self.path}: not a complete projection file ({' '.join(str(error).split())}); {self.advice}"
            ) from error
