"""Repeat the tiny study under other conditions and compare every table, JSON, image and projection file.

python tests/robustness/determinism.py                  one and four cores, another job order, an empty cache
python tests/robustness/determinism.py --processor      with the instructions of a plain x86-64 processor only
python tests/robustness/determinism.py --target features/fbp_150/dose10/seed00.csv      part of the study

Exit code 0: all files are byte-identical to those of two cores. With --processor: noise-free projections agree within
1e-5 of the largest, noise-free images within half a HU, and counts of one realization within one. Differences of noisy
images and features are printed with the differences between two repeats.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from runpy import run_path

import numpy as np
import pandas as pd
from interrupt import ROOT, tables
from processors import plain_processor

from virtual_phantom.base.settings import FbpSettings, SirtSettings
from virtual_phantom.io import exchange, volumes
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.reconstruction.images import reconstruct_hu
from virtual_phantom.simulation.acquire import simulate_counts

# Helper of tests in another folder, which is not on the import path of a program that is run from here.
tiny = run_path(str(ROOT / "tests" / "workflow" / "workflow_runs.py"))["tiny"]

CIRCUMSTANCES = ("one core", "four cores, four threads", "another order", "nothing compiled")
# Algorithms of the tiny study, for images without noise.
SIRT = defaults_of("reconstruction", "sirt") | {"iterations": 100, "terms": 25}
ALGORITHMS = {"sirt": SirtSettings(**SIRT), "fbp": FbpSettings("coverage")}
MU_WATER_PER_MM, NOISE_LEVEL = 0.0193, 6e-6
PROJECTIONS_WITHIN, IMAGES_WITHIN_HU = 1e-5, 0.5


def make(folder: Path, targets: list[str], **circumstances) -> Path:
    process = tiny(folder, *(folder / target for target in targets), timeout=None, **circumstances)
    if process.returncode != 0:
        sys.exit(f"Error: the run into {folder} failed\n{process.stderr[-4000:]}")
    return folder


def make_under(circumstance: str, folder: Path, targets: list[str], reference: Path) -> Path:
    if circumstance == "one core":
        return make(folder, targets, cores=1)
    if circumstance == "four cores, four threads":
        return make(folder, targets, cores=4, overlay={"threads": 4}, config_folder=folder.parent / "config")
    if circumstance == "another order":
        made = sorted(reference.glob("features/*/*/seed00.csv"), key=lambda path: -path.stat().st_mtime)
        for path in made:  # most recent files first
            make(folder, [str(path.relative_to(reference))], cores=1)
        return make(folder, targets, cores=1)
    return make(folder, targets, environment={"NUMBA_CACHE_DIR": f"{folder}.kernels"})


def compare(folder: Path, reference: Path) -> bool:
    """Whether all files are equal; prints which are not."""
    expected, found = tables(reference), tables(folder)
    differ = [name for name in sorted(expected | found) if expected.get(name) != found.get(name)]
    print(f"{folder.name}: {len(expected)} files compared, {len(differ)} differ", *differ[:20], sep="\n", flush=True)
    return bool(expected) and not differ


def noise_free(clean: Path, image: Path, out: Path) -> None:
    """Write noise-free results of this processor: images in HU, not rounded, and one realization of counts."""
    lines, geometry = exchange.read_line_integrals(clean)
    grid = volumes.read_nifti(image).grid
    images = {
        name: reconstruct_hu(lines[None], geometry, grid, name, settings, "cpu", MU_WATER_PER_MM)
        for name, settings in ALGORITHMS.items()
    }
    counts = simulate_counts(lines, NOISE_LEVEL, "astra", np.random.SeedSequence(0)).data
    np.savez(out, counts=counts, lines=lines, **images)


def compare_processors(folder: Path, reference: Path, variables: dict[str, str]) -> bool:
    """Whether all noise-free results agree; prints the differences."""
    made = []
    for one, changed in ((reference, {}), (folder, variables)):
        for number, clean in enumerate(sorted(one.glob("projections/*/clean.h5"))):
            out = folder.parent / f"{one.name}-{number}.npz"
            command = [sys.executable, __file__, "--noise-free", clean, one / "phantom" / "image.nii.gz", out]
            subprocess.run(list(map(str, command)), check=True, env=os.environ | changed)
            made.append(out)
    agree, half = bool(made), len(made) // 2
    for actual, theirs in zip(made[:half], made[half:], strict=True):
        one, other = np.load(actual), np.load(theirs)
        lines = np.abs(one["lines"] - other["lines"]).max() / one["lines"].max()
        print(f"{actual.stem}, noise-free projections: they differ by up to {lines:.1e} of the largest")
        agree &= bool(lines <= PROJECTIONS_WITHIN)
        for name in ALGORITHMS:
            largest = np.abs(one[name] - other[name]).max()
            print(f"noise-free {name} image: up to {largest:.4f} HU")
            agree &= bool(largest <= IMAGES_WITHIN_HU)
        off = np.abs(one["counts"].astype(np.int64) - other["counts"])
        print(f"counts: {100 * (off == 0).mean():.2f} % the same, {(off > 1).sum()} of {off.size} off by more than one")
        agree &= bool(off.max() <= 1)
    for path in sorted(reference.glob("images/*/*/seed00.nii.gz")):
        print(f"{path.relative_to(reference).parent}: {_differences(path, folder / path.relative_to(reference))}")
    for path in sorted(reference.glob("features/*/*/seed00.csv")):
        here, there, repeat = (
            pd.read_csv(one).select_dtypes(float).filter(like="original_")
            for one in (path, folder / path.relative_to(reference), path.with_name("seed01.csv"))
        )
        difference, repeats = ((here - one).abs().to_numpy().ravel() for one in (there, repeat))
        share = difference[repeats > 0] / repeats[repeats > 0]
        print(
            f"{path.relative_to(reference).parent}: {100 * (difference == 0).mean():.1f} % of features are equal; "
            f"difference over that of two repeats: median {np.median(share):.2g}, "
            f"95th percentile {np.quantile(share, 0.95):.2g}"
        )
    return agree


def _differences(path: Path, other: Path) -> str:
    """Differences between an image and that of the other processor, and between two repeats."""
    here, there, repeat = (
        volumes.read_nifti(one).array.astype(float) for one in (path, other, path.with_name("seed01.nii.gz"))
    )
    return (
        f"{100 * (here == there).mean():.1f} % of voxels the same, up to {np.abs(here - there).max():.0f} HU, "
        f"SD of the difference {np.std(here - there):.3f} HU; of two repeats {np.std(here - repeat):.2f} HU"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--target", action="append", default=[], help="a file under results_dir; may be repeated")
    parser.add_argument("--processor", action="store_true")
    parser.add_argument("--folder", type=Path, help="where to work; by default a temporary folder")
    parser.add_argument("--noise-free", type=Path, nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.noise_free:
        noise_free(*arguments.noise_free)
        return 0
    parent = arguments.folder or Path(tempfile.mkdtemp(prefix="determinism-"))
    parent.mkdir(parents=True, exist_ok=True)
    reference = make(parent / "two cores", arguments.target)
    if arguments.processor:
        variables = plain_processor(parent / "kernels")
        folder = make(parent / "plain processor", arguments.target, environment=variables)
        return int(not compare_processors(folder, reference, variables))
    folders = [
        make_under(circumstance, parent / circumstance, arguments.target, reference) for circumstance in CIRCUMSTANCES
    ]
    return int(not all([compare(folder, reference) for folder in folders]))


if __name__ == "__main__":
    sys.exit(main())
