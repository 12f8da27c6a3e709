"""Find the measure of trust that predicts the scanner best, in simulations and image perturbations (3 minutes).

First run `snakemake --cores 2`, copy results/features.csv, and run it again with config/whole_regions.yaml. Give the
2D features of one or several seeds with --features, and the 3D features with --whole-features. The measured tables are
the full ones of CT-Phantom4Radiomics (--table) and of the dose series (--dose-table).

For each measure and kind of change: Spearman's coefficient over features between the prediction and the scanner, and
the agreement of classes (robust, only within one protocol, avoid). Predictions are the simulated scans, and controls
on the drawn phantom (noise, image perturbation) or on one simulated scan (image perturbation).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from sklearn.metrics import cohen_kappa_score

from benchmarks import common, dose_prediction, tandem_groups
from benchmarks.common.perturbation import perturb, signed_distance
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import Branch, Stream, branch, generator, named, root
from virtual_phantom.features.extraction import extract
from virtual_phantom.features.names import FEATURES, VARIANCE
from virtual_phantom.io.volumes import Volume, read_nifti
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.statistics import measured
from virtual_phantom.statistics.agreement_measures import coefficient_of_variation, concordance, icc_agreement
from virtual_phantom.statistics.comparability import grows_with_roi
from virtual_phantom.statistics.stability_measures import feature_array
from virtual_phantom.statistics.wilcoxon import ranksum_z

SEED = 52
DRAWS = 100  # of each bootstrap
SUBSAMPLES = 30  # of the measured repeats
REPEATS_3D = 5  # of each control; the default study has five repeats at every dose
SCAN = Path("images/group_2/mgy10/seed00.nii.gz")  # of a results folder, the scan that is perturbed
SCAN_ROIS = Path("phantom/voxels_1_0p684_0p684/rois")
REFERENCE = 2  # its group

ICC_SETTINGS, ICC_REPEATS, CCC = "ICC(2,1) between settings", "ICC(1,1) over all scans", "CCC"
RC, CV = "repeatability coefficient / SD of regions", "coefficient of variation"
W_SHARE, W_MEAN = "share of |W| < 1", "mean |W|"
# {measure: cut-offs of a robust feature}. ICC: excellent and good by Koo and Li (2016); CCC, CV and W: defaults of the
# library. RC: a change between two scans of a region stays below the SD between regions.
CUT_OFFS = {
    ICC_SETTINGS: (0.9, 0.75),
    ICC_REPEATS: (0.9, 0.75),
    CCC: (0.9,),
    RC: (1.0,),
    CV: (0.1,),
    W_SHARE: (0.5,),
    W_MEAN: (1.0,),
}
SMALL_IS_ROBUST = (RC, CV, W_MEAN)
CLASSES = ("robust", "only within one protocol", "avoid")

DOSES = dose_prediction.DOSES
FBP, ITERATIVE = ([f"{name} {dose}" for dose in DOSES] for name in dose_prediction.RECONSTRUCTIONS)
FBP_GROUPS, ITERATIVE_GROUPS = tandem_groups.RECONSTRUCTIONS["fbp"], tandem_groups.RECONSTRUCTIONS["iterative"]
REPEATS_2D, REPEATS = "repeats, 2D", "repeats, 3D"
# {kind of change: sets of settings that differ by this change only}; measures are means over the sets.
KINDS_3D = {
    "dose, FBP": [FBP],
    "dose, iterative": [ITERATIVE],
    "reconstruction, 3D": list(zip(FBP, ITERATIVE, strict=True)),
    REPEATS: [(setting,) for setting in FBP + ITERATIVE],
}
KINDS_2D = {
    "thickness and kernel, FBP": [FBP_GROUPS],
    "thickness and kernel, iterative": [ITERATIVE_GROUPS],
    "reconstruction, 2D": list(zip(ITERATIVE_GROUPS, FBP_GROUPS, strict=True)),
    "all eight groups": [tandem_groups.SETS["all"]],
    REPEATS_2D: [(group,) for group in tandem_groups.SETS["all"]],
}
Measures = dict[str, np.ndarray]


@dataclass(frozen=True)
class Scans:
    """Features of scans.

    Attributes
    ----------
    values : ndarray, shape (features, regions, settings, repeats)
    settings : tuple of str or int
        Empty if perturbations of one image predict all changes; the axis of settings then has length 1.
    """

    values: np.ndarray
    settings: tuple

    @classmethod
    def of_table(cls, table: pd.DataFrame, setting: str, repeat: str, features: Sequence[str], source: str) -> Scans:
        """Rows of a table, with the repeats that all settings have in every region."""
        table = table.assign(group=table[setting], seed=table[repeat]).sort_values("roi")
        cells = table.groupby(["group", "roi"])["seed"]
        shared = set.intersection(*(set(seeds) for _, seeds in cells))
        chosen = table[table["seed"].isin(shared)]
        return cls(feature_array(chosen, features, source), tuple(np.sort(table["group"].unique())))

    @property
    def repeats(self) -> int:
        return self.values.shape[-1]

    def has(self, sets: list) -> bool:
        return not self.settings or {setting for one in sets for setting in one} <= set(self.settings)

    def sets(self, sets: list) -> Iterator[np.ndarray]:
        """Values of each set of settings."""
        if not self.settings:
            yield self.values
            return
        for one in sets:
            yield self.values[:, :, [self.settings.index(setting) for setting in one]]

    def take(self, regions: np.ndarray | None = None, repeats: np.ndarray | None = None) -> Scans:
        values = self.values if regions is None else self.values[:, regions]
        return Scans(values if repeats is None else values[..., repeats], self.settings)


def one_way(pooled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares between and within regions of scans (features, regions, scans): one-way analysis of variance."""
    means = pooled.mean(axis=-1)
    return pooled.shape[-1] * means.var(axis=-1, ddof=1), pooled.var(axis=-1, ddof=1).mean(axis=-1)


def w_statistics(x: np.ndarray) -> np.ndarray:
    """|W| of all pairs of settings, shape (pairs, features, regions)."""
    features, regions, settings, repeats = x.shape
    columns = np.moveaxis(x, (2, 3), (0, 1)).reshape(settings, repeats, -1)
    found = [ranksum_z(columns[a], columns[b]) for a, b in combinations(range(settings), 2)]
    return np.array(found).reshape(-1, features, regions)


def measures(x: np.ndarray) -> Measures:
    """All measures of scans (features, regions, settings, repeats); with one setting, its repeats are the settings.

    ICC(1,1), the repeatability coefficient (1.96 sqrt(2) times the SD within regions) and the coefficient of variation
    treat all scans of a region as repeats. W needs several settings.
    """
    alone = x.shape[2] == 1
    conditions = np.moveaxis(x, -1, -2) if alone else x
    pooled = x.reshape(*x.shape[:2], -1)
    between, within = one_way(pooled)
    number = pooled.shape[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = {
            ICC_SETTINGS: icc_agreement(conditions).value,
            ICC_REPEATS: (between - within) / (between + (number - 1) * within),
            CCC: concordance(conditions),
            RC: 1.96 * np.sqrt(2 * within) / pooled.mean(axis=-1).std(axis=-1, ddof=1),
            CV: coefficient_of_variation(x),
        }
    if not alone:
        w = w_statistics(x)
        found |= {W_SHARE: (w < 1).mean(axis=(0, 2)), W_MEAN: w.mean(axis=(0, 2))}
    return found


def mean_measures(scans: Scans, sets: list) -> Measures:
    """Mean over sets of settings of each measure."""
    found = [measures(x) for x in scans.sets(sets)]
    return {name: np.mean([one[name] for one in found], axis=0) for name in found[0]}


def identification(scans: Scans, sets: list) -> np.ndarray:
    """Share of scans whose region has the nearest mean, by feature: means of one setting, scans of another.

    With one setting, the mean of a region excludes the scan itself. Chance is one divided by the number of regions.
    """
    return np.mean([_identification(x) for x in scans.sets(sets)], axis=0)


def _identification(x: np.ndarray) -> np.ndarray:
    regions, settings, repeats = x.shape[1:]
    means = x.mean(axis=-1)
    own = np.arange(regions)[:, None]

    def share(reference, scans, mine):
        """Scans [f, n, r]; means of all regions [f, n, 1, m]; mean of the scan's region [f, n, r]."""
        others = np.abs(scans[..., None] - reference[:, None, None, :])
        others[:, own[:, 0], :, own[:, 0]] = np.inf
        return (np.abs(scans - mine) < others.min(axis=-1)).mean(axis=(-2, -1))

    if settings == 1:
        without_scan = (means * repeats - x[:, :, 0]) / (repeats - 1)  # broadcasts [f, n, 1] with [f, n, r]
        return share(means[..., 0], x[:, :, 0], without_scan)
    return np.mean(
        [share(means[:, :, a], x[:, :, b], means[:, :, [a]]) for a, b in permutations(range(settings), 2)], axis=0
    )


def order(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's coefficient over the features that have both values."""
    known = np.isfinite(one) & np.isfinite(other)
    return stats.spearmanr(one[known], other[known]).statistic


def with_repeats(scans: Scans, repeats: int, stream: Stream, sets: list) -> Measures:
    """Mean measures of random subsets of the repeats, because |W| depends on their number."""
    if repeats >= scans.repeats:
        return mean_measures(scans, sets)
    random = generator(stream)
    draws = [
        mean_measures(scans.take(repeats=random.choice(scans.repeats, repeats, replace=False)), sets)
        for _ in range(SUBSAMPLES)
    ]
    return {name: np.mean([draw[name] for draw in draws], axis=0) for name in draws[0]}


def draw_again(available: int, number: int, random: np.random.Generator) -> np.ndarray:
    """Regions or repeats drawn with replacement, of which at least three (or all, if fewer) differ."""
    while True:
        chosen = random.integers(available, size=number)
        if len(set(chosen)) >= min(3, available, number):
            return chosen


def region_draws(regions: int, draws: int) -> list[np.ndarray]:
    """The same regions for the scanner and all predictions, in 2D and 3D."""
    random = generator(root(SEED))
    return [draw_again(regions, regions, random) for _ in range(draws)]


@dataclass(frozen=True)
class Coefficient:
    """Spearman's coefficient between a prediction and the scanner.

    Attributes
    ----------
    value : float
        Mean over simulated seeds.
    draws : ndarray
        Bootstrap draws of regions, repeats and simulated seeds.
    """

    value: float
    draws: np.ndarray

    def __sub__(self, other: Coefficient) -> Coefficient:
        return Coefficient(self.value - other.value, self.draws - other.draws)

    def __str__(self) -> str:
        low, high = np.percentile(self.draws, [2.5, 97.5])
        return f"{self.value:.2f} ({low:.2f} to {high:.2f})"


def mean_coefficient(found: Sequence[Coefficient]) -> Coefficient:
    return Coefficient(np.mean([one.value for one in found]), np.mean([one.draws for one in found], axis=0))


Correlations = dict[tuple[str, str, str], Coefficient]  # by kind, measure and prediction


def correlations(
    scanner: Scans, predictions: dict[str, list[Scans]], kinds: dict, stream: Stream, draws: int = DRAWS
) -> Correlations:
    """Spearman's coefficient between each prediction and the scanner, for each measure and kind of change.

    A draw has the same regions in both and own repeats. It takes one of the simulated seeds.
    """
    regions, found = region_draws(scanner.values.shape[1], draws), {}

    def drawn(seeds: list[Scans], number: int, sets: list, own: Stream) -> list[Measures]:
        random = generator(own)
        return [
            mean_measures(one.take(chosen, draw_again(one.repeats, number, random)), sets)
            for chosen in regions
            for one in [seeds[random.integers(len(seeds))]]
        ]

    for kind, sets in kinds.items():
        known = {}
        for title, seeds in predictions.items():
            usable = [scans for scans in seeds if scans.has(sets)]
            if not usable:
                continue
            number = usable[0].repeats
            if number not in known:
                own = named(stream, kind, number)
                known[number] = with_repeats(scanner, number, own, sets), drawn([scanner], number, sets, own)
            real, real_draws = known[number]
            values = mean_order([mean_measures(scans, sets) for scans in usable], real)
            orders = [
                mean_order([one], other)
                for one, other in zip(drawn(usable, number, sets, named(stream, kind, title)), real_draws, strict=True)
            ]
            for name, value in values.items():
                found[kind, name, title] = Coefficient(value, np.array([one[name] for one in orders]))
    return found


def mean_order(predicted: Sequence[Measures], real: Measures) -> dict[str, float]:
    """Mean coefficient of several predictions, by measure that all have."""
    return {name: np.mean([order(one[name], real[name]) for one in predicted]) for name in real if name in predicted[0]}


def reliability(scanner: Scans, kinds: dict, stream: Stream, draws: int = 100) -> pd.DataFrame:
    """Mean Spearman's coefficient between halves of the measured repeats, and of the regions, by kind and measure."""
    rows = []
    for kind, sets in kinds.items():
        random = generator(named(stream, kind))
        half, regions = scanner.repeats // 2, scanner.values.shape[1]
        splits = {"repeats": [], "regions": []}
        for _ in range(draws):
            numbers = random.permutation(scanner.repeats)
            splits["repeats"].append(
                [scanner.take(repeats=part) for part in (numbers[:half], numbers[half : 2 * half])]
            )
        for chosen in combinations(range(1, regions), regions // 2 - 1):
            first = np.array([0, *chosen])
            splits["regions"].append([scanner.take(part) for part in (first, np.setdiff1d(range(regions), first))])
        for unit, pairs in splits.items():
            found = [[mean_measures(part, sets) for part in pair] for pair in pairs]
            rows += [
                {
                    "kind": kind,
                    "measure": name,
                    "halves": unit,
                    "order": np.mean([order(a[name], b[name]) for a, b in found]),
                }
                for name in found[0][0]
            ]
    return pd.DataFrame(rows)


def usefulness(scanner: Scans, predictions: dict[str, list[Scans]], kinds: dict, stream: Stream) -> pd.DataFrame:
    """Spearman's coefficient between robustness and the measured `identification` of regions, by kind and measure.

    For the scanner, the measure is from one half of the repeats and the identification from the other.
    """
    rows = []
    for kind, sets in kinds.items():
        truth = identification(scanner, sets)
        for title, seeds in predictions.items():
            found = [mean_measures(scans, sets) for scans in seeds if scans.has(sets)]
            rows += [
                {
                    "kind": kind,
                    "measure": name,
                    "source": title,
                    "order": sign(name) * np.mean([order(one[name], truth) for one in found]),
                }
                for name in (found[0] if found else ())
            ]
        random, half, halves = generator(named(stream, kind)), scanner.repeats // 2, {}
        for _ in range(SUBSAMPLES):
            numbers = random.permutation(scanner.repeats)
            known = mean_measures(scanner.take(repeats=numbers[:half]), sets)
            rest = identification(scanner.take(repeats=numbers[half:]), sets)
            for name, values in known.items():
                halves.setdefault(name, []).append(sign(name) * order(values, rest))
        rows += [
            {"kind": kind, "measure": name, "source": "scanner, other half", "order": np.mean(one)}
            for name, one in halves.items()
        ]
    return pd.DataFrame(rows)


def sign(name: str) -> int:
    """-1 for measures that are small for robust features."""
    return -1 if name in SMALL_IS_ROBUST else 1


def robust_bounds(scans: Scans, sets: list, repeats: int, stream: Stream, draws: int = DRAWS) -> Measures:
    """Bound of the 95 % bootstrap interval over regions that is less robust, for each measure."""
    random = generator(stream)
    found = [
        mean_measures(scans.take(chosen, random.choice(scans.repeats, repeats, replace=False)), sets)
        for chosen in region_draws(scans.values.shape[1], draws)
    ]
    return {
        name: np.nanpercentile([one[name] for one in found], 97.5 if name in SMALL_IS_ROBUST else 2.5, axis=0)
        for name in found[0]
    }


def classes(change: Measures, repeats: Measures) -> dict[tuple[str, float], np.ndarray]:
    """Index in CLASSES of each feature, by measure and cut-off; NaN bounds count as not robust."""
    found = {}
    for name, cut_offs in CUT_OFFS.items():
        for cut_off in cut_offs if name in change else ():
            passed = [
                sign(name) * known[name] >= sign(name) * cut_off if name in known else np.zeros(len(change[name]), bool)
                for known in (change, repeats)
            ]
            found[name, cut_off] = np.where(passed[0], 0, np.where(passed[1], 1, 2))
    return found


def class_agreement(
    scanner: Scans, predictions: dict[str, list[Scans]], kinds: dict, stream: Stream, draws: int = DRAWS
) -> pd.DataFrame:
    """Share of features in the same class as on the scanner, with Cohen's kappa, by kind, measure and prediction."""
    rows, real = [], {}
    (repeats,) = (kind for kind in kinds if kind in (REPEATS, REPEATS_2D))
    for title, seeds in predictions.items():
        # Some seeds have only one dose.
        usable = max(seeds, key=lambda scans: sum(scans.has(sets) for sets in kinds.values()))
        number, bounds = usable.repeats, {}
        for kind, sets in kinds.items():
            bounds[kind] = robust_bounds(usable, sets, number, named(stream, kind, title), draws)
            if (kind, number) not in real:
                real[kind, number] = robust_bounds(scanner, sets, number, named(stream, kind), draws)
        for kind in kinds.keys() - {repeats}:
            predicted = classes(bounds[kind], bounds[repeats])
            known = classes(real[kind, number], real[repeats, number])
            rows += [
                {
                    "kind": kind,
                    "measure": f"{name}, {cut_off:g}",
                    "source": title,
                    "percent": 100 * (one == known[name, cut_off]).mean(),
                    "kappa": kappa(one, known[name, cut_off]),
                    "predicted": " / ".join(map(str, np.bincount(one, minlength=3))),
                    "scanner": " / ".join(map(str, np.bincount(known[name, cut_off], minlength=3))),
                }
                for (name, cut_off), one in predicted.items()
            ]
    return pd.DataFrame(rows).sort_values(["kind", "measure", "source"], ignore_index=True)


def kappa(one: np.ndarray, other: np.ndarray) -> float:
    """Cohen's kappa of two classifications; NaN if all features are in one class."""
    if len({*one, *other}) == 1:
        return np.nan
    return cohen_kappa_score(one, other)


# ----- tables -----


def dose_scans(path: Path) -> Scans:
    """The measured dose series."""
    table = measured.load_full_dose_series(path)
    setting = table["reconstruction"] + " " + table["dose_mgy"].astype(str)
    return Scans.of_table(table.assign(setting=setting), "setting", "repeat", FEATURES, str(path))


def study_scans(path: Path) -> Scans:
    """3D features of a default study, with the settings of the dose series."""
    table = dose_prediction.read_studies([path])
    setting = table["reconstruction"] + " " + table["dose"].astype(str)
    return Scans.of_table(table.assign(setting=setting), "setting", "seed", FEATURES, str(path))


def group_scans(table: pd.DataFrame, repeat: str, source: str) -> Scans:
    """2D features of the eight groups."""
    return Scans.of_table(table, "group", repeat, tandem_groups.FEATURES, source)


# ----- controls -----

Realization = Callable[[np.ndarray, np.ndarray, Stream], tuple[np.ndarray, np.ndarray]]


def whole_regions(image: Volume, masks: dict[str, np.ndarray]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Image and mask around each region, with a margin where the image has one."""
    found = {}
    for name, mask in masks.items():
        box = tuple(
            slice(max(i.min() - tandem_groups.MARGIN, 0), i.max() + 1 + tandem_groups.MARGIN) for i in np.nonzero(mask)
        )
        found[name] = image.array[box].astype(np.float32), mask[box]
    return found


def realizations(regions: dict, realize: Realization, stream: Stream, repeats: int = REPEATS_3D) -> pd.DataFrame:
    """3D features of each region in several realizations, with the columns roi and seed."""
    grid_spacing, tables = dose_prediction.SPACING, []
    for roi, (image, mask) in regions.items():
        for seed in range(repeats):
            made, changed = realize(image, mask, named(stream, roi, seed))
            found = extract(Volume(made.astype(np.float32), Grid(mask.shape, grid_spacing)), {roi: changed})
            tables.append(found.assign(seed=seed))
    return pd.concat(tables, ignore_index=True)


def perturbation(image: np.ndarray, mask: np.ndarray, stream: Stream) -> tuple[np.ndarray, np.ndarray]:
    """Rotation, shift, noise and another contour."""
    return perturb(image, signed_distance(mask, dose_prediction.SPACING), generator(stream))


def dose_noise(name: str, dose: int, models: dict | None) -> Realization:
    """Noise of the large cyst's measured variance at a dose: white, or with the spectrum of a model."""
    sd = np.sqrt(dose_prediction.series()[dose_prediction.UNIFORM, name, dose].mean[VARIANCE])

    def realize(image, mask, stream):
        if models:
            return image + sd * models[name].sample(mask.shape, dose_prediction.SPACING, stream), mask
        return image + sd * generator(stream).standard_normal(mask.shape, np.float32), mask

    return realize


def one_image(table: pd.DataFrame, features: Sequence[str], source: str) -> Scans:
    """Perturbations of one image per region, which predict every change."""
    table = table.assign(group=0).sort_values("roi")
    # feature_array needs two groups; both have the same rows.
    array = feature_array(pd.concat([table, table.assign(group=1)]), features, source)
    return Scans(array[:, :, :1], ())


def dose_controls(regions: dict, scan: dict, stream: Stream) -> dict[str, list[Scans]]:
    """Controls of the dose series: noise on the drawn phantom, perturbation of it, and perturbation of one scan."""
    found = {}
    for title, models in {
        "white noise": None,
        "noise with the measured spectrum": dose_prediction.parameters()[0],
    }.items():
        tables = [
            realizations(regions, dose_noise(name, dose, models), named(stream, title, name, dose)).assign(
                setting=f"{name} {dose}"
            )
            for name in dose_prediction.RECONSTRUCTIONS
            for dose in DOSES
        ]
        found[title] = [Scans.of_table(pd.concat(tables, ignore_index=True), "setting", "seed", FEATURES, title)]
    for title, images in {"perturbation of the phantom": regions, "perturbation of one scan": scan}.items():
        table = realizations(images, perturbation, named(stream, title), 2 * REPEATS_3D)
        found[title] = [one_image(table, FEATURES, title)]
    return found


def group_controls(sections: dict, scan: dict, repeats: int, stream: Stream) -> dict[str, list[Scans]]:
    """The same for the eight groups; the phantom is on the voxels of each group."""
    known = measured.group_means().query("roi == @tandem_groups.UNIFORM").set_index("group")
    sd = np.sqrt(known[VARIANCE])
    made = {
        "white noise": (sections, tandem_groups.white_noise(sd)),
        "noise with the measured spectrum": (sections, tandem_groups.noise_with_spectrum(sd)),
        "perturbation of the phantom": (sections, tandem_groups.perturbation),
        "perturbation of one scan": ({REFERENCE: scan}, tandem_groups.perturbation),
    }
    found = {}
    for title, (images, realize) in made.items():
        table = tandem_groups.control(images, realize, repeats, named(stream, title))
        several = len(images) > 1
        found[title] = [
            group_scans(table, "seed", title) if several else one_image(table, tandem_groups.FEATURES, title)
        ]
    return found


def scan_masks(results: Path) -> tuple[Volume, dict[str, np.ndarray]]:
    """One scan of a finished study, with its regions."""
    if not (results / SCAN).is_file():
        raise InputError(f"{results / SCAN}: no such scan; give the results folder of a default study with --results")
    masks = {roi: read_nifti(results / SCAN_ROIS / f"{roi}.nii.gz").array > 0 for roi in measured.TISSUE_CLASSES}
    return read_nifti(results / SCAN), masks


def phantom_regions(study) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The drawn phantom without a scan around each region, on the voxels of the dose series."""
    drawn, stream = layout.read_layout(study.phantom.layout), branch(study.seed, Branch.PHANTOM)
    phantom = synthetic.build(drawn, dose_prediction.GRID, 1, stream)
    return whole_regions(phantom.image, {roi.name: roi.mask for roi in phantom.rois})


# ----- results -----


def without_size(
    scanner: Scans, predictions: dict[str, list[Scans]], kinds: dict, features: Sequence[str]
) -> pd.DataFrame:
    """Mean coefficient over kinds of change without the features that grow with the region, by measure."""
    kept = np.array([not grows_with_roi(feature) for feature in features])
    changes = {kind: sets for kind, sets in kinds.items() if kind not in (REPEATS, REPEATS_2D)}
    found = {}
    for kind, sets in changes.items():
        real = {name: values[kept] for name, values in mean_measures(scanner, sets).items()}
        for title, seeds in predictions.items():
            tables = [mean_measures(scans, sets) for scans in seeds if scans.has(sets)]
            if tables:
                cut = [{name: values[kept] for name, values in one.items()} for one in tables]
                found[kind, title] = mean_order(cut, real)
    return pd.DataFrame(found).T.groupby(level=1, sort=False).mean().T.round(2)


def correlation_table(found: Correlations, kinds: Sequence[str], title: str) -> pd.DataFrame:
    """Text "value (interval)" of one prediction by measure (rows) and kind, and the mean over kinds of change."""
    rows = {}
    for name in CUT_OFFS:
        cells = {kind: found[kind, name, title] for kind in kinds if (kind, name, title) in found}
        rows[name] = {kind: str(cell) for kind, cell in cells.items()}
        if changes := [cell for kind, cell in cells.items() if kind not in (REPEATS, REPEATS_2D)]:
            rows[name]["mean of changes"] = str(mean_coefficient(changes))
    return pd.DataFrame(rows).T


def differences(found: Correlations, kinds: Sequence[str]) -> pd.DataFrame:
    """Coefficient of the simulated scans less that of each control, mean over kinds of change, with intervals."""
    rows = []
    for title in dict.fromkeys(title for _, _, title in found if title != "simulated"):
        for name in CUT_OFFS:
            pairs = [
                (found[kind, name, "simulated"], found[kind, name, title])
                for kind in kinds
                if kind not in (REPEATS, REPEATS_2D) and (kind, name, title) in found
            ]
            if pairs:
                difference = str(mean_coefficient([one - other for one, other in pairs]))
                rows.append({"measure": name, "control": title, "difference": difference})
    return pd.DataFrame(rows).pivot(index="measure", columns="control", values="difference").reindex(list(CUT_OFFS))


def add_arguments(parser):
    folder = common.ROOT / "results"
    parser.add_argument("--table", type=Path, required=True, help="full table of CT-Phantom4Radiomics")
    parser.add_argument("--dose-table", type=Path, required=True, help="full table of the dose series")
    parser.add_argument("--features", type=Path, nargs="+", default=[folder / "features.csv"], help="2D features")
    parser.add_argument("--whole-features", type=Path, nargs="+", required=True, help="3D features")
    parser.add_argument("--results", type=Path, default=folder, help="results folder with the scan to perturb")


def run(options):
    study, stream = common.configuration("config/config.yaml"), root(SEED)
    simulated_2d = [
        group_scans(tandem_groups.read_simulated(path, study, "mgy10"), "seed", str(path)) for path in options.features
    ]
    simulated_3d = [study_scans(path) for path in options.whole_features]
    image, masks = scan_masks(options.results)
    sections = {roi: tandem_groups.largest_section(image, mask) for roi, mask in masks.items()}
    controls_2d = group_controls(tandem_groups.clean_sections(study), sections, simulated_2d[0].repeats, stream)
    controls_3d = dose_controls(phantom_regions(study), whole_regions(image, masks), stream)
    scanner = group_scans(measured.load_full_table(options.table), "acquisition", str(options.table))
    predictions = {"simulated": simulated_2d} | controls_2d
    report("2D", scanner, predictions, KINDS_2D, tandem_groups.FEATURES, stream)
    predictions = {"simulated": simulated_3d} | controls_3d
    report("3D", dose_scans(options.dose_table), predictions, KINDS_3D, FEATURES, stream)


def report(
    title: str,
    scanner: Scans,
    predictions: dict[str, list[Scans]],
    kinds: dict,
    features: Sequence[str],
    stream: Stream,
    draws: int = DRAWS,
) -> None:
    """Print all tables of one dimension."""
    print(f"\n{title}: {scanner.repeats} measured repeats of {scanner.values.shape[1]} regions")
    found = correlations(scanner, predictions, kinds, named(stream, title), draws)
    print("Spearman's coefficient over features with the scanner; 95 % bootstrap intervals: regions, repeats and seeds")
    for source in predictions:
        print(f"\n{source}\n{correlation_table(found, list(kinds), source).to_string()}")
    print(f"\nsimulated scans less control, mean of changes\n{differences(found, list(kinds)).to_string()}")

    rest = without_size(scanner, predictions, kinds, features)
    print(f"\nwithout features that grow with the region, mean of changes\n{rest.to_string()}")

    def wide(rows: pd.DataFrame, columns: str, value: str) -> str:
        table = rows.pivot(index=["measure", columns], columns="kind", values=value).reindex(columns=list(kinds))
        changes = table.drop(columns=[REPEATS, REPEATS_2D], errors="ignore")
        return table.assign(**{"mean of changes": changes.mean(axis=1)}).round(2).to_string()

    reliable = reliability(scanner, kinds, named(stream, title, "halves"))
    print(f"\nbetween halves of the scanner's repeats or regions\n{wide(reliable, 'halves', 'order')}")
    useful = usefulness(scanner, predictions, kinds, named(stream, title, "identification"))
    print(f"\nrobustness and measured identification of regions\n{wide(useful, 'source', 'order')}")
    agreement = class_agreement(scanner, predictions, kinds, named(stream, title, "classes"), draws)
    for value in ("percent", "kappa"):
        print(f"\nfeatures in the same class as on the scanner, {value}\n{wide(agreement, 'source', value)}")
    print(f"\nclasses: {' / '.join(CLASSES)}\n{agreement.to_string()}")
