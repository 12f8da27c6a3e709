"""First page of a study: its answer, its warnings, and links to existing files."""

import html
import io
import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from browser import opened, outside_resources
from PIL import Image
from recording_folders import projections_folder
from resolved import resolved
from test_study import Balanced

from virtual_phantom.base.settings import to_mapping
from virtual_phantom.report import answer, index, study
from virtual_phantom.statistics.stability_measures import CUT_OFFS
from virtual_phantom.study.context import read_context
from virtual_phantom.study.index_page import renew

CONFIG = resolved("paper_groups.yaml") | {"results_dir": "r <1>"}
FEATURES = ["original_glcm_Idn", "original_firstorder_Mean", "original_glszm_ZoneEntropy"]
TRUST = pd.DataFrame(
    {
        "feature": FEATURES,
        "stability_percent": [0.0, 61.9, 40.0],
        "ci95_low": [0.0, 52.0, 25.0],
        "ci95_high": [4.4, 68.5, 55.0],
        "stable": ["no", "yes", "undecided"],
        "cut_off_percent": 50.0,
        "groups": 4,
        "rois": 2,
        "repeats": 3,
        "comparisons": 12,
        "if_equal_percent": 60.0,
        "twice_repeats_percent": [0.0, 60.0, 30.0],
        "twice_repeats_low": [0.0, 50.0, 20.0],
        "twice_repeats_high": [3.0, 68.0, 40.0],
        "sentence": "A sentence.",
    }
)
MEASURES = pd.DataFrame({"feature": FEATURES, **{f"stable_{name}": ["yes", "no", "no"] for name in CUT_OFFS}}).assign(
    stable_by=[6, 0, 0]
)
STABILITY = pd.DataFrame(
    {
        "feature": FEATURES,
        "stability_percent": [0.0, 61.9, 40.0],
        "stability_cyst": [0.0, 83.3, 30.0],
        "stability_liver": [0.0, 41.7, 50.0],
    }
)
CONTROLS = pd.DataFrame(
    {
        "score": ["stability", "stability", "discrimination", "discrimination", "discrimination"],
        "control": ["protocols", "chance", "different classes", "same class", "chance"],
        "percent": [34.0, 60.0, 92.4, 89.0, 40.0],
        "pairs": [6, np.nan, 13, 2, np.nan],
        "features": 3,
        "repeats": 3,
        "meaning": "Words.",
    }
)
ALL = pd.DataFrame(
    {
        "roi": ["cyst_2", "liver", "cyst_2", "liver"],
        "tissue_class": ["cyst", "liver", "cyst", "liver"],
        "n_voxels": [24, 64, 24, 64],
        "grey_levels": [3, 5, 2, 6],
        "original_glcm_Idn": [0.1, 0.2, 0.3, 0.4],
    }
)
DIAGNOSIS = {
    "recording": "disc",
    "verdict": "mismatch explained",
    "sentence": "Scatter <explains> it.",
    "locations": [],
    "effects": [],
    "ambiguous_with": {},
    "ruled_out": {},
    "fit": {},
    "held_out": {},
    "excess_removed": 0.9,
    "unexplained": [],
    "next_measurement": [],
    "held_out_data": "half",
}
CELLS = pd.DataFrame({"roi": ["a", "b", "c"], "margin_sd": 1.0, "sd_factor": 2.0})
SUMMARY = pd.DataFrame(
    {
        "feature": [f"original_glcm_F{number}" for number in range(6)],
        "mean_right": [True, True, False, False, False, False],
        "sd_right": [True, False, True, True, False, False],
        "rank_right": [False, False, False, False, False, True],
    }
)
COMPARISON = {"comparison_clinic": CELLS, "comparison_clinic_features": SUMMARY}
COMMANDS = {"This study again": "snakemake --cores 2", "Slices": "snakemake viewer --cores 2"}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("index") / "results"
    for name in ("tables", "figures", "diagnosis/disc"):
        (folder / name).mkdir(parents=True)
    picture = io.BytesIO()
    Image.new("RGB", (900, 600), "red").save(picture, "png")
    for name in ("rois", "comparison_clinic"):
        (folder / "figures" / f"{name}.png").write_bytes(picture.getvalue())
    (folder / "rois.rst").write_text('**Regions** of {{ snakemake.config["seed"] }}.\n')
    frames = {"trust": TRUST, "stable_features": MEASURES, "stability": STABILITY, **COMPARISON}
    frames["controls"] = CONTROLS
    for name, frame in ({f"tables/{name}": one for name, one in frames.items()} | {"features": ALL}).items():
        frame.to_csv(folder / f"{name}.csv", index=False)
    (folder / "diagnosis" / "disc" / "diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    (folder / "diagnosis" / "disc" / "report.html").write_text("<!doctype html>")
    return folder


TABLES = ("tables/trust", "tables/stable_features", "tables/controls", "tables/stability", "features")


def made(results, *, config=CONFIG, names=TABLES, diagnoses=True, figures=("rois",)):
    sections = {"rois": ("Phantom", "Regions <1>"), "comparison_clinic": ("Recordings", "simulation and clinic")}
    figures = [
        study.ReportFigure(results / "figures" / f"{name}.png", *sections[name], results / "rois.rst", {}, {})
        for name in figures
    ]
    tables = [index.LinkedTable(name.title(), results / f"{name}.csv") for name in names]
    reports = [results / "diagnosis" / "disc" / "report.html"] if diagnoses else []
    return index.index_page(results, figures, tables, reports, config, COMMANDS)


@pytest.fixture(scope="module")
def page(results):
    return made(results)


def text(page):
    """Text of a page without tags, on one line."""
    body = re.sub(r"<(style|script).*?</\1>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", "", body).replace("&nbsp;", " ").split())


def test_page_is_well_formed_and_all_links_lead_to_files(page, results):
    parser = Balanced()
    parser.feed(page)
    assert parser.open == [] and len(parser.ids) == len(set(parser.ids))
    inside = {link[1:] for link in parser.links if link.startswith("#")}
    assert {"answer", "warnings", "tables", "next", "provenance"} <= inside <= set(parser.ids)
    files = {link for link in parser.links if not link.startswith("#")}
    assert files == {"figures/rois.png", "diagnosis/disc/report.html", *(f"{name}.csv" for name in TABLES)}
    assert all((results / link).exists() for link in files)
    assert outside_resources(page) == ["figures/rois.png"]


def test_answer_comes_first_with_its_intervals(page):
    page_words = text(page)
    assert "1 of 3 features is stable between the 4 protocols, 1 is not stable, and 1 is undecided." in page_words
    assert page_words.index("Stable features 1 of") < page_words.index("Warnings ROI") < page_words.index("Regions")
    # Sorted by the lower end of the interval.
    places = [page_words.index(words) for words in ("62 %, 52 to 68 %", "40 %, 25 to 55 %", "0 %, 0 to 4.4 %")]
    assert places == sorted(places)
    assert "ICC(2,1) 1, ICC(3,1) 1, CCC 1, CV 1, QCD 1." in page_words
    assert "A feature that no protocol changes has a stability of 60 % on average" in page_words
    assert "is at 50 % or above (most comparisons agree), and not stable" in page_words


def test_controls_are_next_to_the_mean_scores(page):
    page_words = text(page)
    assert (
        "is undecided. Mean stability 34.0 % (by chance: 60.0 %). Mean discriminative power 92.4 % (pairs of one "
        "tissue class: 89.0 %; by chance: 40.0 %). Means over 3 features."
    ) in page_words.replace("\u00a0", " ")
    assert "percentage of 13 pairs of ROIs of different tissue classes" in page_words
    assert "the same percentage for 2 pairs of ROIs of one tissue class" in page_words


def test_study_without_two_rois_of_a_class_has_no_such_control(tmp_path):
    same = CONTROLS["control"] == "same class"
    alone = CONTROLS.assign(percent=CONTROLS["percent"].mask(same), pairs=CONTROLS["pairs"].mask(same, 0))
    alone.loc[same, "meaning"] = "Not possible: no tissue class has two ROIs."
    alone.to_csv(tmp_path / "controls.csv", index=False)
    TRUST.to_csv(tmp_path / "trust.csv", index=False)
    tables = [index.LinkedTable(name, tmp_path / f"{name}.csv") for name in ("trust", "controls")]
    page_words = text(index.index_page(tmp_path, [], tables, [], CONFIG, COMMANDS))
    assert "(no control of one tissue class; by chance:" in page_words
    assert "control with pairs of one tissue class: Not possible: no tissue class has two ROIs." in page_words


def test_features_that_do_not_vary_are_not_counted_as_stable(tmp_path):
    shape = TRUST.iloc[[1]].assign(
        feature="original_shape_Sphericity", stable="does not vary", stability_percent=np.nan, ci95_low=np.nan
    )
    pd.concat([shape, TRUST]).to_csv(tmp_path / "trust.csv", index=False)
    tables = [index.LinkedTable("Trust", tmp_path / "trust.csv")]
    page_words = text(index.index_page(tmp_path, [], tables, [], CONFIG, COMMANDS))
    assert "1 of 4 features is stable between the 4 protocols" in page_words
    assert "1 does not vary over repeats, such as shape features, and is not counted as stable." in page_words
    assert "shape Sphericity" not in page_words.partition("Tables")[0]


def test_every_tissue_has_an_answer(page, results):
    page_words = text(page)
    assert "Most stable features stability, 95 % interval stable in cyst in liver" in page_words
    assert "62 %, 52 to 68 % yes 83 % 42 %" in page_words  # features in the other table, in its order
    # Four protocols make six pairs, and each class has one ROI.
    assert "there are too few for an interval: 6 in cyst, 6 in liver." in page_words
    assert 'href="tables/stability.csv"' in page


@pytest.mark.parametrize(("compare", "expected"), [("roi", [12, 6]), ("tissue_class", [6, 6])])
def test_tissue_uses_the_comparisons_of_its_own_rois(compare, expected):
    rois = pd.DataFrame({"roi": ["a", "b", "c", "a"], "tissue_class": ["cyst", "cyst", "liver", "cyst"]})
    found = answer.stability_by_tissue(TRUST, STABILITY, rois, compare)
    assert [one["comparisons"] for one in found.values()] == expected
    assert found["liver"]["percent"][FEATURES[1]] == 41.7
    assert answer.stability_by_tissue(TRUST, STABILITY, rois[rois["roi"] == "c"], compare) == {}


def test_many_tissues_have_their_own_table(results, tmp_path):
    names = [f"organ_{number}" for number in range(index.MOST_CLASSES + 1)]
    percents = {f"stability_{name}": [10.0 * number + one for one in (1, 2, 3)] for number, name in enumerate(names)}
    frames = {
        "trust": TRUST,
        "stability": STABILITY[["feature", "stability_percent"]].assign(**percents),
        "features": pd.DataFrame({"roi": names, "tissue_class": names, "n_voxels": 100, "grey_levels": 9}),
    }
    for name, frame in frames.items():
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    page = index.index_page(
        tmp_path, [], [index.LinkedTable(name, tmp_path / f"{name}.csv") for name in frames], [], CONFIG, COMMANDS
    )
    assert "First order Mean 2.0 % 12 % 22 % 32 % 42 % 52 %" in text(page) and '<th class="n">in ' not in page


def test_features_stable_by_other_measures_are_named(page):
    page_words = (
        "Stable by at least two measures (number): GLCM Idn (6). All measures and features: tables/stable_features.csv."
    )
    assert page_words in text(page)


def test_ten_of_many_stable_features_are_named(results, tmp_path):
    names = [f"original_glcm_F{number:02}" for number in range(12)]
    verdicts = {f"stable_{name}": "yes" for name in CUT_OFFS}
    measures = pd.DataFrame({"feature": names, "stable_by": [2, 5, *[3] * 10], **verdicts})
    assert list(answer.stability_answer(TRUST, measures)["several"])[:3] == [names[1], names[2], names[3]]
    measures.to_csv(tmp_path / "stable_features.csv", index=False)
    TRUST.to_csv(tmp_path / "trust.csv", index=False)
    tables = [index.LinkedTable(name, tmp_path / f"{name}.csv") for name in ("trust", "stable_features")]
    page_words = text(index.index_page(tmp_path, [], tables, [], CONFIG, COMMANDS))
    assert "GLCM F01 (5), GLCM F02 (3)" in page_words and "GLCM F10 (3) and 2 more. All measures" in page_words


def test_stability_tables_are_sorted_by_stability():
    assert list(index.first_rows(TRUST)["feature"]) == [FEATURES[1], FEATURES[2], FEATURES[0]]
    assert list(index.first_rows(MEASURES)["feature"])[0] == FEATURES[0]
    assert list(index.first_rows(STABILITY)["feature"])[0] == FEATURES[1]
    assert index.first_rows(ALL).equals(ALL)


def test_comparison_lists_agreeing_features(results):
    names = (*TABLES, "tables/comparison_clinic", "tables/comparison_clinic_features")
    page = made(results, names=names, figures=("rois", "comparison_clinic"))
    page_words = html.unescape(text(page))
    assert (
        "Agreement of the 6 features: mean and SD 1, mean only 1, SD only 2, neither 2. The mean agrees if it is "
        "within 1 repeat SD of the recorded mean. The SD agrees if the ratio of the SDs is between 1/2 and 2. "
        "A feature needs to agree in at least 80 % of the 3 ROIs. Features with the recorded order of ROIs (Kendall's "
        "tau at least 0.7): 1. All features: tables/comparison_clinic_features.csv."
    ) in page_words
    assert page_words.index("Comparisons with recordings: simulation and clinic.") < page_words.index(
        "Stable features 1 of"
    )
    assert 'href="#comparison_clinic"' in page and 'id="comparison_clinic"' in page


def test_features_that_cannot_be_compared_are_counted():
    cells, summary = COMPARISON.values()
    marked = summary.assign(other_settings=["bins", *[None] * 5], other_sizes=[None, "512 voxels", "", *["more"] * 3])
    page_words = answer.agreement_text(marked, cells)
    assert page_words.startswith(
        "Agreement of the 1 comparable features: mean and SD 0, mean only 0, SD only 1, neither 0. The mean"
    )
    assert page_words.endswith(
        " Not comparable: 1 (extracted with other settings (*)). Not comparable: 4 (they grow with the ROI, and its "
        "size differs (†))."
    )


def test_features_without_a_repeat_sd_are_counted_separately():
    cells, summary = COMPARISON.values()
    names = summary["feature"]
    still = pd.concat([cells.assign(feature=name, sd_recorded=float(name != names[0])) for name in names])
    page_words = answer.agreement_text(summary, still)
    assert page_words.startswith(
        "Agreement of the 5 comparable features: mean and SD 0, mean only 1, SD only 2, neither 2. The mean"
    )
    assert page_words.endswith(" Not comparable: 1 (constant in the recording).")
    none = still.assign(sd_recorded=0.0)
    assert answer.agreement_text(summary, none).startswith(
        "None of the 6 features can be compared. Not comparable: 6 (constant"
    )


def test_single_roi_has_no_order():
    cells, summary = COMPARISON.values()
    page_words = answer.agreement_text(summary.assign(mean_right=False, sd_right=False), cells[cells["roi"] == "a"])
    assert page_words.startswith(
        "Agreement of the 6 features: mean and SD 0, mean only 0, SD only 0, neither 6. The mean"
    )
    assert page_words.endswith("the ratio of the SDs is between 1/2 and 2.")


def test_warnings_are_read_from_the_feature_table():
    page_words = index.study_warnings(ALL, TRUST)
    assert [word.partition(".")[0] for word in page_words] == [
        "ROI cyst_2 has 24 voxels",
        "ROI cyst_2 has fewer than 3 gray levels in 1 of 2 images",
        "There are 3 repeats per group",
    ]
    assert "need at least 64" in page_words[0]
    assert index.study_warnings(ALL[ALL["roi"] == "liver"], TRUST.assign(repeats=10)) == []
    assert len(index.study_warnings(ALL, None)) == 2


def test_diagnosis_verdict_is_shown(page, results):
    assert "disc: mismatch explained Scatter &lt;explains&gt; it." in text(page)
    assert index.COLORS["mismatch explained"] in page
    assert "Diagnoses" not in made(results, diagnoses=False)


def test_trial_is_labeled(page, results):
    words = "too small for meaningful results"
    assert words not in page and words in made(results, config=CONFIG | {"trial": True})
    page_words = text(made(results, config=CONFIG | {"trial": "init ct --size normal"}))
    assert f"{words}. Use it to check your setup. For results, run: init ct --size normal" in page_words


def test_study_without_groups_has_a_page(results):
    page = made(results, names=("features",), diagnoses=False)
    assert "no <code>analyses.stability</code>" in page and "cyst_2 has 24 voxels" in page
    assert "repeats per group" not in page


def test_one_repeat_has_no_interval(results, tmp_path):
    nothing = TRUST.assign(**dict.fromkeys([name for name in TRUST if "low" in name or "high" in name], np.nan))
    nothing.to_csv(tmp_path / "trust.csv", index=False)
    page = index.index_page(tmp_path, [], [index.LinkedTable("Trust", tmp_path / "trust.csv")], [], CONFIG, COMMANDS)
    assert "nan" not in text(page).lower().replace("provenance", "")


LOOK = """
const wider = document.documentElement.scrollWidth > innerWidth;
for (const one of document.querySelectorAll("details")) one.open = true;
return {wider, opened: document.documentElement.scrollWidth > innerWidth,
        bars: [...document.querySelectorAll(".bar i")].map((bar) => bar.getBoundingClientRect().width > 0)};
"""


@pytest.mark.parametrize("width", [1200, 400])
def test_page_fits_a_browser_without_horizontal_scrolling(page, results, width):
    found = opened(page, results, LOOK, width)
    assert found == {"wider": False, "opened": False, "bars": [True] * 3}
    (Path(results) / "opened.html").unlink()


def test_page_is_rebuilt_after_changes_of_its_content_only(results, tmp_path, monkeypatch):
    """A study without analyses; diagnoses, report and viewer have their own targets."""
    root = Path(__file__).resolve().parents[2]
    config = yaml.safe_load((root / "config" / "paper_groups.yaml").read_text())
    config |= {"engine": "cpu", "analyses": {}, "results_dir": str(tmp_path / "r")}
    config |= {"recordings": {"disc": str(tmp_path / "disc")}, "diagnosis": {"recordings": {"disc": {}}}}
    projections_folder(tmp_path / "disc")
    monkeypatch.chdir(tmp_path)
    known = read_context(config, root / "workflow")
    folder, page = tmp_path / "r", tmp_path / "r" / "index.html"
    for file in (*known.pages.pictures(), *known.pages.tables()):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(results / ("figures/rois.png" if file.endswith(".png") else "features.csv"), file)
    assert renew(known.pages, to_mapping(known.study)) is None  # nothing but the study yet
    shutil.copytree(results / "diagnosis" / "disc", folder / "diagnosis" / "disc")
    assert renew(known.pages, to_mapping(known.study)) == page
    assert "Scatter &lt;explains&gt; it." in page.read_text() and 'report.html">Figures' not in page.read_text()
    assert renew(known.pages, to_mapping(known.study)) is None
    for name in ("report", "viewer"):
        (folder / f"{name}.html").write_text("<!doctype html>")
        later = page.stat().st_mtime + 1
        os.utime(folder / f"{name}.html", (later, later))
        assert renew(known.pages, to_mapping(known.study)) == page
        os.utime(page, (later, later))
    for name, title in (("report", "All figures and sortable tables"), ("viewer", "Viewer of slices")):
        assert f'<a href="{name}.html">{title}' in page.read_text()
    assert renew(known.pages, to_mapping(known.study)) is None
    # A study that has not been run has no content.
    page.unlink()
    Path(known.pages.pictures()[0]).unlink()
    assert renew(known.pages, to_mapping(known.study)) is None
