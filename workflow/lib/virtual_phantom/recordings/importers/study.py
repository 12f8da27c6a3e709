"""Import of a study's acquisitions (keep_projections: true) as a recording of projections, to try a diagnosis."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np

from ...base.errors import InputError
from ...base.geometry import OrbitGeometry, detector_and_spot_keys
from ...io.exchange import read_counts
from ..recording import Recording
from ..scan import DISTANCES
from . import write_folder


def import_study(source: str | Path, folder: str | Path, phantom: str | None = None) -> Recording:
    """Write a recording of the acquisitions of one geometry and noise level, one repeat per seed, and load it.

    The effects that the study simulated beyond the baseline are not recorded.

    Parameters
    ----------
    source : str or Path
        Folder `projections/<geometry>/<noise>` in results_dir.

    Raises
    ------
    InputError
        If there is no acquisition, or one is damaged.
    """
    source = Path(source)
    files = sorted(source.glob("seed*.h5"))
    if not files:
        raise InputError(f"{source}: has no acquisition (seed*.h5); set keep_projections: true and run the study")
    _, geometry = read_counts(files[0])

    def write(target: Path) -> None:
        for file in files:
            shutil.copyfile(file, target / file.name)

    content = {
        "scan": scan_section(geometry),
        "origin": {"importer": "study"},
        "repeats": [file.name for file in files],
    }
    return write_folder(folder, "projections", phantom, content, write)


def scan_section(geometry: OrbitGeometry) -> dict:
    """Return the scan section of a geometry with evenly spaced views."""
    step = float(np.diff(geometry.angles_rad).mean())
    helical = geometry.feed_per_rotation_mm != 0
    return {
        "trajectory": "helical" if helical else "circular",
        **detector_and_spot_keys(geometry),
        **({} if geometry.parallel else {name: getattr(geometry, name) for name in DISTANCES}),
        "columns": geometry.columns,
        "rows": geometry.rows,
        "column_pitch_mm": geometry.column_pitch_mm,
        "row_pitch_mm": geometry.row_pitch_mm,
        "column_offset_px": geometry.column_offset_px,
        "row_offset_px": geometry.row_offset_px,
        "views": geometry.views,
        "views_per_rotation": geometry.views_per_rotation,
        "start_angle_deg": math.degrees(float(geometry.angles_rad[0])),
        "direction": 1 if step > 0 else -1,
        **({"table_feed_mm": geometry.feed_per_rotation_mm} if helical else {}),
        "start_z_mm": float(geometry.source_z_mm[0]),
        **({} if geometry.view_interval_ms is None else {"view_interval_ms": geometry.view_interval_ms}),
        **({} if geometry.exposure_ms is None else {"exposure_ms": geometry.exposure_ms}),
    }
