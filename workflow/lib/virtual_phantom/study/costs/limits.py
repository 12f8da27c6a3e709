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
# Factors of stages whose time depends on more than their work.
FACTORS = {
    # The rate is of an H100 (docs/explanation/performance.md); small GPUs have an eighth of its arithmetic speed.
    "reconstruct_sirt_astra_cuda": 8 * SAFETY,
    # The rate is of a spectrum; all effects together took up to 27 times as long (benchmarks/effects.py).
    "project_physics": 27 * SAFETY,
}


def minutes(rates: dict, stage: str, work: Mapping[str, float]) -> int:
    """Return the time limit of a job in whole minutes, from rates (rates.read_rates) and work (jobs.Sizes).

    The number of threads does not reduce it, because part of the work runs on one thread.
    """
    seconds = estimate(rates, stage, work)
    least, factor = FLOORS.get(stage, FLOOR_MINUTES), FACTORS.get(stage, SAFETY)
    return UNKNOWN_MINUTES if seconds is None else max(least, math.ceil(factor * seconds / 60))


def diagnosis_minutes(most: float) -> int:
    """Return the time limit of a diagnosis in whole minutes, from the upper end of its forecast wall time, s."""
    return max(FLOORS["diagnose"], math.ceil(SLOWER_NODE * most / 60))
