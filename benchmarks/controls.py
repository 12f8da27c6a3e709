"""Compare the default study's agreement with the printed phantom with further seeds and negative controls (1 hour).

Runs the stability analysis of the default study, of five further seeds and of studies that are wrong on purpose in
results-controls. Prints the table of docs/validation/controls.md and writes default_study_seeds.csv of the library.
--table, the full table of CT-Phantom4Radiomics, adds a comparison of the printed phantom with itself.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from benchmarks import common
from virtual_phantom import phantom
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.config.plan import Plan
from virtual_phantom.features import extraction, tables
from virtual_phantom.features.names import FEATURES
from virtual_phantom.io import volumes
from virtual_phantom.io.files import replacing, write_csv
from virtual_phantom.io.volumes import Volume
from virtual_phantom.statistics import further_seeds, measured, ranking, repeats, roi_profiles, wilcoxon

RESULTS = Path("results-controls")
SEEDS = (2023, 2024, 2025, 2026, 2027)
# One texture for six ROIs, which then differ in mean HU only; the printed phantom has different textures.
TEXTURE = {"sd_hu": 15, "correlation_mm": 5, "skewness": -1.0}
TISSUES = ("n1", "n2", "c1", "c2", "hem", "met")
WHITE_STREAM = 1
DOSE_MGY = 10
PAIRED = {"iterative": "sirt_300", "fbp": "fbp_300"}  # reconstructions of the dose series and the finest protocols


def studies() -> dict[str, dict]:
    """{study: overlay of config/controls.yaml}; None stands for config/tiny.yaml."""
    found = {"default": {}, **{f"seed{seed}": {"seed": seed} for seed in SEEDS}}
    level = common.configuration().noise.levels["dose10"]
    found["noise_x10"] = {"noise": {"levels": {"dose10": {"A": 10 * level.A}}}}
    found["texture"] = {"phantom": {"layout": f"{RESULTS}/layout.yaml"}}
    found["tiny"] = None
    return found


def run_study(name: str, changes: dict | None, cores: int) -> None:
    overlay = RESULTS / f"{name}.yaml"
    files = ["config/tiny.yaml"] if changes is None else ["config/controls.yaml"]
    (common.ROOT / overlay).write_text(
        yaml.safe_dump({**(changes or {}), "results_dir": f"{RESULTS}/{name}"}), encoding="utf-8"
    )
    command = [sys.executable, "-m", "snakemake", "--cores", str(cores), "--configfile", *files, str(overlay), "--"]
    subprocess.run([*command, f"{RESULTS}/{name}/tables/stability.csv"], cwd=common.ROOT, check=True)


def write_layout(path: Path) -> None:
    """Write the layout of the default phantom with one texture in all six ROIs."""
    layout = yaml.safe_load((RESOURCES / "phantom.yaml").read_text(encoding="utf-8"))
    for tissue in TISSUES:
        layout["tissues"][tissue]["texture"] = [TEXTURE]
    path.write_text(yaml.safe_dump(layout), encoding="utf-8")


def white_noise(plan: Plan) -> pd.DataFrame:
    """Features of the default phantom with white noise added and nothing scanned.

    The noise of a group is that of one of the printed phantom's groups, as its large cyst shows it; SIRT takes those
    with ADMIRE (1, 3, 5, 7), FBP those with FBP (2, 4, 6, 8).
    """
    image = volumes.read_nifti(common.ROOT / RESULTS / "default/phantom/image.nii.gz")
    rois, masks = phantom.read_masks(common.ROOT / RESULTS / "default/phantom/rois.csv", image.grid)
    classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
    means = measured.group_means().query("roi == 'cyst_1'").set_index("group")
    sd = np.sqrt(means["original_firstorder_Variance"])
    seed = np.random.SeedSequence(plan.study.seed, spawn_key=(WHITE_STREAM,))
    count, rows = {"sirt": 0, "fbp": 0}, []
    for protocol in plan.groups():
        settings = plan.study.protocols[protocol]
        algorithm = settings.algorithm
        group = 2 * count[algorithm] + (1 if algorithm == "sirt" else 2)
        count[algorithm] += 1
        for number, stream in enumerate(seed.spawn(plan.repeats(["dose10"]))):
            noise = np.random.default_rng(stream).normal(0, sd[group], image.array.shape)
            noisy = Volume((image.array + noise).astype(np.float32), image.grid)
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


def headline(table: pd.DataFrame, draws: pd.DataFrame, features=FEATURES) -> dict[str, float]:
    """Scores and overlap of a table with column group, against measured scores of equal repeats."""
    scores = wilcoxon.scores(table, features)
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


def over_rois(table: pd.DataFrame) -> dict[str, float]:
    """Agreement over ROIs with the dose series at 10 mGy, mean of the two reconstructions."""
    found = [
        roi_profiles.profile_agreement(
            roi_profiles.compare_profiles(
                roi_profiles.profiles(table[table["protocol"] == protocol], FEATURES), series(name, DOSE_MGY)
            )
        )
        for name, protocol in PAIRED.items()
    ]
    return pd.DataFrame(found).mean().to_dict()


def series(reconstruction: str, dose_mgy: float) -> pd.DataFrame:
    rows = measured.load_dose_series().query("reconstruction == @reconstruction and dose_mgy == @dose_mgy")
    return rows.pivot(index="roi", columns="feature", values="mean")


def real_over_rois() -> dict[str, dict[str, float]]:
    """Agreement of the dose series with other reconstructions and doses of the same phantom."""
    others = {"the other reconstruction": lambda name: ({"iterative": "fbp", "fbp": "iterative"}[name], DOSE_MGY)}
    others |= {f"{dose} mGy": lambda name, dose=dose: (name, dose) for dose in (3, 1)}
    return {
        f"real scans, {label}": pd.DataFrame(
            [
                roi_profiles.profile_agreement(
                    roi_profiles.compare_profiles(series(*other(name)), series(name, DOSE_MGY))
                )
                for name in PAIRED
            ]
        )
        .mean()
        .to_dict()
        for label, other in others.items()
    }


def against_itself(path: Path) -> dict[str, float]:
    """Agreement of two halves of the acquisitions without re-positioning; mean over 10 splits."""
    study = measured.load_full_table(path)
    study = study[study["repositioned"] == 0]
    common = np.array(sorted(set.intersection(*(set(rows["acquisition"]) for _, rows in study.groupby("group")))))
    rows = []
    for stream in np.random.SeedSequence(repeats.SEED, spawn_key=(WHITE_STREAM,)).spawn(10):
        order = np.random.default_rng(stream).permutation(common)
        halves = [study[study["acquisition"].isin(part)] for part in (order[:9], order[9:18])]
        other = wilcoxon.scores(halves[1], measured.PHANTOM4RADIOMICS_FEATURES).assign(draw=1, repeats=9, of=18)
        rows.append(headline(halves[0], other, measured.PHANTOM4RADIOMICS_FEATURES))
    return pd.DataFrame(rows).mean().to_dict()


def markdown(rows: pd.DataFrame) -> str:
    both = [f"{kind}_{{}}" for kind in ranking.KINDS]
    columns = {  # title: columns of the table, and digits
        "stable %": (["stability_percent"], 1),
        "discriminative %": (["discrimination_percent"], 1),
        "area, stability": (["stability_area"], 3),
        "area, discrimination": (["discrimination_area"], 3),
        "lengths above": ([name.format("above") for name in both], 0),
        "of ten shared": ([name.format("ten") for name in both], 1),
        "order of ROIs": (["order"], 2),
        "alike %": (["alike_percent"], 0),
        "distance": (["distance"], 2),
    }
    lines = [f"| study | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|"]
    for name, row in rows.iterrows():
        cells = (
            ", ".join("" if pd.isna(row[key]) else f"{row[key]:.{digits}f}" for key in keys).strip(", ")
            for keys, digits in columns.values()
        )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def add_arguments(parser):
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--table", type=Path)
    parser.add_argument("--keep", action="store_true", help="evaluate results-controls without new runs")


def run(options):
    (common.ROOT / RESULTS).mkdir(exist_ok=True)
    write_layout(common.ROOT / RESULTS / "layout.yaml")
    if not options.keep:
        for name, changes in studies().items():
            run_study(name, changes, options.cores)
    plan, tiny = Plan(common.configuration("config/controls.yaml")), Plan(common.configuration("config/tiny.yaml"))
    white = common.ROOT / RESULTS / "white_noise.csv"
    if not white.exists():
        write_csv(white_noise(plan), white)

    rows, scores = {}, []
    for name in (*studies(), "white_noise"):
        path = white if name == "white_noise" else common.ROOT / RESULTS / name / "features.csv"
        one = tiny if name == "tiny" else plan
        repeated = one.repeats(["dose10"])
        table = tables.read_groups(path, one.groups(), noise="dose10", seeds=repeated)
        rows[name] = headline(table, measured.load_score_draws(repeated)) | over_rois(table)
        if name == "default":
            rows["default, re-positioned too"] = headline(table, measured.load_score_draws(repeated, "all"))
        if seed := re.fullmatch(r"seed(\d+)", name):
            new_scores = wilcoxon.scores(table, FEATURES)[["feature", "stability_percent", "discrimination_percent"]]
            new_scores.insert(0, "settings", plan.scored_settings())
            new_scores.insert(1, "seed", int(seed[1]))
            scores.append(new_scores.round(6))
    with replacing(RESOURCES / "default_study_seeds.csv", checksum=False) as temporary:
        pd.concat(scores).to_csv(temporary, index=False, lineterminator="\n")
    if options.table:
        rows["printed phantom, nine scans and nine others"] = against_itself(options.table)
    rows |= real_over_rois()
    table = pd.DataFrame(rows).T
    seeds = table.loc[[f"seed{seed}" for seed in SEEDS]]
    table = table.drop(index=seeds.index)
    table.loc["five further seeds, mean"], table.loc["five further seeds, SD"] = seeds.mean(), seeds.std(ddof=1)
    write_csv(table.reset_index(names="study"), common.ROOT / RESULTS / "controls.csv")
    print(markdown(table))
    for acquisitions in measured.ACQUISITIONS:
        draws = measured.load_score_draws(10, acquisitions)
        texts = ["{:.1f} +- {:.1f} %".format(*repeats.mean_over_features(draws, kind)) for kind in ranking.KINDS]
        print(f"printed phantom, 10 of {draws['of'].iloc[0]} acquisitions ({acquisitions}): {', '.join(texts)}")
    print("SD of the seeds:", further_seeds.sd_over_seeds(further_seeds.read_seed_scores()))
