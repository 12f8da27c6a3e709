"""Scans of one case by either simulator, written as any other recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from ...base.geometry import Grid
from ...base.streams import Stream, generator
from ...io.files import write_text
from ...io.hdf5 import new_file
from ...io.volumes import Volume, write_nifti
from ...recordings.document import FILE_NAME
from . import gvirtualxray, xcist
from .catalogue import GVXR, XCIST
from .changed_object import changed
from .faults import faulty
from .objects import ScannedObject, imperfect
from .orbits import Orbit
from .readout import read_out
from .reconstruction import images_hu
from .xcist import TARGET_ANGLE_DEG, Acquired, Scan
from .xcist_surfaces import Surfaces

LEAST_READING = 1e-6  # share of the air scan, since the logarithm needs positive values
NOMINAL = {"anode": "W", "anode_angle_deg": TARGET_ANGLE_DEG}  # the tube of all cases
RECONSTRUCTED = {"kernel_pixels": 0.0, "hu_scale": 1.0, "hu_offset": 0.0}  # settings with their neutral values
ENERGY_OF_WATER = {XCIST: xcist.energy_of_water, GVXR: gvirtualxray.energy_of_water}
ATTENUATION = {XCIST: xcist.attenuation_of, GVXR: gvirtualxray.attenuation_of}


def scan_of(orbit: Orbit, photons: float, rotation_ms: float, kev: float, hidden: Mapping) -> Scan:
    """Return the scan on an orbit with the hidden settings."""
    return Scan(**vars(orbit), kev=kev, photons=photons, rotation_ms=rotation_ms, settings=dict(hidden))


def hidden_settings(truth: Mapping) -> dict:
    """Merge the settings of the simulator for all effects and imperfections of a truth."""
    imperfections = truth.get("imperfections", {})
    merged: dict = dict(imperfections.get("settings", {}))
    for effect in truth["effects"]:
        merged |= effect["settings"]
    if "flux_factor" in imperfections:
        merged["flux_factor"] = merged.get("flux_factor", 1.0) * imperfections["flux_factor"]
    return merged


def acquire(
    simulator: str,
    scan: Scan,
    stated: ScannedObject,
    imperfections: Mapping,
    mu_water_per_mm: float,
    repeats: int,
    seed: Stream,
) -> Acquired:
    """Scan an object with its imperfections and hidden changes, and read out the detector.

    Branches of the seed draw the noise, the gains of the pixels and the faults.
    """
    noise, pixels, faults = seed.spawn(3)
    attenuation = ATTENUATION[simulator](scan.kev)
    scanned = changed(imperfect(stated, imperfections, attenuation, mu_water_per_mm), scan.settings)
    if simulator == XCIST:
        taken = xcist.simulate(scan, Surfaces.of(scanned, attenuation, mu_water_per_mm), repeats, noise)
    else:
        taken = gvirtualxray.simulate(scan, scanned, mu_water_per_mm, repeats, noise)
    return read_out(
        faulty(taken, scan, generator(faults)),
        scan.settings,
        (scan.column_pitch_mm, scan.row_pitch_mm),
        scan.duration_s,
        generator(pixels),
    )


def nominal(mu_water_per_mm: float) -> dict:
    """Return the stated settings of the scanner. At the beam energy, published tables give water this attenuation."""
    return NOMINAL | {"energy_kev": round(gvirtualxray.energy_of_water(mu_water_per_mm), 3)}


def write_images(folder: str | Path, name: str, grid: Grid, scan: Scan, taken: Acquired, mu_water: float) -> None:
    """Write recording.yaml and one uncompressed image in HU per repeat, so that all files have the same size."""
    folder = Path(folder)
    kernel, scale, offset = (scan.settings.get(key, neutral) for key, neutral in RECONSTRUCTED.items())
    files = [f"scan{number:02d}.nii" for number in range(1, 1 + len(taken.readings))]
    for file, readings in zip(files, taken.readings, strict=True):
        lines = -np.log(np.maximum(readings, LEAST_READING * taken.air) / taken.air)
        hu = images_hu(lines, scan, grid, mu_water, kernel * grid.spacing[2])
        write_nifti(Volume((hu * scale + offset).astype(np.float32), grid), folder / file)
    content = {"name": name, "kind": "images", "repeats": files, "nominal": nominal(mu_water)}
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)


def write(
    folder: str | Path, name: str, orbit: Orbit, rotation_ms: float, taken: Acquired, mu_water_per_mm: float
) -> None:
    """Write recording.yaml and one HDF5 file per repeat.

    The files do not depend on the hidden effects, and they are uncompressed, so that all have the same size. The writer
    of the importers is not used, since it reads back what it wrote with modules that contain the library's noise
    models.
    """
    folder = Path(folder)
    files = [f"scan{number:02d}.h5" for number in range(1, 1 + len(taken.readings))]
    angles = orbit.start_angle_deg + np.arange(orbit.views) * 360 / orbit.views_per_rotation
    for file, readings in zip(files, taken.readings, strict=True):
        with new_file(folder / file) as stored:
            stored.create_dataset("exchange/data", data=readings).attrs["log"] = False
            stored.create_dataset("exchange/data_white", data=taken.air[None])
            stored.create_dataset("exchange/data_dark", data=np.zeros_like(taken.air)[None])
            stored.create_dataset("exchange/theta", data=angles).attrs["units"] = "degree"
    content = {
        "name": name,
        "kind": "projections",
        "repeats": files,
        "nominal": nominal(mu_water_per_mm),
        "scan": orbit.recorded(rotation_ms),
    }
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)
