"""From line integrals to images in HU."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.errors import InputError
from ..base.geometry import Grid, ScanGeometry, circular
from ..base.units import attenuation_to_hu
from ..projectors import projector
from . import fbp, sirt
from .kernel import Kernel


def in_hu(
    line_integrals: np.ndarray,
    geometry: ScanGeometry,
    grid: Grid,
    algorithm: str,
    settings: dict,
    engine: str,
    mu_water_per_mm: float,
    threads: int = 1,
) -> np.ndarray:
    """Images of every acquisition, not rounded.

    Parameters
    ----------
    line_integrals : ndarray, shape (acquisitions, views, rows, columns)
    algorithm : {"sirt", "fbp"}
    settings : dict
        Keywords of sirt.sirt or fbp.fbp; kernel may be one as `read_kernel` takes it.
    engine : {"cpu", "astra_cuda"}
        Of SIRT; FBP is made by the CPU engine.
    mu_water_per_mm : float
        Linear attenuation of water, 1/mm.

    Returns
    -------
    ndarray, shape (acquisitions, z, y, x)
        HU.

    Raises
    ------
    InputError
        For an unknown algorithm or a scan that it cannot use.
    """
    count = len(line_integrals)
    if algorithm == "sirt":
        # Lanes fill a processor's registers. A device has no use for them, and less memory.
        at_once = count if engine == "cpu" else 1
        made = projector(engine, geometry, grid, at_once, threads)
        images = [sirt.sirt(made, line_integrals[i : i + at_once], **settings) for i in range(0, count, at_once)]
        attenuation = images[0] if len(images) == 1 else np.concatenate(images)
    elif algorithm == "fbp":
        # One pass, and ASTRA's back-projection has a scale of its own: always on the CPU engine.
        settings = {**settings, "kernel": read_kernel(settings)}
        attenuation = fbp.fbp(projector("cpu", geometry, grid, count, threads), line_integrals, **settings)
    else:
        raise InputError(f"algorithm '{algorithm}' is unknown; use sirt or fbp")
    return attenuation_to_hu(attenuation, mu_water_per_mm)


def read_kernel(settings: dict) -> Kernel | None:
    """The kernel of settings of filtered back-projection: Kernel's fields under `kernel`; None for the ramp alone."""
    return None if settings.get("kernel") is None else Kernel(**settings["kernel"])


def compile_kernels(lanes: Sequence[int]) -> None:
    """Compile all kernels for these numbers of realisations; the next process finds them in numba's cache."""
    geometry = circular(
        views=4,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=4,
        rows=2,
        column_pitch_mm=1.0,
        row_pitch_mm=1.0,
    )
    grid = Grid((2, 2, 2), (1.0, 1.0, 1.0))
    for count in lanes:
        scan = np.ones((count, 4, 2, 4), dtype=np.float32)
        for backprojector in ("adjoint", "voxel"):
            settings = {"iterations": 1, "solver": "chebyshev", "terms": 1, "backprojector": backprojector}
            sirt.sirt(projector("cpu", geometry, grid, count), scan, **settings)
        fbp.fbp(projector("cpu", geometry, grid, count), scan)
