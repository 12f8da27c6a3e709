"""One concealed recording: scanned by XCIST, written as any recording of projections is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np
import yaml

from ..files import replacing, write_text
from ..recordings.document import FILE_NAME
from ..volumes import Volume
from .objects import Object
from .phantoms import materials, pixel_mm
from .readout import read_out
from .xcist import Acquired, Scan, simulate

SOURCE_TO_ISOCENTRE_MM, SOURCE_TO_DETECTOR_MM = 541.0, 949.0
NOISE, PIXELS = range(2)  # branches of a scan's seed


def scan_of(one: Object, settings: Mapping, views: int, photons: float, kev: float, concealed: Mapping) -> Scan:
    """What XCIST is asked for.

    settings    the section proof.scan of the configuration
    concealed   the simulator's settings
    """
    pitch = pixel_mm(one, settings["columns"]) * SOURCE_TO_DETECTOR_MM / SOURCE_TO_ISOCENTRE_MM
    return Scan(
        views=views,
        columns=settings["columns"],
        rows=settings["rows"],
        column_pitch_mm=pitch,
        row_pitch_mm=pitch,
        source_to_isocentre_mm=SOURCE_TO_ISOCENTRE_MM,
        source_to_detector_mm=SOURCE_TO_DETECTOR_MM,
        kev=kev,
        photons=photons,
        settings=dict(concealed),
    )


def concealed_settings(truth: Mapping) -> dict:
    """All that a truth asks the simulator for."""
    merged: dict = {}
    for effect in truth["effects"]:
        merged |= effect["settings"]
    return merged


def acquire(
    scan: Scan, one: Object, fine: Volume, mu_water_per_mm: float, repeats: int, seed: np.random.SeedSequence
) -> Acquired:
    """Scan the fine phantom (HU) and read it out.

    seed   of this scan's noise; the pixels' own gains are drawn from it too
    """
    noise, pixels = seed.spawn(2)
    taken = simulate(scan, materials(fine, one, scan.kev, mu_water_per_mm), repeats, noise)
    return read_out(taken, scan.settings, (scan.column_pitch_mm, scan.row_pitch_mm), np.random.default_rng(pixels))


def write(folder: str | Path, name: str, scan: Scan, taken: Acquired) -> None:
    """Write recording.yaml and one HDF5 file per repeat. Nothing of what is concealed is in them: files are not
    compressed, so that their sizes are alike too. The importers' writer loads what it wrote, by files that know the
    library's noise, and is not used."""
    folder = Path(folder)
    files = [f"scan{number:02d}.h5" for number in range(1, 1 + len(taken.readings))]
    angles = np.arange(scan.views) * 360 / scan.views
    for file, readings in zip(files, taken.readings, strict=True):
        with replacing(folder / file) as temporary, h5py.File(temporary, "w") as stored:
            stored.create_dataset("exchange/data", data=readings).attrs["log"] = False
            stored.create_dataset("exchange/data_white", data=taken.air[None])
            stored.create_dataset("exchange/data_dark", data=np.zeros_like(taken.air)[None])
            stored.create_dataset("exchange/theta", data=angles).attrs["units"] = "degree"
    content = {
        "name": name,
        "kind": "projections",
        "repeats": files,
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
        },
    }
    write_text(yaml.safe_dump(content, sort_keys=False), folder / FILE_NAME)
