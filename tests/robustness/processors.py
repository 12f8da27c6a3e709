"""A small scan from line integrals to features, and variables that disable newer processor instructions.

python tests/robustness/processors.py OUT.npz      makes the scan and writes the results
"""

import sys
from pathlib import Path

import numpy as np

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import FbpSettings
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.features.extraction import FEATURES, extract
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.noise.poisson import poisson_counts
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.simulation.acquire import simulate_counts
from virtual_phantom.simulation.reconstruct import reconstruct

MU_WATER_PER_MM, NOISE_LEVEL = 0.0193, 6e-6
REPEATS = 8
# glibc selects its exp and log by these (names of x86-64; others ignore them).
GLIBC = ("AVX512F", "AVX512VL", "AVX512BW", "AVX512DQ", "AVX512CD", "AVX2", "AVX2_Usable", "FMA", "FMA_Usable", "FMA4")


def plain_processor(kernels: Path) -> dict[str, str]:
    """Variables that limit numba, NumPy, OpenBLAS and the C library to instructions of every x86-64 processor.

    kernels   an empty folder for kernels compiled in this way
    """
    from numpy._core import _multiarray_umath

    found = [one for one in _multiarray_umath.__cpu_dispatch__ if _multiarray_umath.__cpu_features__[one]]
    return {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CACHE_DIR": str(kernels),
        "NPY_DISABLE_CPU_FEATURES": " ".join(found),
        "OPENBLAS_CORETYPE": "Prescott",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{one}" for one in GLIBC),
    }


def small_scan() -> dict[str, np.ndarray]:
    """Line integrals [view, row, column], counts and HU of each repeat, features [repeat, ROI, feature], and counts of
    given means.
    """
    grid = Grid((12, 40, 40), (4.0, 4.0, 4.0))
    z, y, x = np.ix_(*grid.axes_mm())
    random = np.random.default_rng(np.random.SeedSequence(4))
    hu = np.where(np.hypot(x / 70, y / 55) + 0 * z < 1, 40 + 30 * random.standard_normal(grid.shape), HU_AIR)
    geometry = circular(
        views=60,
        source_to_isocentre_mm=570.0,
        source_to_detector_mm=1040.0,
        columns=64,
        rows=12,
        column_pitch_mm=6.0,
        row_pitch_mm=8.0,
    )
    lines = clean_line_integrals(Volume(hu.astype(np.float32), grid), geometry, MU_WATER_PER_MM)
    taken = [simulate_counts(lines, NOISE_LEVEL, "astra", np.random.SeedSequence(seed)) for seed in range(REPEATS)]
    noisy = np.stack([one.line_integrals(0.5) for one in taken])
    images = reconstruct(
        noisy, geometry, grid, "fbp", FbpSettings("coverage"), engine="cpu", mu_water_per_mm=MU_WATER_PER_MM
    )
    masks = {
        name: np.hypot(np.hypot(x - at, y), z) < radius for name, at, radius in (("left", -30, 18), ("right", 28, 16))
    }
    features = np.stack([extract(image, masks)[list(FEATURES)].to_numpy(float) for image in images])
    # Means without rounding errors: multiples of one half, from zero to a million photons.
    means = np.concatenate([np.arange(0, 2000) / 2, np.arange(1000, 10**6, 7) / 2])
    return {
        "means": means,
        "counts_of_means": poisson_counts(means, np.random.default_rng(np.random.SeedSequence(5))),
        "lines": lines,
        "counts": np.stack([one.data for one in taken]),
        "images": np.stack([image.array for image in images]),
        "features": features,
    }


if __name__ == "__main__":
    np.savez(sys.argv[1], **small_scan())
