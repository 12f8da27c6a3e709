"""Comparison of the paper with its reproduction: benchmarks/reproduction.py and its page."""

import numpy as np
import pandas as pd
import pytest

from benchmarks import common, reproduction
from virtual_phantom.config.plan import Plan
from virtual_phantom.features import tables
from virtual_phantom.features.names import FEATURES
from virtual_phantom.io.files import read_csv, write_csv
from virtual_phantom.statistics import measured, wilcoxon

PLAN = Plan(common.configuration(reproduction.CONFIG))


def test_reproduction_has_the_groups_and_the_sampling_of_the_paper():
    groups = {PLAN.study.protocols[name].algorithm: [] for name in PLAN.groups()}
    for name in PLAN.groups():
        groups[PLAN.study.protocols[name].algorithm].append(PLAN.study.protocols[name].projections)
    assert groups == dict.fromkeys(("sirt", "fbp"), [150, 200, 250, 300])
    scan = PLAN.study.scan
    assert scan.rows * scan.row_pitch_mm == 512 and (scan.pitch, scan.turns) == (1, 1)
    assert (scan.source_to_isocentre_mm, scan.source_to_detector_mm) == (500, 1000)
    assert PLAN.repeats(["dose10"]) == 10


def test_lists_of_the_paper_share_seven_and_five_features():
    assert reproduction.paper_overlap() == {"stability_ten_phantom": 7, "discrimination_ten_phantom": 5}


def test_scores_equal_to_a_list_of_the_paper_share_all_of_it():
    published = reproduction.measured.load_published_top().query("source == 'simulator'")
    rank = published.pivot(index="feature", columns="kind", values="rank").reindex(list(FEATURES))
    scores = (100 - rank).fillna(0).add_suffix("_percent").rename_axis("feature").reset_index()
    found = reproduction.published_overlap(scores)
    assert found["stability_ten_simulator"] == found["discrimination_ten_simulator"] == 10
    assert found["stability_ten_phantom"] == 7 and found["discrimination_ten_phantom"] == 5


def test_pairs_of_one_class_without_a_difference_exceed_one_as_often_as_by_chance():
    random = np.random.default_rng(4)
    keys = [(group, roi) for group in range(8) for roi in ("a", "b", "c") for _ in range(10)]
    table = pd.DataFrame(random.normal(size=(len(keys), len(FEATURES))), columns=list(FEATURES))
    table = table.assign(group=[group for group, _ in keys], roi=[roi for _, roi in keys])
    table["tissue_class"] = table["roi"].map({"a": "one", "b": "one", "c": "other"})
    # 31.5 % for ten repeats, by all arrangements of the ranks.
    found = reproduction.score_values(table.assign(seed=np.tile(np.arange(10), 24)))
    assert found["same_class_percent"] == pytest.approx(31.5, abs=4)


def test_list_is_compared_with_measured_ones_of_as_many_repeats():
    """The printed phantom's own feature order agrees with its realizations far above chance; a random one does not."""
    rng = np.random.default_rng(np.random.SeedSequence(3))
    rows = pd.DataFrame(
        rng.normal(size=(8 * 6 * 4, len(measured.PHANTOM4RADIOMICS_FEATURES))),
        columns=list(measured.PHANTOM4RADIOMICS_FEATURES),
    )
    rois = np.tile(np.repeat(list(measured.TISSUE_CLASSES), 4), 8)
    rows = rows.assign(
        group=np.repeat(np.arange(8), 24), roi=rois, tissue_class=[measured.TISSUE_CLASSES[roi] for roi in rois]
    )
    features = measured.PHANTOM4RADIOMICS_FEATURES
    row = reproduction.headline(rows, wilcoxon.scores(rows, features), measured.load_score_draws(4), features)
    assert row["repeats"] == 4
    assert 60 < row["stability_percent"] < 75  # |z| < 1 in 68 % without a difference
    assert row["stability_area"] < row["stability_area_chance"] < 0.6
    assert row["stability_above"] < 30


def test_interval_of_the_mean_is_that_of_student():
    found = reproduction.interval(pd.Series([1.0, 2, 3, 4, 5]))
    half = 2.776 * np.sqrt(2.5 / 5)
    assert [found[key] for key in ("mean", "sd", "low", "high")] == pytest.approx(
        [3, np.sqrt(2.5), 3 - half, 3 + half], abs=1e-3
    )


def test_page_has_the_tables_of_the_stored_values_of_the_current_settings():
    """After a change of the reproduction, run the benchmark again; it writes the tables of the page."""
    stored = read_csv(reproduction.STORED)
    assert set(stored["settings"]) == {PLAN.scored_settings()}
    assert set(stored["seed"]) <= set(reproduction.SEEDS) and PLAN.study.seed not in set(stored["seed"])
    page = reproduction.PAGE.read_text(encoding="utf-8")
    for path, table in reproduction.page_tables(stored).items():
        assert path.read_text(encoding="utf-8") == table.to_csv(index=False, lineterminator="\n"), path.name
        assert f"<!-- table: {path.name} -->\n" in page, path.name


def test_groups_of_a_study_have_ten_repeats_at_its_noise_level(tmp_path):
    seeds = range(PLAN.repeats(["dose10"]))
    keys = [(name, seed) for name in PLAN.study.protocols for seed in seeds]
    table = pd.DataFrame(1.0, range(len(keys)), [*tables.METADATA, *FEATURES])
    table[["protocol", "seed"]] = keys
    write_csv(table.assign(noise="dose10"), tmp_path / "features.csv")
    found = reproduction.groups_of(tmp_path / "features.csv", PLAN)
    assert dict(zip(found["protocol"], found["group"], strict=True)) == PLAN.groups()
    assert set(found.value_counts("group")) == {10}
