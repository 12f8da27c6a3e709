"""Compare the time of Poisson sampling by inversion with NumPy's and SciPy's (1 minute).

Prints medians of CPU time with one thread; the three methods take turns. Also prints how much the counts change if the
means change by a relative 1e-7.
"""

import numpy as np
from scipy import stats

from benchmarks import common
from virtual_phantom.physics.noise.poisson import poisson_counts

ONE_THREAD = True
COUNTS, FEW, REPEATS = 500_000, 2_000, 7
MEANS = (0.1, 1, 5, 20, 1e2, 1e3, 1e4, 1e5, 1e7, 1e9)


def run(_options):
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(1)))
    for middle in MEANS:
        means = middle * random.uniform(0.8, 1.2, COUNTS)
        inversion, numpy, scipy = common.medians(
            [
                lambda means=means: poisson_counts(means, random),
                lambda means=means: random.poisson(means),
                lambda means=means: stats.poisson.ppf(random.random(FEW), means[:FEW]),
            ],
            REPEATS,
        )
        scipy *= COUNTS / FEW
        print(
            f"mean {middle:g}: Virtual Phantom {1e9 * inversion / COUNTS:.0f} ns per count; "
            f"NumPy's {numpy / inversion:.2f} times, SciPy's ppf {scipy / inversion:.0f} times as long",
            flush=True,
        )
    means = 5e4 * random.uniform(0.8, 1.2, COUNTS)
    for name, draw in (("Virtual Phantom", poisson_counts), ("NumPy's", lambda means, random: random.poisson(means))):
        here, there = (draw(each, np.random.default_rng(2)) - means for each in (means, means * (1 + 1e-7)))
        moved = np.abs(there - here)
        print(
            f"means of 5e4 times 1 + 1e-7, {name}: {100 * (moved > 0).mean():.2f} % of counts move, by up to "
            f"{moved.max():.0f}; correlation of the noise {np.corrcoef(here, there)[0, 1]:.4f}"
        )
