"""Stored seeds of the default study, and how benchmarks/tandem_groups.py makes them from finished studies."""

import numpy as np
import pandas as pd
import pytest

from benchmarks import common, tandem_groups
from virtual_phantom.base.errors import InputError
from virtual_phantom.config.plan import Plan
from virtual_phantom.features.names import FEATURES
from virtual_phantom.features.parameters import DEFAULT, LARGEST, read_parameters
from virtual_phantom.features.tables import METADATA
from virtual_phantom.statistics import further_seeds, measured, wilcoxon

STORED_VALUES = read_parameters(None, LARGEST, 1024)


def plan(*files):
    return Plan(common.configuration("config/config.yaml", *files))


def test_stored_seeds_are_of_the_current_default_study():
    """After a change of config/config.yaml, run further seeds and store them again for the figure's spread."""
    default, seeds = plan(), further_seeds.read_seed_scores()
    assert further_seeds.match_settings(seeds, default.scored_settings())
    assert seeds["seed"].nunique() >= 2 and default.study.seed not in set(seeds["seed"])
    assert (seeds.groupby("seed").size() == len(FEATURES)).all()


@pytest.mark.parametrize("changes", ["config/tiny.yaml", "config/paper_groups.yaml", "config/whole_regions.yaml"])
def test_stored_seeds_are_not_of_other_studies(changes):
    settings = Plan(common.configuration(changes)).scored_settings()
    assert settings and not further_seeds.match_settings(further_seeds.read_seed_scores(), settings)


def test_other_seeds_and_analyses_have_the_settings_of_the_default_study(tmp_path):
    overlay = tmp_path / "seed.yaml"
    analyses = "{optimal: null, noise_calibration: null, pca: null}"
    overlay.write_text(f"{{seed: 7, noise: {{levels: {{mgy3: null, mgy1: null}}}}, analyses: {analyses}}}")
    assert plan(overlay).scored_settings() == plan().scored_settings()
    stability = Plan(common.configuration("config/reproduction.yaml", "config/stability_only.yaml"))
    assert stability.scored_settings() == Plan(common.configuration("config/reproduction.yaml")).scored_settings()
    # Only the groups of the stability analysis are simulated.
    assert {noise for _, noise in stability.acquisitions()} == {"dose10"} and len(stability.acquisitions()) == 8


def write_study(folder, seed, parameters=STORED_VALUES):
    """Features of all groups, ROIs and repeats with random values."""
    study, random = plan(), np.random.default_rng(seed)
    keys = [
        (protocol, roi, repeat)
        for protocol in study.groups()
        for roi in measured.TISSUE_CLASSES
        for repeat in range(study.repeats(["mgy10"]))
    ]
    rows = pd.DataFrame(random.normal(size=(len(keys), len(FEATURES))), columns=list(FEATURES))
    rows = rows.assign(**dict.fromkeys(METADATA, 1) | {"noise": "mgy10", "settings_hash": parameters.hash()})
    rows[["protocol", "roi", "seed"]] = keys
    rows["tissue_class"] = rows["roi"].map(measured.TISSUE_CLASSES)
    folder.mkdir()
    rows.to_csv(folder / "features.csv", index=False)
    return rows.assign(group=rows["protocol"].map(study.groups()))


def test_scores_of_finished_studies_are_stored_by_seed(tmp_path):
    folders = [tmp_path / "one", tmp_path / "other"]
    tables = [write_study(folder, seed) for seed, folder in enumerate(folders)]
    found = tandem_groups.seed_scores(folders, [2024, 2023], plan())
    assert list(found) == list(further_seeds.read_seed_scores())
    assert further_seeds.match_settings(found, plan().scored_settings())
    assert found["seed"].tolist() == [2024] * len(FEATURES) + [2023] * len(FEATURES)
    for kind in ("stability_percent", "discrimination_percent"):
        expected = [value for table in tables for value in wilcoxon.scores(table, FEATURES)[kind]]
        assert found[kind].tolist() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("seeds", [[2023], [2023, 2023], [2022, 2023]])
def test_every_folder_has_its_own_seed(tmp_path, seeds):
    with pytest.raises(InputError, match=r"--seeds: .* at least two, all different and none of them 2022"):
        tandem_groups.seed_scores([tmp_path, tmp_path], seeds, plan())


def test_features_of_whole_regions_are_not_stored(tmp_path):
    write_study(tmp_path / "whole", 1, DEFAULT)
    with pytest.raises(InputError, match="largest section"):
        tandem_groups.seed_scores([tmp_path / "whole"] * 2, [2023, 2024], plan())


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
