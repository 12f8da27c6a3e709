"""Projections on disk: HDF5 in the Data Exchange layout (F. De Carlo et al., J. Synchrotron Rad. 21, 1224, 2014).

/exchange/data        counts, or line integrals (attribute log = True), [view, row, column]
/exchange/data_white  mean counts without an object, [1, row, column]      (counts only)
/exchange/data_dark   counts without X-rays, [1, row, column]              (counts only)
/exchange/theta       view angles, degrees
/physics              where effects are switched on: mean signals with and without the object, and the noise's law
/acquisition          the rest of the scan geometry: attributes in mm, and source_z_mm per view
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from .errors import InputError
from .files import check_unchanged
from .geometry import ScanGeometry
from .hdf5 import new_file
from .physics.noise import Counts

if TYPE_CHECKING:
    from .physics.chain import State

STATE_ARRAYS = ("signal", "noise", "air", "gain", "dark")
STATE_NUMBERS = ("photons", "electronic", "neighbours", "lag", "dark_air")
_ARRAYS = ("angles_rad", "source_z_mm", "view_times")  # the last of all views that follow each other: not stored
_SCALARS = [f.name for f in fields(ScanGeometry) if f.name not in _ARRAYS]
# Cheap and lossless: the bytes of noise do not compress, the zeros above them do.
_COMPRESSION = dict(compression="gzip", compression_opts=1, shuffle=True)


def write_line_integrals(
    path: str | Path, line_integrals: np.ndarray, geometry: ScanGeometry, state: State | None = None
) -> None:
    """Write line integrals [view, row, column] (dimensionless, stored as float32).

    geometry   as stated: what a reconstruction goes by
    state      what the acquisition chain made of the scene, where effects are switched on: noise is drawn from it
    """
    with new_file(path) as file:
        data = _write(file, line_integrals.astype(np.float32, copy=False), geometry)
        data.attrs["log"] = True
        if state is not None:
            group = file.create_group("physics")
            for name in STATE_ARRAYS:
                if (array := getattr(state, name)) is not None and (name != "noise" or array is not state.signal):
                    group.create_dataset(name, data=np.asarray(array, np.float32), **_COMPRESSION)
            for name in STATE_NUMBERS:
                group.attrs[name] = getattr(state, name)


def read_state(path: str | Path) -> State | None:
    """What `write_line_integrals` kept of the acquisition chain; None of the baseline."""
    with opened(path) as file:
        if "physics" not in file:
            return None
        from .physics.chain import State

        group = file["physics"]
        arrays = {name: group[name][...].astype(np.float64) for name in STATE_ARRAYS if name in group}
        numbers = {name: group.attrs[name] for name in STATE_NUMBERS}
        for name in ("neighbours", "lag"):
            numbers[name] = tuple(float(value) for value in numbers[name])
        return State(_geometry(file), **arrays, **numbers)


def write_counts(path: str | Path, counts: Counts, geometry: ScanGeometry) -> None:
    """Write one noisy acquisition."""
    with new_file(path) as file:
        data = _write(file, counts.data, geometry)
        data.attrs["log"] = False
        data.attrs["line_integral_scale"] = counts.scale
        frame = (1, geometry.rows, geometry.columns)
        white = np.broadcast_to(counts.white, frame)
        file["exchange"].create_dataset("data_white", data=white, **_COMPRESSION)
        file["exchange"].create_dataset("data_dark", data=np.zeros(frame), **_COMPRESSION)


def read_line_integrals(path: str | Path) -> tuple[np.ndarray, ScanGeometry]:
    """Line integrals [view, row, column] and their geometry. Raises InputError for a missing, broken or other file."""
    with opened(path) as file:
        data = file["exchange/data"]
        if not data.attrs["log"]:
            raise InputError(f"{path}: holds counts, not line integrals (attribute log of /exchange/data is false)")
        return data[...], _geometry(file)


def read_counts(path: str | Path) -> tuple[Counts, ScanGeometry]:
    """One noisy acquisition and its geometry. Raises InputError for a missing, broken or other file."""
    with opened(path) as file:
        data = file["exchange/data"]
        if data.attrs["log"]:
            raise InputError(f"{path}: holds line integrals, not counts (attribute log of /exchange/data is true)")
        white = file["exchange/data_white"][0]
        white = float(white[0, 0]) if (white == white[0, 0]).all() else white
        return Counts(data[...], white, float(data.attrs["line_integral_scale"])), _geometry(file)


def _write(file, data, geometry):
    exchange = file.create_group("exchange")
    dataset = exchange.create_dataset("data", data=data, chunks=(1, *data.shape[1:]), **_COMPRESSION)
    exchange.create_dataset("theta", data=np.rad2deg(geometry.angles_rad)).attrs["units"] = "degree"
    acquisition = file.create_group("acquisition")
    acquisition.create_dataset("source_z_mm", data=geometry.source_z_mm)
    # Degrees do not read back to the same radians; the reconstruction should see the very angles that were simulated.
    acquisition.create_dataset("angles_rad", data=geometry.angles_rad)
    for name in _SCALARS:
        if (value := getattr(geometry, name)) is not None:
            acquisition.attrs[name] = value
    return dataset


def _geometry(file):
    acquisition = file["acquisition"]
    scalars = {name: acquisition.attrs[name].item() for name in _SCALARS if name in acquisition.attrs}
    return ScanGeometry(
        angles_rad=acquisition["angles_rad"][...], source_z_mm=acquisition["source_z_mm"][...], **scalars
    )


class opened:  # noqa: N801  used like a function, as contextlib.closing is
    """h5py.File for reading, whose failures are InputErrors that name the file and end in `advice`."""

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
