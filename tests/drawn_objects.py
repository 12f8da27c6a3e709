"""An object of two cylinders with known geometry, drawn in voxels: its recordings, label maps and masks."""

import h5py
import numpy as np
import yaml
from simulated_scans import noisy_lines

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.beam.materials import energy_of
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder
from virtual_phantom.recordings.importers.study import scan_section

GEOMETRY = circular(
    views=48,
    source_to_isocentre_mm=400.0,
    source_to_detector_mm=700.0,
    columns=64,
    rows=1,
    column_pitch_mm=2.5,
    row_pitch_mm=2.5,
)
MU_WATER_PER_MM = 0.0193
ENERGY_KEV = energy_of("water", MU_WATER_PER_MM)
CYLINDERS = [("pmma", (0.0, 0.0, 0.0), 35.0), ("aluminium", (15.0, 5.0, 0.0), 6.0)]
MATERIALS = {1: "pmma", 2: "aluminium"}
SPECTRUM = {"kvp": 100.0, "filtration_mm": 4.0, "sensor_mm": 0.6}


def bench(folder, physics, cylinders=CYLINDERS):
    """Write four repeats of the exact cylinders with this physics as a recording."""
    scene = ShapesScene([cylinder(*one) for one in cylinders], ENERGY_KEV)
    state = Chain(scene, GEOMETRY, photons=1e5, samples=2).state(checked(physics))
    names = [f"{number}.h5" for number in range(4)]
    for name, one in zip(names, noisy_lines(state, 4, np.random.default_rng(3)), strict=True):
        with h5py.File(folder / name, "w") as file:
            data = file.create_dataset("exchange/data", data=one.astype(np.float32))
            data.attrs["log"] = True
            file["exchange/theta"] = np.rad2deg(GEOMETRY.angles_rad)
    content = {"name": "bench", "kind": "projections", "scan": scan_section(GEOMETRY), "repeats": names}
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    return folder


def drawn(path, voxel_mm, finer=None):
    """One slice of the cylinders as labels, or as volume fractions from `samples` points along each side of a voxel."""
    across = round(80 / voxel_mm) * (finer or 1)
    axis = (np.arange(across) - (across - 1) / 2) * voxel_mm / (finer or 1)
    labels = np.zeros((across, across), np.uint8)
    for label, (_, (x, y, _), radius) in enumerate(CYLINDERS, start=1):
        labels[np.hypot(axis - x, axis[:, None] - y) < radius] = label
    array = labels[None]
    if finer:
        array = (labels > 0).astype(np.float32).reshape(1, across // finer, finer, -1, finer).mean(axis=(2, 4))
    write_nifti(Volume(array, Grid(array.shape, (1.0, voxel_mm, voxel_mm))), path)
    return path
