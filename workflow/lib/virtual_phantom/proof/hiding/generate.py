"""One concealed recording: scanned by XCIST, written as any recording of projections is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from ...base.geometry import grid_of
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

LEAST_READING = 1e-6  # of the air scan: less has no logarithm
NOMINAL = {"anode": "W", "anode_angle_deg": TARGET_ANGLE_DEG}  # the tube, of all cases alike
RECONSTRUCTED = {"kernel_pixels": 0.0, "hu_scale": 1.0, "hu_offset": 0.0}  # settings, and what does nothing
NOISE, PIXELS = range(2)  # branches of a scan's seed


def scan_section(
    one: Object, settings: Mapping, views: int, photons: float, rotation_ms: float, kev: float, concealed: Mapping
) -> Scan:
    """What XCIST is asked for.

    Parameters
    ----------
    settings : mapping
        The section proof.scan of the configuration.
    photons, rotation_ms, kev : float
        As Scan has them.
    concealed : mapping
        The simulator's settings.
    """
    return Scan(
        views=views,
        **one.detector(settings["columns"], settings["rows"]),
        kev=kev,
        photons=photons,
        rotation_ms=rotation_ms,
        settings=dict(concealed),
    )


def concealed_settings(truth: Mapping) -> dict:
    """All that a truth asks the simulator for."""
    merged: dict = {}
    for effect in truth["effects"]:
        merged |= effect["settings"]
    return merged


def acquire(scan: Scan, one: Object, fine: Volume, mu_water_per_mm: float, repeats: int, seed: Stream) -> Acquired:
    """Scan the fine phantom and read it out.

    Parameters
    ----------
    fine : Volume
        HU.
    mu_water_per_mm : float
        1/mm.
    seed : Stream
        Of this scan's noise; the pixels' own gains are drawn from it too.
    """
    noise, pixels, faults = seed.spawn(3)
    scanned = changed(fine, one, scan.settings)
    taken = simulate(scan, materials(scanned, one, scan.kev, mu_water_per_mm), repeats, noise)
    return read_out(
        faulty(taken, scan, generator(faults)),
        scan.settings,
        (scan.column_pitch_mm, scan.row_pitch_mm),
        scan.rotation_ms / 1000,
        generator(pixels),
    )


def write_images(
    folder: str | Path, name: str, one: Object, scan: Scan, taken: Acquired, mu_water_per_mm: float
) -> None:
    """Write recording.yaml and one image per repeat, in HU and not compressed, so that sizes are alike."""
    folder, grid = Path(folder), grid_of(one.image_grid(scan.columns))
    blur, scale, offset = (scan.settings.get(key, none) for key, none in RECONSTRUCTED.items())
    files = [f"scan{number:02d}.nii" for number in range(1, 1 + len(taken.readings))]
    for file, readings in zip(files, taken.readings, strict=True):
        lines = -np.log(np.maximum(readings, LEAST_READING * taken.air) / taken.air)
        hu = images_hu(lines, scan, grid, mu_water_per_mm, blur * grid.spacing[2])
        write_nifti(Volume((hu * scale + offset).astype(np.float32), grid), folder / file)
    content = {"name": name, "kind": "images", "repeats": files, "nominal": NOMINAL}
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)


def write(folder: str | Path, name: str, scan: Scan, taken: Acquired) -> None:
    """Write recording.yaml and one HDF5 file per repeat.

    Nothing of what is concealed is in them: files are not compressed, so that their sizes are alike too. The importers'
    writer loads what it wrote, by files that know the library's noise, and is not used.
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
            "exposure_ms": 0.0,  # one flash in the middle of every view's interval, as it simulates
        },
    }
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)
