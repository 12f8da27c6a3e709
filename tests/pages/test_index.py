"""The first page of a study: its answer, its warnings, and addresses that lead to files that are there."""

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
from test_study import Balanced

from virtual_phantom.report import answer, index, study
from virtual_phantom.statistics.stability_measures import CUT_OFFS
from virtual_phantom.study.context import read_context
from virtual_phantom.study.index_page import renew

CONFIG = {"seed": 2022, "results_dir": "r <1>", "trial": False, "statistics": {"threshold": 1.0, "compare": "roi"}}
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
    for name, frame in ({f"tables/{name}": one for name, one in frames.items()} | {"features": ALL}).items():
        frame.to_csv(folder / f"{name}.csv", index=False)
    (folder / "diagnosis" / "disc" / "diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    (folder / "diagnosis" / "disc" / "report.html").write_text("<!doctype html>")
    return folder


TABLES = ("tables/trust", "tables/stable_features", "tables/stability", "features")


def made(results, *, config=CONFIG, names=TABLES, diagnoses=True, figures=("rois",)):
    sections = {"rois": ("Phantom", "Regions <1>"), "comparison_clinic": ("Recordings", "ours, against clinic")}
    figures = [
        study.Shown(results / "figures" / f"{name}.png", *sections[name], results / "rois.rst", {}, {})
        for name in figures
    ]
    tables = [index.Linked(name.title(), results / f"{name}.csv") for name in names]
    reports = [results / "diagnosis" / "disc" / "report.html"] if diagnoses else []
    return index.page(results, figures, tables, reports, config, COMMANDS)


@pytest.fixture(scope="module")
def page(results):
    return made(results)


def text(page):
    """The words of a page, without tags, on one line."""
    body = re.sub(r"<(style|script).*?</\1>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", "", body).replace("&nbsp;", " ").split())


def test_it_is_well_formed_and_all_it_points_to_is_there(page, results):
    parser = Balanced()
    parser.feed(page)
    assert parser.open == [] and len(parser.ids) == len(set(parser.ids))
    inside = {link[1:] for link in parser.links if link.startswith("#")}
    assert {"answer", "warnings", "tables", "next", "made-by"} <= inside <= set(parser.ids)
    files = {link for link in parser.links if not link.startswith("#")}
    assert files == {"figures/rois.png", "diagnosis/disc/report.html", *(f"{name}.csv" for name in TABLES)}
    assert all((results / link).exists() for link in files)
    assert outside_resources(page) == ["figures/rois.png"]


def test_the_answer_comes_first_and_has_its_intervals(page):
    said = text(page)
    assert "Of 3 features 1 is stable between the 4 protocols, 1 are not, and 1 are undecided." in said
    assert said.index("Which features can be trusted?") < said.index("Warnings ROI") < said.index("Regions")
    # By the lower end of the interval, best first.
    places = [said.index(words) for words in ("62 %, 52 to 68 %", "40 %, 25 to 55 %", "0 %, 0 to 4.4 %")]
    assert places == sorted(places)
    assert "1 by ICC(2,1), 1 by ICC(3,1), 1 by CCC, 1 by cv, 1 by qcd." in said
    assert "a feature that no protocol changes has 60 % on average" in said
    assert "lies at 50 % or above, as more comparisons then agree than differ." in said


def test_the_answer_is_given_for_every_tissue(page, results):
    said = text(page)
    assert "The most stable stability, 95 % interval stable in cyst in liver" in said
    assert "62 %, 52 to 68 % yes 83 % 42 %" in said  # of the features that the other table has, in its order
    # Four protocols are six pairs, and each class has one ROI.
    assert "without an interval, as they are few: 6 in cyst, 6 in liver." in said
    assert 'href="tables/stability.csv"' in page


@pytest.mark.parametrize(("compare", "expected"), [("roi", [12, 6]), ("tissue_class", [6, 6])])
def test_a_tissue_rests_on_the_comparisons_of_its_own_rois(compare, expected):
    rois = pd.DataFrame({"roi": ["a", "b", "c", "a"], "tissue_class": ["cyst", "cyst", "liver", "cyst"]})
    found = answer.tissues(TRUST, STABILITY, rois, compare)
    assert [one["comparisons"] for one in found.values()] == expected
    assert found["liver"]["percent"][FEATURES[1]] == 41.7
    assert answer.tissues(TRUST, STABILITY, rois[rois["roi"] == "c"], compare) == {}


def test_many_tissues_have_a_table_of_their_own(results, tmp_path):
    names = [f"organ_{number}" for number in range(index.MOST_CLASSES + 1)]
    percents = {f"stability_{name}": [10.0 * number + one for one in (1, 2, 3)] for number, name in enumerate(names)}
    frames = {
        "trust": TRUST,
        "stability": STABILITY[["feature", "stability_percent"]].assign(**percents),
        "features": pd.DataFrame({"roi": names, "tissue_class": names, "n_voxels": 100, "grey_levels": 9}),
    }
    for name, frame in frames.items():
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    page = index.page(
        tmp_path, [], [index.Linked(name, tmp_path / f"{name}.csv") for name in frames], [], CONFIG, COMMANDS
    )
    assert "First order Mean 2.0 % 12 % 22 % 32 % 42 % 52 %" in text(page) and '<th class="n">in ' not in page


def test_features_that_other_measures_call_stable_are_named(page):
    assert "By two measures or more: GLCM Idn (6). Each measure of each feature: tables/stable_features.csv." in text(
        page
    )


def test_of_many_stable_features_ten_are_named(results, tmp_path):
    names = [f"original_glcm_F{number:02}" for number in range(12)]
    verdicts = {f"stable_{name}": "yes" for name in CUT_OFFS}
    measures = pd.DataFrame({"feature": names, "stable_by": [2, 5, *[3] * 10], **verdicts})
    assert list(answer.answer(TRUST, measures)["several"])[:3] == [names[1], names[2], names[3]]
    measures.to_csv(tmp_path / "stable_features.csv", index=False)
    TRUST.to_csv(tmp_path / "trust.csv", index=False)
    tables = [index.Linked(name, tmp_path / f"{name}.csv") for name in ("trust", "stable_features")]
    said = text(index.page(tmp_path, [], tables, [], CONFIG, COMMANDS))
    assert "GLCM F01 (5), GLCM F02 (3)" in said and "GLCM F10 (3) and 2 more. Each measure" in said


def test_tables_of_stability_show_the_most_stable_first():
    assert list(index.first_rows(TRUST)["feature"]) == [FEATURES[1], FEATURES[2], FEATURES[0]]
    assert list(index.first_rows(MEASURES)["feature"])[0] == FEATURES[0]
    assert list(index.first_rows(STABILITY)["feature"])[0] == FEATURES[1]
    assert index.first_rows(ALL).equals(ALL)


def test_a_comparison_says_what_agrees(results):
    names = (*TABLES, "tables/comparison_clinic", "tables/comparison_clinic_features")
    page = made(results, names=names, figures=("rois", "comparison_clinic"))
    said = html.unescape(text(page))
    assert (
        "Of 6 features, 1 agree in mean and SD, 1 in the mean only, 2 in the SD only, 2 in neither. A mean agrees "
        "where it lies within 1 repeat SD of the recorded one, an SD where it is from 1/2 to 2 times the recorded "
        "one, each in at least 80 % of the 3 ROIs. 1 puts the ROIs in the recorded order (Kendall's tau at least "
        "0.7). Every feature: tables/comparison_clinic_features.csv."
    ) in said
    assert said.index("Comparisons with recordings: ours, against clinic.") < said.index("Which features can")
    assert 'href="#comparison_clinic"' in page and 'id="comparison_clinic"' in page


def test_features_that_cannot_be_compared_are_counted():
    cells, summary = COMPARISON.values()
    marked = summary.assign(other_settings=["bins", *[None] * 5], other_sizes=[None, "512 voxels", "", *["more"] * 3])
    said = answer.agreement(marked, cells)
    assert said.startswith("Of 1 features that can be compared, 1 agree in the SD only. A mean")
    assert said.endswith(
        " 1 cannot be compared, as they were extracted with other settings (*). 4 cannot be compared, as they grow "
        "with the ROI, whose voxels are others here (†)."
    )


def test_features_without_a_repeat_sd_are_counted_apart():
    cells, summary = COMPARISON.values()
    names = summary["feature"]
    still = pd.concat([cells.assign(feature=name, sd_recorded=float(name != names[0])) for name in names])
    said = answer.agreement(summary, still)
    assert said.startswith(
        "Of 5 features that can be compared, 1 agree in the mean only, 2 in the SD only, 2 in neither."
    )
    assert said.endswith(" 1 cannot be compared, as they are the same in all that was recorded.")
    none = still.assign(sd_recorded=0.0)
    assert answer.agreement(summary, none).startswith(
        "None of 6 features can be compared. 6 cannot be compared, as they"
    )


def test_what_agrees_in_one_roi_has_no_order():
    cells, summary = COMPARISON.values()
    said = answer.agreement(summary.assign(mean_right=False, sd_right=False), cells[cells["roi"] == "a"])
    assert said.startswith("Of 6 features none agrees in mean or SD. A mean agrees") and said.endswith(
        "times the recorded one."
    )


def test_warnings_are_read_from_the_table_of_features():
    said = index.warnings(ALL, TRUST)
    assert [one.partition(".")[0] for one in said] == [
        "ROI cyst_2 has 24 voxels, fewer than the 64 that texture features need to mean anything",
        "ROI cyst_2 has fewer than 3 grey levels in 1 of 2 images",
        "There are 3 repeats a group",
    ]
    assert index.warnings(ALL[ALL["roi"] == "liver"], TRUST.assign(repeats=10)) == []
    assert len(index.warnings(ALL, None)) == 2


def test_a_diagnosis_says_its_verdict(page, results):
    assert "disc: mismatch explained Scatter &lt;explains&gt; it." in text(page)
    assert index.COLOURS["mismatch explained"] in page
    assert "Diagnoses" not in made(results, diagnoses=False)


def test_a_trial_says_so(page, results):
    words = "too small to mean anything"
    assert words not in page and words in made(results, config=CONFIG | {"trial": True})
    said = text(made(results, config=CONFIG | {"trial": "init ct --size normal"}))
    assert f"{words}. It shows that everything is as you mean it. For an answer run: init ct --size normal" in said


def test_a_study_without_groups_has_a_page_too(results):
    page = made(results, names=("features",), diagnoses=False)
    assert "no <code>analyses.stability</code>" in page and "cyst_2 has 24 voxels" in page
    assert "repeats a group" not in page


def test_one_repeat_has_no_interval(results, tmp_path):
    nothing = TRUST.assign(**dict.fromkeys([name for name in TRUST if "low" in name or "high" in name], np.nan))
    nothing.to_csv(tmp_path / "trust.csv", index=False)
    page = index.page(tmp_path, [], [index.Linked("Trust", tmp_path / "trust.csv")], [], CONFIG, COMMANDS)
    assert "nan" not in text(page).lower().replace("finance", "")


LOOK = """
const wider = document.documentElement.scrollWidth > innerWidth;
for (const one of document.querySelectorAll("details")) one.open = true;
return {wider, opened: document.documentElement.scrollWidth > innerWidth,
        bars: [...document.querySelectorAll(".bar i")].map((bar) => bar.getBoundingClientRect().width > 0)};
"""


@pytest.mark.parametrize("width", [1200, 400])
def test_a_browser_shows_it_without_scrolling_sideways(page, results, width):
    found = opened(page, results, LOOK, width)
    assert found == {"wider": False, "opened": False, "bars": [True] * 3}
    (Path(results) / "opened.html").unlink()


def test_the_page_is_renewed_after_what_it_shows_and_only_then(results, tmp_path, monkeypatch):
    """Of a study without analyses; a diagnosis, the report and the viewer are made by targets of their own."""
    root = Path(__file__).resolve().parents[2]
    config = yaml.safe_load((root / "config" / "config.yaml").read_text())
    config |= {"engine": "cpu", "analyses": {}, "results_dir": str(tmp_path / "r")}
    config |= {"recordings": {"disc": str(tmp_path / "disc")}, "diagnosis": {"recordings": {"disc": {}}}}
    projections_folder(tmp_path / "disc")
    monkeypatch.chdir(tmp_path)
    known = read_context(config, root / "workflow")
    folder, page = tmp_path / "r", tmp_path / "r" / "index.html"
    for file in (*known.pages.pictures(), *known.pages.tables()):
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(results / ("figures/rois.png" if file.endswith(".png") else "features.csv"), file)
    assert renew(known.pages, known.config) is None  # there is nothing beside the study yet
    shutil.copytree(results / "diagnosis" / "disc", folder / "diagnosis" / "disc")
    assert renew(known.pages, known.config) == page
    assert "Scatter &lt;explains&gt; it." in page.read_text() and 'report.html">Figures' not in page.read_text()
    assert renew(known.pages, known.config) is None
    for name in ("report", "viewer"):
        (folder / f"{name}.html").write_text("<!doctype html>")
        later = page.stat().st_mtime + 1
        os.utime(folder / f"{name}.html", (later, later))
        assert renew(known.pages, known.config) == page
        os.utime(page, (later, later))
    for name, title in (("report", "All figures and sortable tables"), ("viewer", "Viewer of slices")):
        assert f'<a href="{name}.html">{title}' in page.read_text()
    assert renew(known.pages, known.config) is None
    # Of a study that has not been run there is nothing to be said.
    page.unlink()
    Path(known.pages.pictures()[0]).unlink()
    assert renew(known.pages, known.config) is None
