"""Compare stability and discriminative power of simulated groups with measured ones and with controls (4 minutes).

First run `snakemake --cores 2`. --table is the full table of CT-Phantom4Radiomics (features of the largest section,
stored values), --features one table of the study or several with different seeds. Measured scores are from random
subsets with as many acquisitions as the study has repeats. The controls add noise to the clean virtual phantom on the
voxels of each group, or perturb it. Prints the tables of docs/validation/printed-phantom.md.

--store reads results folders of default studies with other seeds instead, which --seeds names in the same order. It
writes default_study_seeds.csv of the library.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import ndimage, stats

from benchmarks import common, dose_prediction
from benchmarks.common.perturbation import perturb, signed_distance
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, grid_of
from virtual_phantom.base.streams import Branch, Stream, branch, generator, named, root
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.settings import Study
from virtual_phantom.features import extraction, names
from virtual_phantom.features.hu_offset import STORED_OFFSET_HU, convert_to_hu
from virtual_phantom.features.names import MEAN, VARIANCE
from virtual_phantom.features.parameters import LARGEST, read_parameters
from virtual_phantom.features.table_files import read_table
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io.files import replacing
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.reconstruction.boxes import voxels_over
from virtual_phantom.statistics import further_seeds, measured, repeats, wilcoxon
from virtual_phantom.statistics.rank_sum import differing_probability

SEED = 4732
RECONSTRUCTIONS = {"fbp": (2, 4, 6, 8), "iterative": (1, 3, 5, 7)}
SETS = {**RECONSTRUCTIONS, "all": tuple(range(1, 9))}
FEATURES = measured.PHANTOM4RADIOMICS_FEATURES
KINDS = ("stability", "discrimination", "same_class")
SKEWNESS = "original_firstorder_Skewness"
CORRELATION = "original_glcm_Correlation"
UNIFORM = "cyst_1"  # its SD in a group is the noise of the controls
MARGIN = 8  # voxels, for perturbations


def read_simulated(path: Path, study: Study, level: str) -> pd.DataFrame:
    """Features of stored values, with the columns group, roi, tissue_class and seed; InputError for other features."""
    table = read_table(path)
    require_published_features(table, path)
    table = table[table["noise"] == level]
    table = table.assign(group=table["protocol"].map(Plan(study).groups())).dropna(subset="group")
    if missing := set(SETS["all"]) - set(table["group"]):
        raise InputError(f"{path}: lacks group {min(missing)} at noise level {level}; choose another with --level")
    return convert_to_hu(table, -STORED_OFFSET_HU)


def require_published_features(table: pd.DataFrame, path: Path) -> None:
    """InputError for other features than those of the largest section and stored values."""
    if set(table["settings_hash"]) != {read_parameters(None, LARGEST, STORED_OFFSET_HU).hash()}:
        raise InputError(
            f"{path}: has other features than those of the largest section and stored values; run the study with "
            "features: {section: largest, stored_offset_hu: 1024}"
        )


def seed_scores(folders: list[Path], seeds: list[int], plan: Plan) -> pd.DataFrame:
    """Scores of finished studies that differ in their seed only: the content of default_study_seeds.csv."""
    if len(seeds) < 2 or len(folders) != len(seeds) or len(set(seeds)) != len(seeds) or plan.study.seed in seeds:
        raise InputError(
            f"--seeds: {seeds} for {len(folders)} folders of --store; give one seed per folder, at least two, all "
            f"different and none of them {plan.study.seed}, the seed of the default study"
        )
    noise, found = plan.compared_levels(), []
    for folder, seed in zip(folders, seeds, strict=True):
        path = folder / "features.csv"
        table = read_groups(path, plan.groups(), noise=noise, seeds=plan.repeats(noise.values()))
        require_published_features(table, path)
        rows = wilcoxon.scores(table, names.FEATURES)[["feature", "stability_percent", "discrimination_percent"]]
        rows.insert(0, "settings", plan.scored_settings())
        rows.insert(1, "seed", seed)
        found.append(rows.round(6))
    return pd.concat(found, ignore_index=True)


def scores(table: pd.DataFrame, features=FEATURES) -> pd.DataFrame:
    """Percent by set of groups and feature (index): stability, discrimination, and that of regions of one class."""
    found = {}
    for name, groups in SETS.items():
        chosen = table[table["group"].isin(groups)]
        table_of = wilcoxon.scores(chosen, features).set_index("feature")
        found[name] = pd.DataFrame(
            {
                "stability": table_of["stability_percent"],
                "discrimination": table_of["discrimination_percent"],
                "same_class": same_class(chosen, features),
            }
        )
    return pd.concat(found, names=["set"])


def same_class(table: pd.DataFrame, features=FEATURES) -> pd.Series:
    """Percent of pairs of regions of the same tissue class with |W| > 1, by feature."""
    found = wilcoxon.comparisons(table, features)
    differing = np.concatenate([found.differing[pair] for pair in found.pairs(same_class=True)])
    return pd.Series(np.where(found.varies, 100 * differing.mean(axis=0), np.nan), features)


def paired_and_independent(table: pd.DataFrame, unit: str, draws: int = 30, features=FEATURES) -> pd.DataFrame:
    """Mean stability, percent, over all pairs of groups, of shared acquisitions and of different ones.

    Each draw splits the acquisitions that all groups have into two halves. Paired: both groups of a comparison have the
    first half. Independent: the second group has the other half.
    """
    shared = repeats.shared_units(table, unit)
    size, rows = len(shared) // 2, []
    values = {key: part.set_index(unit)[list(features)] for key, part in table.groupby(["group", "roi"])}
    for stream in root(SEED).spawn(draws):
        first, second = generator(stream).permutation(shared)[: 2 * size].reshape(2, size)
        stable = {"paired": [], "independent": []}
        for a, b in combinations(sorted(table["group"].unique()), 2):
            for roi in table["roi"].unique():
                for name, other in zip(stable, (first, second), strict=True):
                    samples = values[a, roi].loc[first], values[b, roi].loc[other]
                    stable[name].append(wilcoxon.ranksum_z(*(one.to_numpy() for one in samples)) < 1)
        rows.append({name: 100 * np.mean(found) for name, found in stable.items()} | {"acquisitions": size})
    return pd.DataFrame(rows)


@dataclass(frozen=True)
class Section:
    """The clean virtual phantom around the largest section of a region, on the voxels of a group.

    Attributes
    ----------
    image : ndarray of float32, shape (z, y, x)
        HU.
    height : int
        Index of the section along z.
    mask : ndarray of bool, shape (y, x)
    spacing : tuple of 3 float
        Voxel size, mm (z, y, x).
    """

    image: np.ndarray
    height: int
    mask: np.ndarray
    spacing: tuple[float, float, float]


def clean_sections(study: Study) -> dict[int, dict[str, Section]]:
    """Sections by group and region."""
    drawn, stream = layout.read_layout(study.phantom.layout), branch(study.seed, Branch.PHANTOM)
    on_voxels, found = {}, {}
    for protocol in study.protocols.values():
        if protocol.group is None:
            continue
        spacing = tuple(protocol.voxels.spacing_mm)
        if spacing not in on_voxels:
            phantom = synthetic.build(drawn, voxels_over(grid_of(study.grid), spacing), 1, stream)
            on_voxels[spacing] = {roi.name: largest_section(phantom.image, roi.mask) for roi in phantom.rois}
        found[protocol.group] = on_voxels[spacing]
    return found


def largest_section(image: Volume, mask: np.ndarray) -> Section:
    height = int(np.count_nonzero(mask, axis=(1, 2)).argmax())
    (box,) = ndimage.find_objects(mask[height].astype(np.uint8))
    plane = tuple(slice(part.start - MARGIN, part.stop + MARGIN) for part in box)
    first = max(height - MARGIN, 0)
    part = image.array[(slice(first, height + MARGIN + 1), *plane)]
    return Section(part.astype(np.float32), height - first, mask[height][plane], image.grid.spacing)


Realization = Callable[[Section, int, Stream], tuple[np.ndarray, np.ndarray]]


def white_noise(sd: pd.Series) -> Realization:
    """White noise with the SD of each group."""

    def realize(section, group, stream):
        noise = generator(stream).standard_normal(section.mask.shape)
        return section.image[section.height] + sd[group] * noise, section.mask

    return realize


def noise_with_spectrum(sd: pd.Series) -> Realization:
    """Noise with the SD of each group, and the spectrum that its reconstruction has on the scanner."""
    models, _, _ = dose_prediction.parameters()

    def realize(section, group, stream):
        (name,) = (name for name, groups in RECONSTRUCTIONS.items() if group in groups)
        noise = models[name].sample((1, *section.mask.shape), section.spacing, stream)[0]
        return section.image[section.height] + sd[group] * noise, section.mask

    return realize


def perturbation(section: Section, group: int, stream: Stream) -> tuple[np.ndarray, np.ndarray]:
    """Rotation, shift, noise and another contour."""
    distance = signed_distance(section.mask, section.spacing[1:])
    image, changed = perturb(section.image, distance, generator(stream))
    return image[section.height], changed


def control(
    sections: dict[int, dict[str, Section]], realize: Realization, count: int, stream: Stream, by_group: bool = True
) -> pd.DataFrame:
    """Features of stored values of every group and region in `count` realizations; HU are whole numbers.

    With `by_group` false, groups share random numbers: noise is the same on voxels of the same size.
    """
    parameters = read_parameters(None, LARGEST, STORED_OFFSET_HU)
    tables = []
    for group, regions in sections.items():
        for roi, section in regions.items():
            for seed in range(count):
                name = (roi, seed, group) if by_group else (roi, seed)
                image, mask = realize(section, group, named(stream, *name))
                grid = Grid((1, *mask.shape), section.spacing)
                volume = Volume(np.rint(image)[None].astype(np.float32), grid)
                with warnings.catch_warnings():  # clean regions fill few gray levels
                    warnings.simplefilter("ignore", extraction.RadiomicsWarning)
                    found = extraction.extract(volume, {roi: mask[None]}, parameters=parameters)
                tables.append(found.assign(group=group, seed=seed, tissue_class=measured.TISSUE_CLASSES[roi]))
    return convert_to_hu(pd.concat(tables, ignore_index=True), -STORED_OFFSET_HU)


def halves(table: pd.DataFrame, draws: int = 30) -> Iterator[tuple[pd.DataFrame, pd.DataFrame]]:
    """Random halves of the acquisitions that all groups have."""
    shared = repeats.shared_units(table, "acquisition")
    for stream in root(SEED).spawn(draws):
        order = generator(stream).permutation(shared)
        size = len(shared) // 2
        yield tuple(table[table["acquisition"].isin(part)] for part in (order[:size], order[size : 2 * size]))


def spearman(one: pd.DataFrame, other: pd.DataFrame, kind: str = "stability") -> pd.Series:
    """Spearman's coefficient over features of two tables of `scores`, by set of groups."""
    return pd.Series({name: stats.spearmanr(one.loc[name, kind], other.loc[name, kind]).statistic for name in SETS})


def means(found: pd.DataFrame) -> pd.DataFrame:
    """Mean over features of `scores`, by set of groups."""
    return found.groupby(level="set", sort=False)[list(KINDS)].mean()


def mean_and_sd(tables: list[pd.DataFrame], fraction: float = 0.0) -> pd.DataFrame:
    """Text "mean ± SD" for each cell of equal tables; `fraction` of the available repeats is in each draw."""
    values = np.stack([table.to_numpy() for table in tables])
    sd = repeats.sd_of_draws(values, fraction)
    text = [
        [f"{mean:.1f}" + ("" if np.isnan(s) else f" ± {s:.1f}") for mean, s in zip(*row, strict=True)]
        for row in zip(values.mean(axis=0), sd, strict=True)
    ]
    return pd.DataFrame(text, tables[0].index, tables[0].columns)


def regions_table(table: pd.DataFrame) -> pd.DataFrame:
    """Mean HU, SD and GLCM correlation of each region, by group: mean over repeats, and SD over repeats."""
    rows = table.assign(mean=table[MEAN] - STORED_OFFSET_HU, sd=np.sqrt(table[VARIANCE]), grain=table[CORRELATION])
    found = rows.groupby(["roi", "group"])[["mean", "sd", "grain"]].agg(["mean", "std"])
    names_of = ("mean", "SD", "GLCM correlation")
    found.columns = [name + suffix for name in names_of for suffix in ("", ", SD over repeats")]
    return found.unstack("group").stack(level=0, future_stack=True).round(3)


def print_spearman(title: str, found: list[pd.Series]) -> None:
    table = pd.DataFrame(found)
    values = (f"{name} {table[name].mean():.2f} ± {table[name].std():.2f}" for name in table)
    print(f"{title}: {', '.join(values)}")


def add_arguments(parser):
    inputs = parser.add_mutually_exclusive_group(required=True)
    inputs.add_argument("--table", type=Path, help="full table of CT-Phantom4Radiomics")
    inputs.add_argument("--store", type=Path, nargs="+", metavar="FOLDER", help="results folders of further seeds")
    parser.add_argument("--seeds", type=int, nargs="+", default=[], help="seed of each folder")
    parser.add_argument("--features", type=Path, nargs="+", default=[common.ROOT / "results" / "features.csv"])
    parser.add_argument("--configfile", nargs="+", default=["config/config.yaml"])
    parser.add_argument("--level", default="mgy10", help="noise level (default mgy10)")


def run(options):
    study = common.configuration(*options.configfile)
    if options.store:
        found = seed_scores(options.store, options.seeds, Plan(study))
        with replacing(RESOURCES / "default_study_seeds.csv", checksum=False) as temporary:
            found.to_csv(temporary, index=False, lineterminator="\n")
        print("SD of the mean scores over seeds, percent:", further_seeds.sd_over_seeds(found))
        return
    simulated = [read_simulated(path, study, options.level) for path in options.features]
    count = simulated[0].groupby(["group", "roi"]).size().min()
    full = measured.load_full_table(options.table)
    fixed = full[full["repositioned"] == 0]
    sd = np.sqrt(measured.group_means().query("roi == @UNIFORM").set_index("group")[VARIANCE])
    sections, stream = clean_sections(study), root(SEED)
    noise = {"white noise": white_noise(sd), "noise with the measured spectrum": noise_with_spectrum(sd)}
    controls = {title: control(sections, one, count, named(stream, title)) for title, one in noise.items()}
    for title, one in noise.items():
        shared = f"{title}, the same in all groups"
        controls[shared] = control(sections, one, count, named(stream, shared), by_group=False)
    controls["image perturbation"] = control(sections, perturbation, count, named(stream, "perturbation"))

    draws, available = {}, {}
    for title, rows in {"measured, not re-positioned": fixed, "measured, all acquisitions": full}.items():
        chosen = list(repeats.subsamples(rows, count, "acquisition", shared=True))
        draws[title], available[title] = [scores(one) for one, _ in chosen], chosen[0][1]
    predicted = {"simulated": [scores(table) for table in simulated]}
    predicted |= {title: [scores(table)] for title, table in controls.items()}

    chance = 100 * differing_probability(count, count)
    print(f"{count} repeats; percent, mean over {len(FEATURES)} features; chance level of |W| > 1: {chance:.1f} %")
    for title, found in draws.items():
        overall = mean_and_sd([means(one) for one in found], count / available[title])
        print(f"\n{title} (drawn from {available[title]})\n{overall}")
    for title, found in predicted.items():
        print(f"\n{title}\n{mean_and_sd([means(one) for one in found])}")

    moved = study.repeats.repositioned > 0
    reference = draws["measured, all acquisitions" if moved else "measured, not re-positioned"]
    print("\nSpearman's coefficient over features with the measured stability, mean and SD over draws")
    for title, found in predicted.items():
        print_spearman(title, [spearman(one, other) for one in found for other in reference])
    pairs = halves(full if moved else fixed)
    print_spearman("the other half of the measured acquisitions", [spearman(*map(scores, pair)) for pair in pairs])

    print("\nStability with the same acquisitions in both groups, and with different ones, percent")
    for title, rows, unit in (("measured", fixed, "acquisition"), ("simulated", simulated[0], "seed")):
        for name, chosen in {"all features": FEATURES, "variance": [VARIANCE], "skewness": [SKEWNESS]}.items():
            found = paired_and_independent(rows, unit, features=chosen)
            print(f"{title}, {name}: mean {found.mean().round(1).to_dict()}, SD {found.std().round(1).to_dict()}")
    print(f"\nHU of regions, measured\n{regions_table(full if moved else fixed).to_string()}")
    print(f"\nsimulated\n{regions_table(simulated[0]).to_string()}")
