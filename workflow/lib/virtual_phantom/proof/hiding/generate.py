"""Scan of one case by XCIST, written as any other recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from ...base.geometry import grid_of
from ...base.proof_settings import ProofScan
from ...base.streams import Stream, generator
from ...io.files import write_text
from ...io.hdf5 import new_file
from ...io.volumes import Volume, write_nifti
from ...recordings.document import FILE_NAME
from .changed_object import changed
from .faults import faulty
from .objects import Object
from .phantoms import materials
from .readout import read_out
from .reconstruction import images_hu
from .xcist import TARGET_ANGLE_DEG, Acquired, Scan, simulate

LEAST_READING = 1e-6  # share of the air scan, since the logarithm needs positive values
NOMINAL = {"anode": "W", "anode_angle_deg": TARGET_ANGLE_DEG}  # the tube of all cases
RECONSTRUCTED = {"kernel_pixels": 0.0, "hu_scale": 1.0, "hu_offset": 0.0}  # settings with their neutral values


def scan_section(
    scanned_object: Object,
    settings: ProofScan,
    views: int,
    photons: float,
    rotation_ms: float,
    kev: float,
    hidden: Mapping,
) -> Scan:
    """Return the scan for XCIST, from the section proof.scan of the configuration and the hidden settings."""
    return Scan(
        views=views,
        **scanned_object.detector(settings.columns, settings.rows),
        kev=kev,
        photons=photons,
        rotation_ms=rotation_ms,
        settings=dict(hidden),
    )


def hidden_settings(truth: Mapping) -> dict:
    """Merge the settings of the simulator for all effects of a truth."""
    merged: dict = {}
    for effect in truth["effects"]:
        merged |= effect["settings"]
    return merged


def acquire(
    scan: Scan, scanned_object: Object, fine: Volume, mu_water_per_mm: float, repeats: int, seed: Stream
) -> Acquired:
    """Scan the fine phantom (HU) and read out the detector.

    Branches of the seed draw the noise, the gains of the pixels and the faults.
    """
    noise, pixels, faults = seed.spawn(3)
    scanned = changed(fine, scanned_object, scan.settings)
    taken = simulate(scan, materials(scanned, scanned_object, scan.kev, mu_water_per_mm), repeats, noise)
    return read_out(
        faulty(taken, scan, generator(faults)),
        scan.settings,
        (scan.column_pitch_mm, scan.row_pitch_mm),
        scan.rotation_ms / 1000,
        generator(pixels),
    )


def write_images(
    folder: str | Path, name: str, scanned_object: Object, scan: Scan, taken: Acquired, mu_water_per_mm: float
) -> None:
    """Write recording.yaml and one uncompressed image in HU per repeat, so that all files have the same size."""
    folder, grid = Path(folder), grid_of(scanned_object.image_grid(scan.columns))
    blur, scale, offset = (scan.settings.get(key, neutral) for key, neutral in RECONSTRUCTED.items())
    files = [f"scan{number:02d}.nii" for number in range(1, 1 + len(taken.readings))]
    for file, readings in zip(files, taken.readings, strict=True):
        lines = -np.log(np.maximum(readings, LEAST_READING * taken.air) / taken.air)
        hu = images_hu(lines, scan, grid, mu_water_per_mm, blur * grid.spacing[2])
        write_nifti(Volume((hu * scale + offset).astype(np.float32), grid), folder / file)
    content = {"name": name, "kind": "images", "repeats": files, "nominal": NOMINAL}
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)


def write(folder: str | Path, name: str, scan: Scan, taken: Acquired) -> None:
    """Write recording.yaml and one HDF5 file per repeat.

    The files do not depend on the hidden effects, and they are uncompressed, so that all have the same size. The writer
    of the importers is not used, since it reads back what it wrote with modules that contain the library's noise
    models.
    """
    folder = Path(folder)
    files = [f"scan{number:02d}.h5" for number in range(1, 1 + len(taken.readings))]
    angles = np.arange(scan.views) * 360 / scan.views
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
        "nominal": NOMINAL,
        "scan": {
            "trajectory": "circular",
            "detector": "flat",
            "illumination": "solid_angle",
            "source_to_isocentre_mm": scan.source_to_isocentre_mm,
            "source_to_detector_mm": scan.source_to_detector_mm,
            "columns": scan.columns,
            "rows": scan.rows,
            "column_pitch_mm": scan.column_pitch_mm,
            "row_pitch_mm": scan.row_pitch_mm,
            "views": scan.views,
            "views_per_rotation": scan.views,
            "start_angle_deg": 0.0,
            "direction": 1,
            "rotation_time_ms": scan.rotation_ms,
            "exposure_ms": 0.0,  # one flash in the middle of each interval, as XCIST simulates
        },
    }
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)
