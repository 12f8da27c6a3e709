"""The negative controls of benchmarks/controls.py, and what is kept of the default study's further seeds."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import common, controls
from virtual_phantom.config import config
from virtual_phantom.config.plan import Plan
from virtual_phantom.phantom.layout import read_layout
from virtual_phantom.statistics import further_seeds, measured

ROOT = Path(__file__).resolve().parents[1]


def plan(changes=None, *files):
    merged = common.read_config()
    for overlay in (*map(common.read_config, files), changes or {}):
        common.merge(merged, overlay)
    return Plan(config.read_study(merged))


def test_every_control_is_the_default_study_but_for_what_it_says(tmp_path):
    default = plan()
    assert plan(None, "config/controls.yaml").scored_settings() == default.scored_settings() != ""
    studies = controls.studies()
    for seed in controls.SEEDS:
        assert plan(studies[f"seed{seed}"], "config/controls.yaml").scored_settings() == default.scored_settings()
    assert len(set(controls.SEEDS) - {default.study.seed}) == 5
    noisy = plan(studies["noise_x10"], "config/controls.yaml")
    levels = (one.study.noise.levels["dose10"].A for one in (noisy, default))
    assert next(levels) == pytest.approx(10 * next(levels))
    assert noisy.scored_settings() != default.scored_settings() != plan(None, "config/tiny.yaml").scored_settings()
    # Nothing is simulated but the groups of the stability analysis.
    assert {noise for _, noise in noisy.acquisitions()} == {"dose10"} and len(noisy.acquisitions()) == 8


def test_the_other_phantom_differs_in_texture_alone(tmp_path):
    controls.write_layout(tmp_path / "layout.yaml")
    ours, theirs = (read_layout(path) for path in (None, tmp_path / "layout.yaml"))
    for roi in ("c1", "hem", "n2"):
        one, other = ours["tissues"][roi], theirs["tissues"][roi]
        assert one["hu"] == other["hu"] and [part["sd_hu"] for part in other["texture"]] == [15]
    assert ours["tissues"]["spleen"] == theirs["tissues"]["spleen"] and ours["rois"] == theirs["rois"]


def test_kept_seeds_are_of_the_default_study_as_it_is():
    """Who changes the default study runs benchmarks/controls.py, and its figure says the new spread."""
    seeds = further_seeds.read_seed_scores()
    assert further_seeds.match_settings(seeds, plan().scored_settings())
    assert not further_seeds.match_settings(seeds, plan(None, "config/tiny.yaml").scored_settings())
    assert seeds["seed"].nunique() == 5 and plan().study.seed not in set(seeds["seed"])
    assert (seeds.groupby("seed").size() == 86).all()


def test_the_spread_of_the_seeds_is_that_of_their_means():
    seeds = pd.DataFrame(
        {
            "settings": "a",
            "seed": [1, 1, 2, 2, 3, 3],
            "stability_percent": [0.0, 2, 2, 4, 4, 6],  # means 1, 3, 5
            "discrimination_percent": [90.0, 90, 90, 90, 90, 90],
        }
    )
    assert further_seeds.sd_over_seeds(seeds) == (pytest.approx(2), 0)
    assert further_seeds.match_settings(seeds, "a") and not further_seeds.match_settings(seeds.iloc[:0], "a")


def test_a_list_is_set_beside_measured_ones_of_as_many_repeats():
    """The printed phantom's own order of features agrees with its draws far above chance; a random one does not."""
    rng = np.random.default_rng(np.random.SeedSequence(3))
    rows = pd.DataFrame(
        rng.normal(size=(8 * 6 * 4, len(measured.STUDY_FEATURES))), columns=list(measured.STUDY_FEATURES)
    )
    rois = np.tile(np.repeat(list(measured.TISSUE_CLASSES), 4), 8)
    rows = rows.assign(
        group=np.repeat(np.arange(8), 24), roi=rois, tissue_class=[measured.TISSUE_CLASSES[roi] for roi in rois]
    )
    row = controls.headline(rows, measured.load_score_draws(4), measured.STUDY_FEATURES)
    assert row["repeats"] == 4
    assert 60 < row["stability_percent"] < 75  # |z| < 1 in 68 % where nothing differs
    assert row["stability_area"] < row["stability_area_chance"] < 0.6
    assert row["stability_above"] < 30
