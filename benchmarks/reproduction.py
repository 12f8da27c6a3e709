"""Compare the numbers and figures of the paper with its reproduction at five seeds (2 hours on two cores).

Runs config/reproduction.yaml for each seed in results-reproduction, with white noise on the same phantom as a control.
Writes the values of each seed to docs/validation/reproduction.csv, and the tables of that page to other CSV files.
--stability runs only the stability analysis (a quarter of the time). Rows of other analyses then use the seeds that
have them.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import scipy
import yaml

from benchmarks import common
from virtual_phantom import phantom
from virtual_phantom.base import streams
from virtual_phantom.config.plan import Plan
from virtual_phantom.features import extraction, tables
from virtual_phantom.features.names import FEATURES, VARIANCE
from virtual_phantom.io import volumes
from virtual_phantom.io.files import read_csv, replacing, write_csv
from virtual_phantom.phantom.white_noise import add_white_noise
from virtual_phantom.statistics import controls, measured, noise, ranking, repeats, wilcoxon
from virtual_phantom.statistics.dose_series import dose_variance

CONFIG = "config/reproduction.yaml"
RESULTS = Path("results-reproduction")
STORED, PAGE = (common.ROOT / f"docs/validation/reproduction.{suffix}" for suffix in ("csv", "md"))
STUDY, CONTROL = "reproduction", "white noise"
SEEDS = (2023, 2024, 2025, 2026, 2027)
WHITE_STREAM = 1
UNIFORM = "cyst_1"  # the ROI with the least texture: the printed pattern of the cyst
PUBLISHED = ("simulator", "phantom")  # the two lists of the paper's appendix


@dataclass(frozen=True)
class Row:
    """One published number or statement.

    Attributes
    ----------
    key : str
        Key of the value in `values`.
    paper : str
        What the paper states.
    reason : str
        Why the value differs from the paper's, or what limits the comparison.
    """

    key: str
    quantity: str
    paper: str
    reason: str
    digits: int = 1


DRAWN = "the object is drawn, its voxels are coarser"
ROWS = (
    Row("linearity", "noise calibration (figure 3): R² of variance against A", "approximately linear", "", 3),
    Row(
        "level",
        "A at which SIRT has the scanner's variance at 10 mGy (table 3), 1e-6",
        "100",
        "voxels of 11 mm³ instead of 1 mm³; the paper compares another region and its unit is unclear",
        2,
    ),
    Row(
        "sirt_noise",
        "noise variance of SIRT over that of FBP (figure 2), 300 projections",
        "below 1: FBP is marginally noisier",
        "500 iterations amplify noise, and this FBP smooths; on the scanner it is 0.50 (0.62 with the fixed pattern)",
    ),
    Row("best_sirt", "spatial variance of sirt_450 over that of sirt_300 (table 1)", "below 1: 450 is optimal", "", 2),
    Row("low_stability", "features with a stability below 50 % (figure 4), %", "the majority", "", 0),
    Row("high_discrimination", "features with a discriminative power above 50 % (figure 4), %", "high", "", 0),
    Row("stability_percent", "mean stability (figure 4), %", "only drawn", "the paper prints no values"),
    Row(
        "discrimination_percent", "mean discriminative power (figure 4), %", "only drawn", "the paper prints no values"
    ),
    Row(
        "same_class_percent",
        "the same for pairs of ROIs of one tissue class (not in the paper), %",
        "-",
        "nearly as high as between classes, so it is not due to tissue alone",
    ),
    *(
        Row(
            f"{kind}_ten_{source}",
            f"{name}: features shared with the ten of the paper's {source}",
            {"simulator": "10 by definition", "phantom": ""}[source],
            {"simulator": DRAWN, "phantom": ""}[source],
        )
        for kind, name in zip(ranking.KINDS, ("stability", "discriminative power"), strict=True)
        for source in PUBLISHED
    ),
    *(
        Row(f"{kind}_{key}", f"{name} (figure 5): {text}", paper, "", digits)
        for kind, name in zip(ranking.KINDS, ("stability", "discriminative power"), strict=True)
        for key, text, paper, digits in (
            ("ten", "features shared with the ten of the measured phantom", "", 1),
            ("area", "area under the overlap curve", "consistently high", 2),
            ("area_chance", "area, random lists, 97.5th percentile", "", 2),
        )
    ),
    *(
        Row(f"{pca}_{key}", f"principal components, {name}: {text}", paper, reason, digits)
        for pca, name in (
            ("sirt", "SIRT (figure 6)"),
            ("fbp", "FBP (figure 7)"),
            ("multicentre", "multi-center (figure 8)"),
        )
        for key, text, paper, reason, digits in (
            (
                "accuracy",
                "classes found by a linear discriminant, %",
                "linearly separable",
                "measured groups: 46 to 48 %",
                0,
            ),
            ("spread", "SD within an ROI over the measured SD", "closely matched", "", 2),
            ("distance", "distance of ROI means, in SDs between measured ROIs", "closely matched", "2D and 3D", 2),
        )
    ),
)


def run_study(seed: int, stability: bool, cores: int) -> None:
    folder = RESULTS / f"seed{seed}"
    overlay = RESULTS / f"seed{seed}.yaml"
    (common.ROOT / overlay).write_text(yaml.safe_dump({"seed": seed, "results_dir": str(folder)}), encoding="utf-8")
    files = [CONFIG, *(["config/stability_only.yaml"] if stability else []), str(overlay)]
    command = [sys.executable, "-m", "snakemake", "--cores", str(cores), "--configfile", *files]
    targets = ["--", *(f"{folder}/tables/{name}.csv" for name in ("stability", "fixed_pattern"))] if stability else []
    subprocess.run([*command, *targets], cwd=common.ROOT, check=True)


def white_noise(plan: Plan, folder: Path) -> pd.DataFrame:
    """Features of the phantom in the results folder of a study, with white noise and without a scan.

    The noise of a group is that of one of the printed phantom's groups, as its large cyst shows it; SIRT takes those
    with ADMIRE (1, 3, 5, 7), FBP those with FBP (2, 4, 6, 8).
    """
    image = volumes.read_nifti(folder / "phantom/image.nii.gz")
    rois, masks = phantom.read_masks(folder / "phantom/rois.csv", image.grid)
    classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
    means = measured.group_means().query("roi == @UNIFORM").set_index("group")
    seed = streams.branch(plan.study.seed, WHITE_STREAM)
    count, rows = {"sirt": 0, "fbp": 0}, []
    for protocol in plan.groups():
        settings = plan.study.protocols[protocol]
        algorithm = settings.algorithm
        group = 2 * count[algorithm] + (1 if algorithm == "sirt" else 2)
        count[algorithm] += 1
        for number, stream in enumerate(seed.spawn(plan.repeats(["dose10"]))):
            variance = dict.fromkeys(masks, means.loc[group, VARIANCE])
            noisy = add_white_noise(image, masks, variance, stream)
            acquisition = {
                "protocol": protocol,
                "algorithm": algorithm,
                "projections": settings.projections,
                "noise": "dose10",
                "noise_level": np.nan,
                "seed": number,
            }
            rows.append(tables.add_acquisition(extraction.extract(noisy, masks), classes, acquisition))
    return tables.merge_tables(rows)


def published_overlap(scores: pd.DataFrame) -> dict[str, float]:
    """Features shared by the ten best of a study and each list of the paper; ties in random order."""
    published = measured.load_published_top()
    found = {}
    for kind in ranking.KINDS:
        best = pd.Series(ranking.membership(scores[f"{kind}_percent"].to_numpy(), 10), scores["feature"])
        for source in PUBLISHED:
            listed = published.query("kind == @kind and source == @source")["feature"]
            found[f"{kind}_ten_{source}"] = float(best.reindex(listed).sum())
    return found


def groups_of(path: Path, plan: Plan) -> pd.DataFrame:
    """Features of the groups of the stability analysis."""
    groups = plan.groups()
    return tables.read_groups(path, groups, noise=dict.fromkeys(groups, "dose10"), seeds=plan.repeats(["dose10"]))


def headline(table: pd.DataFrame, scores: pd.DataFrame, draws: pd.DataFrame, features=FEATURES) -> dict[str, float]:
    """Mean `scores` of a table with column group, and their overlap with measured scores of equal repeats."""
    overlap = ranking.overlap(scores, draws, ranking.shared_variance(table, features))
    row = {"repeats": int(draws["repeats"].iloc[0])}
    for kind in ranking.KINDS:
        row |= {
            f"{kind}_percent": scores[f"{kind}_percent"].mean(),
            f"{kind}_area": overlap[f"area_{kind}"].iloc[0],
            f"{kind}_area_sd": overlap[f"area_{kind}_sd"].iloc[0],
            f"{kind}_area_chance": overlap[f"area_{kind}_upper"].iloc[0],
            f"{kind}_above": ranking.lengths_above(overlap, kind),
            f"{kind}_ten": overlap[f"overlap_{kind}_percent"].iloc[9] / 10,
            f"{kind}_ten_chance": overlap[f"upper_{kind}_percent"].iloc[9] / 10,
        }
    return row


def score_values(table: pd.DataFrame) -> dict[str, float]:
    """Values from a table of features with the column group."""
    scores = wilcoxon.scores(table, FEATURES)
    draws = measured.load_score_draws(table["seed"].nunique())
    row = headline(table, scores, draws) | published_overlap(scores)
    row["low_stability"] = 100 * (scores["stability_percent"] < 50).mean()
    row["high_discrimination"] = 100 * (scores["discrimination_percent"] > 50).mean()
    shares = controls.controls(table, FEATURES).set_index(["score", "control"])["percent"]
    row["same_class_percent"] = shares["discrimination", controls.SAME_CLASS]
    return row


def noise_values(pattern: pd.DataFrame) -> dict[str, float]:
    """Fixed pattern and noise of the uniform ROI in each group, HU^2."""
    rows = pattern[pattern["roi"] == UNIFORM].set_index("protocol")
    values = {
        f"{protocol} {part}": row[f"{part}_variance_hu2"]
        for protocol, row in rows.iterrows()
        for part in ("pattern", "noise")
    }
    return values | {"sirt_noise": values["sirt_300 noise"] / values["fbp_300 noise"]}


def calibration_values(calibration: pd.DataFrame) -> dict[str, float]:
    """Noise level (1e-6) at which the variance among voxels of the uniform ROI is the scanner's, and R² of the line."""
    rows = calibration[calibration["roi"] == UNIFORM]
    fit = noise.linear_fit(rows["noise_level"], rows["spatial_variance_hu2"])
    level = (dose_variance("iterative", 10) - fit.intercept) / fit.slope
    return {"linearity": fit.r_squared, "level": 1e6 * level}


def component_values(name: str, points: pd.DataFrame, separability: pd.DataFrame) -> dict[str, float]:
    """Agreement of simulated and measured principal components."""
    ours, real = (
        points[points["source"] == source].groupby("roi")[["pc1", "pc2"]] for source in ("simulated", "measured")
    )
    spread = real.mean().std(ddof=1)
    found = separability.set_index("source")["accuracy"]
    return {
        f"{name}_accuracy": 100 * found["simulated"],
        f"{name}_spread": float((ours.std() / real.std()).median().mean()),
        f"{name}_distance": float(((ours.mean() - real.mean()) / spread).abs().mean().mean()),
    }


def values(folder: Path, plan: Plan) -> dict[str, float]:
    """All values of one finished study, without those of analyses that were not run."""
    row = score_values(groups_of(folder / "features.csv", plan))
    row |= noise_values(read_csv(folder / "tables/fixed_pattern.csv"))
    uniform = read_csv(folder / "features.csv").query("roi == @UNIFORM and noise == 'dose10'")
    spatial = uniform.groupby("protocol")[VARIANCE].mean()
    if "sirt_450" in spatial:
        row["best_sirt"] = spatial["sirt_450"] / spatial["sirt_300"]
    if (folder / "tables/noise_calibration.csv").exists():
        row |= calibration_values(read_csv(folder / "tables/noise_calibration.csv"))
    for name in plan.study.analyses.pca:
        if (folder / f"tables/pca_{name}.csv").exists():
            parts = (read_csv(folder / f"tables/{kind}_{name}.csv") for kind in ("pca", "separability"))
            row |= component_values(name, *parts)
    return row


def interval(numbers: pd.Series) -> dict[str, float]:
    """Mean, SD over seeds and 95 % interval of the mean (Student's t)."""
    n, sd = len(numbers), numbers.std(ddof=1)
    half = scipy.stats.t.ppf(0.975, n - 1) * sd / np.sqrt(n) if n > 1 else np.nan
    return {"mean": numbers.mean(), "sd": sd, "low": numbers.mean() - half, "high": numbers.mean() + half, "seeds": n}


def summary(stored: pd.DataFrame, study: str) -> pd.DataFrame:
    """`interval` over seeds of every value of a study (rows)."""
    seeds = stored[stored["study"] == study].drop(columns=["settings", "seed", "study"])
    return pd.DataFrame({key: interval(seeds[key].dropna()) for key in seeds if seeds[key].notna().any()}).T


def text(row: Mapping[str, float], digits: int) -> str:
    if row["seeds"] < 2:
        return f"{row['mean']:.{digits}f}"
    if row["seeds"] == 2:  # the interval would be twelve times as wide as the SD
        return f"{row['mean']:.{digits}f} ± {row['sd']:.{digits}f}"
    return f"{row['mean']:.{digits}f} ± {row['sd']:.{digits}f} ({row['low']:.{digits}f} to {row['high']:.{digits}f})"


def numbers_table(ours: pd.DataFrame, white: pd.DataFrame) -> pd.DataFrame:
    """Table of ROWS."""
    cells, paper = [], paper_overlap()
    for row in ROWS:
        if row.key not in ours.index:
            continue
        cells.append(
            {
                "quantity": row.quantity,
                "paper": f"{paper[row.key]} (its simulator)" if row.key in paper else row.paper,
                "reproduction": text(ours.loc[row.key], row.digits),
                "white noise, no scan": text(white.loc[row.key], row.digits) if row.key in white.index else "",
                "seeds": f"{ours.loc[row.key, 'seeds']:.0f}",
                "reason for the difference": row.reason,
            }
        )
    return pd.DataFrame(cells)


def paper_overlap() -> dict[str, int]:
    """Features that the paper's two lists of ten share."""
    published = measured.load_published_top()
    lists = {key: set(rows["feature"]) for key, rows in published.groupby(["kind", "source"])}
    return {f"{kind}_ten_phantom": len(lists[kind, "simulator"] & lists[kind, "phantom"]) for kind in ranking.KINDS}


def pattern_table(ours: pd.DataFrame, protocols: list[str]) -> pd.DataFrame:
    """Table of the fixed pattern and noise of the uniform ROI."""
    cells = []
    for protocol in protocols:
        pattern, noisy = (ours.loc[f"{protocol} {part}"] for part in ("pattern", "noise"))
        share = 100 * pattern["mean"] / (pattern["mean"] + noisy["mean"])
        cells.append(
            {
                "protocol": protocol,
                "fixed pattern, HU²": text(pattern, 0),
                "noise, HU²": text(noisy, 0),
                "share of the pattern, %": f"{share:.0f}",
            }
        )
    return pd.DataFrame(cells)


def page_tables(stored: pd.DataFrame) -> dict[Path, pd.DataFrame]:
    """The tables of the page by their files, from the values of all seeds."""
    ours, white = (summary(stored, study) for study in (STUDY, CONTROL))
    groups = Plan(common.configuration(CONFIG)).groups()
    tables = {"numbers": numbers_table(ours, white), "pattern": pattern_table(ours, list(groups))}
    return {STORED.with_name(f"{STORED.stem}_{name}.csv"): table for name, table in tables.items()}


def add_arguments(parser):
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--stability", action="store_true", help="run only the stability analysis")
    parser.add_argument("--keep", action="store_true", help="evaluate finished studies without new runs")


def run(options):
    (common.ROOT / RESULTS).mkdir(exist_ok=True)
    if not options.keep:
        for seed in SEEDS:
            run_study(seed, options.stability, options.cores)
    rows = []
    for seed in SEEDS:
        folder = common.ROOT / RESULTS / f"seed{seed}"
        if not (folder / "tables/stability.csv").exists():
            print(f"seed {seed}: not finished")
            continue
        plan = Plan(common.configuration(CONFIG, RESULTS / f"seed{seed}.yaml"))
        white = folder / "white_noise.csv"
        if not white.exists():
            write_csv(white_noise(plan, folder), white)
        known = {"settings": plan.scored_settings(), "seed": seed}
        rows.append({**known, "study": STUDY, **values(folder, plan)})
        rows.append({**known, "study": CONTROL, **score_values(groups_of(white, plan))})
    if not rows:
        sys.exit("no study is finished; run without --keep")
    with replacing(STORED, checksum=False) as temporary:
        pd.DataFrame(rows).to_csv(temporary, index=False, lineterminator="\n", float_format="%.6g")
    for path, table in page_tables(read_csv(STORED)).items():
        lines = table.to_csv(index=False, lineterminator="\n")
        path.write_text(lines, encoding="utf-8")
        print(lines)
    for acquisitions in measured.ACQUISITIONS:
        draws = measured.load_score_draws(10, acquisitions)
        texts = ["{:.1f} ± {:.1f} %".format(*repeats.mean_over_features(draws, kind)) for kind in ranking.KINDS]
        print(f"printed phantom, 10 acquisitions ({acquisitions}): {', '.join(texts)}")
