"""From noisy counts to images in HU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from . import solvers
from .errors import InputError
from .exchange import read_counts
from .geometry import Grid
from .projectors import projector
from .units import attenuation_to_hu
from .volumes import Volume


def reconstruct(
    acquisitions: Sequence[str | Path],
    grid: Grid,
    algorithm: str,
    settings: dict,
    *,
    engine: str,
    mu_water_per_mm: float,
    zero_counts_as: float,
    threads: int = 1,
) -> list[Volume]:
    """Images of acquisitions that share one geometry, int16 HU on `grid`, in the order given.

    algorithm, settings   "sirt" with solvers.sirt's keywords, or "fbp" with solvers.fdk's
    Raises InputError if an acquisition is missing or broken, or was made in another geometry than the first.
    """
    stack, geometry = None, None
    for lane, path in enumerate(acquisitions):
        counts, own = read_counts(path)
        if stack is None:
            geometry = own
            stack = np.empty((len(acquisitions), *counts.data.shape), dtype=np.float32)
        elif stack.shape[1:] != counts.data.shape or not np.array_equal(own.angles_rad, geometry.angles_rad):
            raise InputError(f"{path}: made in another geometry than {acquisitions[0]}; delete both and run again")
        stack[lane] = counts.line_integrals(zero_counts_as)
    if algorithm == "sirt":
        attenuation = solvers.sirt(projector(engine, geometry, grid, len(stack), threads), stack, **settings)
    elif algorithm == "fbp":
        # One pass, and ASTRA's back-projection has a scale of its own: always on the CPU engine.
        attenuation = solvers.fdk(projector("cpu", geometry, grid, len(stack), threads), stack, **settings)
    else:
        raise InputError(f"algorithm '{algorithm}' is unknown; use sirt or fbp")
    hu = attenuation_to_hu(attenuation, mu_water_per_mm)
    limits = np.iinfo(np.int16)
    return [Volume(np.clip(np.rint(image), limits.min, limits.max).astype(np.int16), grid) for image in hu]
