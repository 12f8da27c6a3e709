"""Measure the coverage of the intervals of ICC between two settings on simulated tables (1 minute).

Each row simulates features with a known ICC: normal regions, changes between the settings, and five repeats, where
changes and noise have equal variance. For comparison: percentiles of the bootstrap over regions.
"""

import numpy as np

from virtual_phantom.base.streams import branch, generator
from virtual_phantom.statistics.changes import Change, agreement

SEED, BRANCH = 1, 1001  # not used by studies
SAMPLES = 200  # of the bootstrap
CASES = [(regions, icc) for regions in (6, 12, 30) for icc in (0.5, 0.75, 0.9, 0.97)]


def drawn(rng, tables, regions, icc, repeats=5):
    """Values [table, region, setting, repeat] with the variance 1."""
    parts = ((icc, (1, 1)), ((1 - icc) / 2, (2, 1)), ((1 - icc) / 2, (2, repeats)))
    return sum(np.sqrt(variance) * rng.standard_normal((tables, regions, *shape)) for variance, shape in parts)


def estimated(x):
    """Return the ICC with its interval of every table."""
    classes = ["tissue"] * x.shape[1]
    return agreement([Change("test", "a", "b", x[:, :, 0], x[:, :, 1], "paired")], classes).measures["icc"]


def percentiles(x, rng):
    """Return the percentile interval of the bootstrap over regions of every table."""
    found = []
    for _ in range(SAMPLES):
        chosen = rng.integers(x.shape[1], size=x.shape[:2])
        found.append(estimated(np.take_along_axis(x, chosen[..., None, None], axis=1)).value)
    return np.nanpercentile(found, [2.5, 97.5], axis=0)


def add_arguments(parser):
    parser.add_argument("--tables", type=int, default=1000, help="simulated tables per row")


def run(options):
    print("| regions | ICC | jackknife: coverage, % | lower limit, median | bootstrap: coverage, % |")
    print("|---|---|---|---|---|")
    for number, (regions, icc) in enumerate(CASES):
        rng = generator(branch(SEED, BRANCH, number))
        x = drawn(rng, options.tables, regions, icc)
        found = estimated(x)
        low, high = percentiles(x, rng)
        shares = (100 * ((a <= icc) & (icc <= b)).mean() for a, b in ((found.low, found.high), (low, high)))
        jackknife, bootstrap = (f"{share:.1f}" for share in shares)
        print(f"| {regions} | {icc:g} | {jackknife} | {np.median(found.low):.2f} | {bootstrap} |", flush=True)
