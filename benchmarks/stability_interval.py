"""Measure the coverage of the confidence interval of a feature's stability on simulated tables (30 minutes).

Each table has features of six ROIs. Every eighth feature gets new group means, whose true stability is the mean over
2000 further tables. For comparison, the interval of plain subsampling: 1.96 times the SD over 100 subsamples of half
the repeats, divided by sqrt(1 - m/n). With --features, means, SDs and shared noise come from a completed default study.
"""

from pathlib import Path

import numpy as np

from virtual_phantom.base.streams import branch, generator
from virtual_phantom.features import tables
from virtual_phantom.features.names import FEATURES
from virtual_phantom.statistics import stability_interval, stability_measures

ROIS, KINDS, TRUTH, DRAWS = 6, 8, 2000, 100
SEED, BRANCH = 1, 1000  # not used by studies
GROUPS = {
    f"{kind}_{views}": place
    for place, (kind, views) in enumerate(
        ((kind, views) for kind in ("sirt", "fbp") for views in (150, 200, 250, 300)), 1
    )
}


def skewed(rng, shape):
    """Lognormal numbers of skewness 1.75, mean 0 and SD 1."""
    variance = np.exp(0.25)
    return (np.exp(0.5 * rng.standard_normal(shape)) - np.sqrt(variance)) / np.sqrt(variance * (variance - 1))


def halves(rng, shape):
    """Normal numbers; groups g and g + G/2 have a correlation of 0.8."""
    common = rng.standard_normal((*shape[:-2], shape[-2] // 2, shape[-1]))
    return np.sqrt(0.8) * np.concatenate([common, common], axis=-2) + np.sqrt(0.2) * rng.standard_normal(shape)


def everywhere(rng, shape):
    """Normal numbers; all groups have a correlation of 0.5, as with common random numbers."""
    common = rng.standard_normal((*shape[:-2], 1, shape[-1]))
    return np.sqrt(0.5) * (common + rng.standard_normal(shape))


def subsampled(x, half, rng):
    """SD of the stability by independent subsampling of each group of x[roi, group, repeat]."""
    rois, groups, repeats = x.shape
    size = half.noise.shape[-1]
    chosen = rng.random((DRAWS, 1, groups, repeats)).argsort(axis=-1)[..., :size]
    drawn = np.take_along_axis(
        np.broadcast_to(x, (DRAWS, *x.shape)), np.broadcast_to(chosen, (DRAWS, rois, groups, size)), -1
    )
    return half.stability(drawn).std(ddof=1) / np.sqrt(1 - size / repeats)


# Name: noise, and whether groups g and g + G/2 share it.
NOISE = {
    "normal": (np.random.Generator.standard_normal, False),
    "skewed": (skewed, False),
    "shared in twos": (halves, True),
    "shared by all": (everywhere, False),
}
# Groups, repeats, noise, and SD of the group means relative to the noise (times a lognormal number per ROI).
CASES = (
    *((8, 10, "normal", spread) for spread in (0.0, 0.3, 1.0, 3.0, 10.0)),
    (8, 10, "skewed", 1.0),
    (8, 10, "shared in twos", 1.0),
    (8, 10, "shared by all", 0.3),
    *((4, 3, "normal", spread) for spread in (0.0, 0.3, 1.0, 3.0, 10.0)),
    (4, 3, "skewed", 1.0),
    *((2, 10, "normal", spread) for spread in (0.0, 0.3, 1.0, 3.0)),
    *((4, 20, "normal", spread) for spread in (0.3, 1.0)),
)


def of_kinds(means, sds, noise, repeats, sharing, tables_of_each, rng):
    """One row per table: truth, two standard errors, interval and subsampling interval."""
    _, rois, groups = means.shape
    units = [[roi] for roi in range(rois)]
    shared = np.equal.outer(sharing, sharing)
    made = stability_interval._Design.of
    design = made((rois, groups), repeats, units, 1.0, stability_interval.SIMULATIONS)
    half = made((rois, groups), max(2, repeats // 2), units, 1.0, 1)
    rows = []
    for mean, sd in zip(means, sds, strict=True):

        def drawn(number, mean=mean, sd=sd):
            return mean[..., None] + sd[..., None] * noise(rng, (number, rois, groups, repeats))

        truths = design.stability(drawn(TRUTH))
        truth, error_of_truth = truths.mean(), 2 * truths.std() / np.sqrt(TRUTH)
        for one in drawn(tables_of_each):
            value = design.stability(one[None])[0]
            error = 1.96 * subsampled(one, half, rng)
            interval = stability_interval._ScaledStudies(one, shared, design).interval(value)
            rows.append((truth, error_of_truth, *interval, value - error, value + error))
    return np.array(rows)


def line(title, rows):
    truth, near, low, high, plain_low, plain_high = rows.T
    covered = (low - near <= truth) & (truth <= high + near)
    plain = (plain_low <= truth) & (truth <= plain_high)
    outside = covered.mean(), (truth < low - near).mean(), (truth > high + near).mean()
    shares = truth.mean(), *outside, (high - low).mean(), plain.mean(), (plain_high - plain_low).mean()
    print(f"| {title} | " + " | ".join(f"{100 * value:.1f}" for value in shares) + " |", flush=True)


def add_arguments(parser):
    parser.add_argument("--features", type=Path, help="features.csv of a completed default study")
    parser.add_argument("--tables", type=int, default=400, help="simulated tables per row")


def run(options):
    print("| | truth | held | below | above | width | subsampling: held | width |\n|---|---|---|---|---|---|---|---|")
    if options.features:
        real(options.features, options.tables)
        return
    for number, (groups, repeats, name, spread) in enumerate(CASES):
        noise, twos = NOISE[name]
        sharing = [group % (groups // 2) if twos else group * (name != "shared by all") for group in range(groups)]
        rng = generator(branch(SEED, BRANCH, number))
        means = spread * rng.standard_normal((KINDS, ROIS, groups))
        means *= np.exp(0.5 * rng.standard_normal((KINDS, ROIS, 1)))
        rows = of_kinds(means, np.ones_like(means), noise, repeats, sharing, options.tables // KINDS, rng)
        line(f"{groups} groups, {repeats} repeats, {name}, {spread:g}", rows)


def real(path, number):
    """Coverage with the means, SDs and SIRT-FBP correlation of a study's features."""
    table = tables.read_groups(path, GROUPS, noise=dict.fromkeys(GROUPS, "dose10"), seeds=10)
    x = stability_measures.feature_array(table, FEATURES)
    rng = generator(branch(SEED, BRANCH))
    sharing = [0, 1, 2, 3] * 2
    shared = np.equal.outer(sharing, sharing)
    rows = []
    for one in x:
        sd = one.std(axis=-1, ddof=1)
        root = stability_interval._root_of_correlation(one, sd, shared)

        def noise(rng, shape, root=root):
            return np.einsum("gh,srhn->srgn", root, rng.standard_normal(shape))

        rows.append(of_kinds(one.mean(axis=-1)[None], sd[None], noise, 10, sharing, max(2, number // len(x)), rng))
    rows = np.concatenate(rows)
    line("all features", rows)
    for least, most in ((0, 0.02), (0.02, 0.05), (0.05, 0.15), (0.15, 1)):
        line(f"truth {100 * least:g} to {100 * most:g} %", rows[(rows[:, 0] >= least) & (rows[:, 0] < most)])
