"""Measure how many repeats common random numbers save (noise.draws: common; minutes).

The tiny study's phantom is scanned with 150 views at A = 6e-6 (model "physical") and reconstructed with FBP, once as it
is and once with one change. The variance of a feature's mean change over n pairs is Var(difference of a pair) / n; with
independent noise it is the sum of both variances. Prints the median and quartiles of the ratio over features and ROIs.
"""

import numpy as np
import pandas as pd

from benchmarks import common
from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.config.config import read_study
from virtual_phantom.features import MINIMUM_VOXELS
from virtual_phantom.features.extraction import extract
from virtual_phantom.features.names import FEATURES
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.simulation.acquire import acquire
from virtual_phantom.simulation.reconstruct import reconstruct

ONE_THREAD = True
VIEWS, LEVEL = 150, 6e-6
# The first two: differences between processors (docs/reference/stability.md).
CHANGES = {
    "line integrals times 1 + 1e-6": {"times": 1 + 1e-6},
    "line integrals times 1 + 1e-7": {"times": 1 + 1e-7},
    "scatter, amount 0.05": {"physics": {"scatter": {"amount": 0.05}}},
    "afterglow, typical": {"physics": {"afterglow": {}}},
    "optical_crosstalk, typical": {"physics": {"optical_crosstalk": {}}},
    "focal_spot, typical": {"physics": {"focal_spot": {}}},
    "A = 6.7e-6 (dose10_plus12)": {"level": 6.7e-6},
    "A = 12e-6 (double)": {"level": 12e-6},
    "200 views": {"views": 200},
}


class Study:
    def __init__(self, repeats):
        config, tiny = common.read_config(), common.read_config("config/tiny.yaml")
        for key in ("grid", "scan"):
            config[key] = config[key] | tiny[key]
        self.settings, self.repeats = read_study(config), repeats
        self.grid = grid_of(self.settings.grid)
        seed = np.random.SeedSequence(self.settings.seed, spawn_key=(0,))
        described = layout.read_layout(self.settings.phantom.layout)
        self.phantom = synthetic.build(described, self.grid, self.settings.grid.oversampling, seed)
        self.masks = {roi.name: roi.mask for roi in self.phantom.rois if roi.mask.sum() >= MINIMUM_VOXELS}
        self.scene = VoxelScene.of(
            self.phantom.fine, Segmentation(**vars(self.settings.materials)), self.settings.mu_water_per_mm, 1
        )

    def made(self, physics=None, level=LEVEL, views=VIEWS, times=1.0):
        """Counts of the first repeat, images [repeat, z, y, x] and features [repeat, ROI, feature]."""
        geometry = scan_geometry(self.settings.scan, views, self.grid)
        values = {name: load(name).values(given) for name, given in (physics or {}).items()}
        state = Chain(self.scene, geometry, photons=1.0).state(values)
        clean = times * state.line_integrals()
        labels = dict(geometry="", noise="", noise_level=level, model="physical", study_seed=self.settings.seed)
        taken = [
            acquire(clean, seed=seed, draws="common", state=state if physics else None, **labels)
            for seed in range(self.repeats)
        ]
        lines = np.stack([one.line_integrals(0.5) for one in taken])
        mu_water = self.settings.mu_water_per_mm
        images = reconstruct(
            lines, geometry, self.grid, "fbp", self.settings.reconstruction.fbp, engine="cpu", mu_water_per_mm=mu_water
        )
        tables = [extract(image, self.masks)[list(FEATURES)].to_numpy(float) for image in images]
        return taken[0].data.astype(float), np.stack([image.array for image in images]).astype(float), np.stack(tables)


def add_arguments(parser):
    parser.add_argument("--repeats", type=int, default=16)


def run(options):
    study = Study(options.repeats)
    counts, images, features = study.made()
    rows = []
    for name, changed in CHANGES.items():
        counts_there, images_there, there = study.made(**changed)
        independent = features.var(axis=0, ddof=1) + there.var(axis=0, ddof=1)
        paired = (there - features).var(axis=0, ddof=1)
        share = np.divide(paired, independent, out=np.full(independent.shape, np.nan), where=independent > 0)
        low, middle, high = np.nanquantile(share, (0.25, 0.5, 0.75))
        noise = [one - one.mean(axis=0) for one in (images, images_there)]
        rows.append(
            {
                "changed": name,
                "share of repeats": middle,
                "quartiles": f"{low:.4f} to {high:.4f}",
                "repeats fewer by": 1 / middle,
                "correlation of images' noise": np.corrcoef(*(one.ravel() for one in noise))[0, 1],
            }
        )
        if counts.shape == counts_there.shape:
            rows[-1]["counts the same, %"] = 100 * (counts == counts_there).mean()
        print(pd.DataFrame(rows[-1:]).to_string(index=False, float_format="%.4f"), flush=True)
