"""Write a recording of clinical size for `snakemake diagnosis`, to measure its time and memory (minutes).

The scan is one turn of a GE LightSpeed VCT with one repeat of 1e5 photons per pixel in air. The object is a map of 512
x 512 x 64 voxels: water with holes and blurred edges. The scan has four times as many rays per pixel as the model.
Diagnose it with `cd FOLDER && snakemake diagnosis --cores 2 --snakefile PROJECT/workflow/Snakefile --configfile
my.yaml`.
"""

from dataclasses import replace
from pathlib import Path

import h5py
import nibabel
import numpy as np
import yaml
from scipy import ndimage

from benchmarks import common
from benchmarks.common import chain_scans
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.scene import DISC_ENERGY_KEV, VoxelScene
from virtual_phantom.recordings.scan import scan_geometry

PHOTONS, VIEWS = 1e5, 984
STRENGTH = 0.5  # fraction of the typical strength
SCAN = common.LIGHTSPEED | {"rows": 64, "trajectory": "circular", "detector": "cylindrical"}
SCAN |= {"views": VIEWS, "views_per_rotation": VIEWS, "start_angle_deg": 0, "direction": 1, "rotation_time_ms": 500.0}
GRID = Grid((64, 512, 512), (1.0, 0.75, 0.75))
EDGE_MM = 1.0
AT_ONCE = 41  # views per part; effects with memory would need all views


def shares():
    """Water fraction per voxel: an ellipse 300 mm wide with ellipsoidal holes."""
    z, y, x = np.meshgrid(*GRID.axes_mm(), indexing="ij", sparse=True)
    body = (x / 150) ** 2 + (y / 105) ** 2 < 1
    for centre, radius in (((60, 10, 5), 25), ((-50, -30, -8), 20), ((-10, 55, 0), 15), ((0, -60, 12), 10)):
        body = body & ((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (2 * (z - centre[2])) ** 2 > radius**2)
    return ndimage.gaussian_filter(body.astype(np.float32), np.array(EDGE_MM) / GRID.spacing, mode="nearest")


def views(geometry, first, last):
    some = slice(first, last)
    return replace(
        geometry, **{key: getattr(geometry, key)[some] for key in ("angles_rad", "source_z_mm", "view_times")}
    )


def add_arguments(parser):
    parser.add_argument("folder", type=Path)
    parser.add_argument("--effect", default="scatter", help="missing effect without memory between views, or 'none'")


def run(options):
    geometry = scan_geometry(SCAN, "clinical")
    folder = options.folder / "recordings/clinical"
    folder.mkdir(parents=True, exist_ok=True)
    water = shares()
    affine = np.diag([*GRID.spacing[::-1], 1.0])
    nibabel.save(nibabel.Nifti1Image(water.transpose(2, 1, 0), affine), options.folder / "water.nii.gz")
    physics = {}
    scene = VoxelScene(water[None], GRID, ("water",), DISC_ENERGY_KEV)
    random = np.random.default_rng(np.random.SeedSequence(20261124))
    shape = geometry.shape
    with h5py.File(folder / "scan.h5", "w") as file:
        data = file.create_dataset("exchange/data", shape, np.float32)
        for first in range(0, VIEWS, AT_ONCE):
            part = views(geometry, first, min(first + AT_ONCE, VIEWS))
            chain = Chain(scene, part, PHOTONS, samples=2)
            if options.effect != "none" and not physics:
                physics[options.effect] = chain_scans.scaled(chain, options.effect, STRENGTH)
                if load(options.effect).pattern:
                    raise InputError(
                        "--effect gain_pattern: the parts of the views need one pattern; choose another effect"
                    )
            state = chain.state(physics)
            data[first : first + part.views] = state.counts(random)
        file["exchange/data_white"] = PHOTONS * state.air[:1]
        file["exchange/data_dark"] = np.zeros((1, *shape[1:]))
    content = {"name": "clinical", "kind": "projections", "repeats": ["scan.h5"], "scan": SCAN}
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    settings = {"object": {"mask": "water.nii.gz", "material": "water"}, "samples": 1}
    settings["nominal_photons"] = PHOTONS
    overlay = {"recordings": {"clinical": "recordings/clinical"}, "diagnosis": {"recordings": {"clinical": settings}}}
    (options.folder / "my.yaml").write_text(yaml.safe_dump(overlay))
    print(f"{options.folder}: {np.prod(shape) / 1e6:.1f} million rays, hidden: {physics or 'nothing'}")
