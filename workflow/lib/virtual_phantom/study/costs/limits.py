"""Time limits of jobs on a cluster, from measured rates with a safety factor."""

from __future__ import annotations

import math
from collections.abc import Mapping

from .rates import estimate

# A factor of 2 for estimates far from the measured sizes, and a factor of 2 for a slower or busy node.
SLOWER_NODE = 2.0
SAFETY = 2.0 * SLOWER_NODE
# Minimum of any job: a slow shared file system, kernels that are compiled again for another processor.
FLOOR_MINUTES = 10
# Minimum of feature extraction: rates count images, and large ROIs take many times as long as in the measured study.
# Minimum of a diagnosis: a job that runs out of time continues from its saved fits.
FLOORS = {"extract": 30, "diagnose": 60}
# Limit of a stage without a rate: a user's own rates may lack stages that the measured study did not have.
UNKNOWN_MINUTES = 240
# Stages without a measured rate: the stage whose rates are used, and a factor.
PROXIES = {
    # Voxel-driven back-projection is faster than the adjoint (docs/explanation/performance.md).
    "reconstruct_sirt_voxel": ("reconstruct_sirt", SAFETY),
    # An H100 took 1/16 of the time of 16 threads (docs/explanation/performance.md). Other GPUs are slower, so the limit
    # is the time of one core.
    "reconstruct_sirt_astra_cuda": ("reconstruct_sirt", 1.0),
    # Projections with all eighteen effects took up to 27 times as long as without (benchmarks/effects.py).
    "project_physics": ("project", 27 * SAFETY),
}


def minutes(rates: dict, stage: str, work: Mapping[str, float]) -> int:
    """Return the time limit of a job in whole minutes, from rates (rates.read_rates) and work (jobs.Sizes).

    The number of threads does not reduce it, because part of the work runs on one thread.
    """
    source, factor = (stage, SAFETY) if stage in rates["seconds"] else PROXIES.get(stage, (stage, SAFETY))
    seconds = estimate(rates, source, work)
    least = FLOORS.get(stage, FLOOR_MINUTES)
    return UNKNOWN_MINUTES if seconds is None else max(least, math.ceil(factor * seconds / 60))


def diagnosis_minutes(most: float) -> int:
    """Return the time limit of a diagnosis in whole minutes, from the upper end of its forecast wall time, s."""
    return max(FLOORS["diagnose"], math.ceil(SLOWER_NODE * most / 60))
