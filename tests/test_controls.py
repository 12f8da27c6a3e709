"""Negative controls of benchmarks/controls.py, and the stored seeds of the study of the paper's groups."""

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


def test_every_control_is_the_study_of_the_papers_groups_with_its_stated_change(tmp_path):
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
    # Only groups of the stability analysis are simulated.
    assert {noise for _, noise in noisy.acquisitions()} == {"dose10"} and len(noisy.acquisitions()) == 8


def test_other_phantom_differs_in_texture_only(tmp_path):
    controls.write_layout(tmp_path / "layout.yaml")
    default_layout, other_layout = (read_layout(path) for path in (None, tmp_path / "layout.yaml"))
    for roi in ("c1", "hem", "n2"):
        one, other = default_layout["tissues"][roi], other_layout["tissues"][roi]
        assert one["hu"] == other["hu"] and [part["sd_hu"] for part in other["texture"]] == [15]
    assert (
        default_layout["tissues"]["spleen"] == other_layout["tissues"]["spleen"]
        and default_layout["rois"] == other_layout["rois"]
    )


def test_stored_seeds_are_of_the_current_study_of_the_papers_groups():
    """After a change of config/paper_groups.yaml, benchmarks/controls.py must run again for the figure's spread."""
    seeds = further_seeds.read_seed_scores()
    assert further_seeds.match_settings(seeds, plan().scored_settings())
    assert not further_seeds.match_settings(seeds, plan(None, "config/tiny.yaml").scored_settings())
    assert seeds["seed"].nunique() == 5 and plan().study.seed not in set(seeds["seed"])
    assert (seeds.groupby("seed").size() == 86).all()


def test_spread_of_the_seeds_is_that_of_their_means():
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
    row = controls.headline(rows, measured.load_score_draws(4), measured.PHANTOM4RADIOMICS_FEATURES)
    assert row["repeats"] == 4
    assert 60 < row["stability_percent"] < 75  # |z| < 1 in 68 % without a difference
    assert row["stability_area"] < row["stability_area_chance"] < 0.6
    assert row["stability_above"] < 30
