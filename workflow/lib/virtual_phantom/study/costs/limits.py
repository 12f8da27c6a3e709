"""How long jobs may take: what a cluster is asked for, from measured rates with room to spare."""

from __future__ import annotations

import math
from collections.abc import Mapping

from .rates import estimate

# Two because estimates far from the measured scale are good to that, and two for a slower node with busy neighbours.
SLOWER_NODE = 2.0
SAFETY = 2.0 * SLOWER_NODE
# Of any job: Python from a shared file system that is slow, kernels compiled again for another processor.
FLOOR_MINUTES = 10
# Of features: rates count images, and regions as large as organs take many times what those of the measured study took.
# Of a diagnosis: one that is cut off goes on from the fits that it has kept.
FLOORS = {"extract": 30, "diagnose": 60}
# Of a stage that nothing is known of: rates of one's own may leave out what one's study had no jobs of.
UNKNOWN_MINUTES = 240
# Stages that were not measured: which rates are taken, and how many times what they give.
STAND_INS = {
    # Voxel-driven back-projection is faster than the adjoint (docs/explanation/performance.md).
    "reconstruct_sirt_voxel": ("reconstruct_sirt", SAFETY),
    # An H100 took 1/16 of the time of 16 threads (docs/explanation/performance.md). Other GPUs are slower: the time of
    # one core, without a factor.
    "reconstruct_sirt_astra_cuda": ("reconstruct_sirt", 1.0),
    # All eighteen effects on projections at once took up to 27 times clean projections alone (benchmarks/effects.py).
    "project_physics": ("project", 27 * SAFETY),
}


def minutes(rates: dict, stage: str, work: Mapping[str, float]) -> int:
    """Whole minutes that a job may take, never under its floor.

    Threads are not counted, as part of the work runs in one however many there are.

    Parameters
    ----------
    rates : dict
        As rates.read_rates gives them.
    work : mapping of str to float
        {unit: amount}, as jobs.Sizes gives it.
    """
    source, times = (stage, SAFETY) if stage in rates["seconds"] else STAND_INS.get(stage, (stage, SAFETY))
    seconds = estimate(rates, source, work)
    least = FLOORS.get(stage, FLOOR_MINUTES)
    return UNKNOWN_MINUTES if seconds is None else max(least, math.ceil(times * seconds / 60))


def diagnosis_minutes(most: float) -> int:
    """Whole minutes that a diagnosis may take, never under its floor.

    Parameters
    ----------
    most : float
        The upper end of its forecast of wall time, s.
    """
    return max(FLOORS["diagnose"], math.ceil(SLOWER_NODE * most / 60))
