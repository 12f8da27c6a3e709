"""Exponents of CPU time as a function of voxels, views, realizations, ROIs and recordings."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.common import ROOT, child_seconds, engines, medians
from virtual_phantom.base.geometry import Grid
from virtual_phantom.features.extraction import FEATURES, extract
from virtual_phantom.io.volumes import Volume

EDGES = (48, 64, 96, 128)  # voxels in the plane; slices in proportion
VIEWS = (8, 16, 32, 64)
LANES = (1, 2, 4, 8, 16, 32)
ROIS = (1, 2, 4, 8)
RECORDINGS = (4, 16, 64)


def measured(repeats):
    """Rows with quantity, size, seconds and the fitted exponent."""
    rows = []
    for of, sizes, action in (
        ("voxels", [edge**3 * 3 // 8 for edge in EDGES], [pair(edge=edge) for edge in EDGES]),
        ("views", VIEWS, [pair(views=views) for views in VIEWS]),
        ("realizations", LANES, [pair(lanes=lanes) for lanes in LANES]),
        ("ROIs", ROIS, [features(count) for count in ROIS]),
    ):
        rows += fitted(of, sizes, medians(action, repeats))
    return rows + fitted("recordings", RECORDINGS, [planned(count) for count in RECORDINGS])


def fitted(of, sizes, seconds):
    exponent = float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])
    return [
        {"of": of, "size": int(size), "seconds": float(time), "exponent": exponent}
        for size, time in zip(sizes, seconds, strict=True)
    ]


def pair(edge=128, views=engines.VIEWS, lanes=16):
    """One forward and one back-projection; the detector keeps its pixels."""
    slices = edge * 3 // 8
    grid = Grid((slices, edge, edge), (96 / slices, 300.8 / edge, 300.8 / edge))
    one = engines.virtual_phantom(lanes, engines.geometry(views), grid)

    def both():
        one.forward()
        one.back()

    return both


def features(count):
    """Action that extracts the 86 features of `count` balls."""
    grid = engines.GRID
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    noise = np.random.default_rng(np.random.SeedSequence(2)).normal(50, 20, grid.shape).astype(np.float32)
    angles = np.arange(count) * 2 * np.pi / max(ROIS)
    masks = {
        f"roi{number}": (x - 60 * np.cos(angle)) ** 2 + (y - 60 * np.sin(angle)) ** 2 + z**2 < 8**2
        for number, angle in enumerate(angles)
    }
    return lambda: extract(Volume(noise, grid), masks)


def planned(count):
    """CPU time in seconds of a dry run with `count` recordings."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = {}
        for number in range(count):
            one = Path(folder) / f"recording{number}"
            one.mkdir()
            (one / "recording.yaml").write_text(f"name: recording{number}\nkind: features\nrepeats: [features.csv]\n")
            header = ",".join(["image", "roi", *FEATURES])
            (one / "features.csv").write_text(f"{header}\nscan,liver{',1' * len(FEATURES)}\n")
            recordings[f"recording{number}"] = str(one)
        overlay = Path(folder) / "overlay.json"
        overlay.write_text(json.dumps({"recordings": recordings, "results_dir": str(Path(folder) / "results")}))
        command = [sys.executable, "-m", "snakemake", "-n", "-q", "all", "--nolock"]
        command += ["recordings", "--configfile", ROOT / "config/paper_groups.yaml", overlay]
        before = child_seconds()[0]
        subprocess.run(command, cwd=ROOT, check=True, env=os.environ, stdout=subprocess.DEVNULL)
    return child_seconds()[0] - before
