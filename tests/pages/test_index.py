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
from robust_study import (
    CUT_OFFS,
    NOISE,
    extracted_table,
    extraction_pairs,
    feature_table,
    robustness_table,
    setting_pairs,
)
from test_study import Balanced

from virtual_phantom.base.settings import to_mapping
from virtual_phantom.figures import trust_map
from virtual_phantom.report import answer, index, study
from virtual_phantom.statistics import robustness
from virtual_phantom.statistics.extraction_settings import long_table
from virtual_phantom.study.context import read_context
from virtual_phantom.study.index_page import renew

CONFIG = resolved("paper_groups.yaml") | {"results_dir": "r <1>"}
TRUST = robustness_table()
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
ALL = feature_table().assign(n_voxels=24)
SMALL = pd.DataFrame(
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
    for name in ("rois", "comparison_clinic", "trust_map"):
        (folder / "figures" / f"{name}.png").write_bytes(picture.getvalue())
    (folder / "figures" / "trust_map.pdf").write_bytes(b"%PDF")
    (folder / "tables" / "robust_features.yaml").write_text("# none")
    (folder / "rois.rst").write_text('**Regions** of {{ snakemake.config["seed"] }}.\n')
    frames = {"trust": TRUST, "controls": CONTROLS, **COMPARISON}
    for name, frame in ({f"tables/{name}": one for name, one in frames.items()} | {"features": ALL}).items():
        frame.to_csv(folder / f"{name}.csv", index=False)
    (folder / "diagnosis" / "disc" / "diagnosis.json").write_text(json.dumps(DIAGNOSIS))
    (folder / "diagnosis" / "disc" / "report.html").write_text("<!doctype html>")
    return folder


TABLES = ("tables/trust", "tables/controls", "features")


def made(results, *, config=CONFIG, names=TABLES, diagnoses=True, figures=("rois",)):
    sections = {"rois": ("Phantom", "Regions <1>"), "comparison_clinic": ("Recordings", "simulation and clinic")}
    figures = [
        study.ReportFigure(results / "figures" / f"{name}.png", *sections[name], results / "rois.rst", {}, {})
        for name in figures
    ]
    tables = [(name.title(), results / f"{name}.csv") for name in names]
    reports = [results / "diagnosis" / "disc" / "report.html"] if diagnoses else []
    return index.index_page(results, figures, tables, reports, config, COMMANDS, pairs=setting_pairs())


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
    chart = {"figures/trust_map.png", "figures/trust_map.pdf", "tables/robust_features.yaml"}
    assert files == {"figures/rois.png", "diagnosis/disc/report.html", *(f"{name}.csv" for name in TABLES)} | chart
    assert all((results / link).exists() for link in files)
    # The libraries of the chart contain addresses but load nothing: see `requests` in LOOK.
    own = page.replace(trust_map.bundle(), "")
    assert outside_resources(own) == ["figures/trust_map.png", "figures/rois.png"]


def test_libraries_of_the_chart_are_kept_and_made_again_if_damaged(tmp_path, monkeypatch):
    made = iter(["1 </script>", "2"])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(trust_map.vl_convert, "javascript_bundle", lambda vl_version: next(made))
    assert [trust_map.bundle(), trust_map.bundle()] == [r"1 <\/script>"] * 2
    (kept,) = tmp_path.rglob("vega*.js")
    kept.write_text("1")
    assert [trust_map.bundle(), trust_map.bundle()] == ["2", "2"]


def test_answer_comes_first_with_its_reasons(page):
    page_words = text(page)
    assert (
        "Which features can I trust, for which change? 1 of 3 features is robust for every change (random" in page_words
    )
    assert "dose, any two protocols): First order Mean." in page_words
    assert page_words.index("1 of 3 features") < page_words.index("Regions")
    assert "Robust for one kind of change: re-positioning 2, dose 1, any two protocols 2." in page_words
    assert "First order Entropy. Not robust for dose. Lowest for dose: ICC" in page_words
    assert "rises by 8.0 % from 10 mGy to 3 mGy." in page_words
    assert "estimated from 6 regions. These are few, so intervals are wide." in page_words


def test_extraction_settings_are_shown_but_do_not_count(page, results, tmp_path):
    names = ("trust", "features")
    trust = robustness.with_extraction(TRUST, extracted_table(), extraction_pairs(), CUT_OFFS)
    extracted = {name: rows.drop(columns="setting") for name, rows in extracted_table().groupby("setting")}
    for name, frame in zip(("extraction", *names), (long_table(extracted, {}), trust, ALL), strict=True):
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    tables = [(name, tmp_path / f"{name}.csv") for name in names]
    pairs = [*setting_pairs(), *extraction_pairs()]
    changed = index.index_page(tmp_path, [], tables, [], CONFIG, COMMANDS, pairs=pairs)
    sentence = "Extraction settings are in the map and do not count for “robust”, because you choose them once."
    assert sentence in text(changed) and sentence not in text(page)
    headline = text(page)[text(page).index("1 of 3 features") : text(page).index("Controls:")]
    assert headline in text(changed) and "extraction settings" not in headline
    (chart,) = re.findall(r"const {wide, narrow, data} = (.*);\n", changed)
    data = json.loads(chart)["data"]
    settings = {row["name"]: row for row in data["settings"] if row["key"].startswith("extraction settings|")}
    assert list(settings) == ["study", "bin_width_10"] and settings["study"]["context"] == "thin, high"
    keys = [row["key"] for row in data["settings"]]
    assert len(set(keys)) == len(keys)
    number = int(settings["bin_width_10"]["key"].split("|")[1])
    (curve,) = (
        row
        for row in data["curves"]
        if row["feature"] == NOISE and row["region"] == "liver 1" and number in row["number"]
    )
    own = extracted_table()
    own = own[(own["setting"] == "bin_width_10") & (own["roi"] == "liver_1") & (own["seed"] < 4)]
    assert curve["mean"][curve["number"].index(number)] == pytest.approx(own[NOISE].mean(), rel=1e-3)


def test_controls_are_next_to_the_answer(page):
    page_words = text(page).replace("\u00a0", " ")
    controls = page_words[page_words.index("Controls:") :]
    assert controls.startswith(
        "Controls: 2 of 3 are robust if only noise changes (random repeats). If regions are exch"
    )
    assert (
        "By the paper's W, the mean stability is 34.0 % (by chance: 60.0 %), and the mean discriminative power 92.4 % "
        "(pairs of one tissue class: 89.0 %; by chance: 40.0 %). All controls."
    ) in html.unescape(controls)


def test_study_without_two_rois_of_a_class_has_no_such_control(tmp_path):
    same = CONTROLS["control"] == "same class"
    alone = CONTROLS.assign(percent=CONTROLS["percent"].mask(same), pairs=CONTROLS["pairs"].mask(same, 0))
    alone.loc[same, "meaning"] = "Not possible: no tissue class has two ROIs."
    alone.to_csv(tmp_path / "controls.csv", index=False)
    TRUST.to_csv(tmp_path / "trust.csv", index=False)
    tables = [(name, tmp_path / f"{name}.csv") for name in ("trust", "controls")]
    page_words = text(index.index_page(tmp_path, [], tables, [], CONFIG, COMMANDS))
    assert "(no control of one tissue class; by chance:" in page_words
    assert "Pairs of one class: Not possible: no tissue class has two ROIs." in page_words


def test_shape_and_size_are_not_counted_as_robust(page):
    page_words = text(page)
    assert "Grow with the size of the region, not counted 1First order Energy." in page_words
    assert "Do not vary between the images, not counted 1SHAPE Sphericity. Depends on the mask only" in page_words
    assert "Sphericity" not in page_words[: page_words.index("Controls:")]


def test_first_rows_are_the_most_robust():
    rows = pd.DataFrame({"feature": ["a", "b"], "stable_by": [1, 6]})
    assert list(index.first_rows(rows)["feature"]) == ["b", "a"]
    assert index.first_rows(SMALL).equals(SMALL)


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
    first = "Comparison: simulation and clinic. Agreement of the 6 features: mean and SD 1, mean only 1, SD only 2"
    assert page_words.index(first) < page_words.index("1 of 3 features")
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
    page_words = index.study_warnings(SMALL, TRUST.assign(repeats=3))
    assert [word.partition(".")[0] for word in page_words] == [
        "ROI cyst_2 has 24 voxels",
        "ROI cyst_2 has fewer than 3 gray levels in 1 of 2 images",
        "There are 3 repeats per group",
    ]
    assert "need at least 64" in page_words[0]
    assert index.study_warnings(SMALL[SMALL["roi"] == "liver"], TRUST) == []
    assert len(index.study_warnings(SMALL, None)) == 2


def test_diagnosis_verdict_is_shown(page, results):
    assert "disc: mismatch explained Scatter &lt;explains&gt; it." in text(page)
    assert index.COLORS["mismatch explained"] in page
    assert "Diagnoses" not in made(results, diagnoses=False)


def test_trial_is_labeled(page, results):
    words = "too small for meaningful results"
    assert words not in page and words in made(results, config=CONFIG | {"trial": True})
    page_words = text(made(results, config=CONFIG | {"trial": "init ct --size normal"}))
    assert f"{words}. Use it to check your setup. For results, run: init ct --size normal" in page_words


def test_study_without_groups_has_a_page(results, tmp_path):
    SMALL.to_csv(tmp_path / "features.csv", index=False)
    page = index.index_page(tmp_path, [], [("features", tmp_path / "features.csv")], [], CONFIG, COMMANDS)
    assert "no <code>analyses.stability</code>" in page and "cyst_2 has 24 voxels" in page
    assert "repeats per group" not in page and "vegaEmbed" not in page


LOOK = """
const wider = document.documentElement.scrollWidth > innerWidth;
for (const one of document.querySelectorAll("details")) one.open = true;
return {wider, opened: document.documentElement.scrollWidth > innerWidth,
        cells: document.querySelectorAll("#map path[aria-roledescription='rect mark'], #map .mark-rect path").length,
        requests: performance.getEntriesByType("resource").filter((one) => one.name.startsWith("http")).length,
        choices: [...document.querySelectorAll("#choices select")].map((one) => one.options.length)};
"""


@pytest.mark.parametrize("width", [1200, 400])
def test_page_fits_a_browser_without_horizontal_scrolling(page, results, width):
    found = opened(page, results, LOOK, width)
    assert found["cells"] >= 20 and found["choices"] == [4, 4]  # four measures; all regions and three classes
    assert not found["wider"] and not found["opened"] and found["requests"] == 0
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
