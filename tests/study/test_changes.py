"""Pairs of settings that differ in one kind of change, from the configuration."""

from collections import Counter
from pathlib import Path

import pytest
import yaml

from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.study.changes import setting_pairs

CONFIG = Path(__file__).resolve().parents[2] / "config"
# The names say the opposite of the settings.
NAMES = {"group_1": "thick_fbp", "group_2": "dose_iterative", "group_3": "group_1"}


def pairs(change=lambda config: None, file="config.yaml"):
    config = yaml.safe_load((CONFIG / file).read_text())
    change(config)
    return setting_pairs(Plan(read_study(config)))


def between(found, kind):
    """(protocol, noise level, label) of both settings of all pairs of one kind."""
    return [
        [(end.where["protocol"], end.where["noise"], end.label) for end in (pair.first, pair.second)]
        for pair in found
        if pair.kind == kind
    ]


@pytest.fixture(scope="module")
def default():
    return pairs()


def test_default_study_has_all_single_changes(default):
    counts = Counter(pair.kind for pair in default)
    assert counts == {
        **{"random repeats": 12, "re-positioning": 12, "dose": 6, "reconstruction": 6, "slice thickness": 6},
        "any two protocols": 28,
    }


def test_doses_fall_within_one_protocol(default):
    for first, second in between(default, "dose"):
        assert first[0] == second[0]
    assert [[end[2] for end in pair] for pair in between(default, "dose")][:3] == [
        ["mgy10", "mgy3"],
        ["mgy10", "mgy1"],
        ["mgy3", "mgy1"],
    ]


def test_protocols_that_differ_in_two_settings_are_no_single_change(default):
    """Groups 7 and 8 have another kernel and other slices than all others."""
    single = [pair for pair in default if pair.kind in ("dose", "kernel", "reconstruction", "slice thickness")]
    ends = [{pair.first.where["protocol"], pair.second.where["protocol"]} for pair in single]
    assert [end for end in ends if end & {"group_7", "group_8"}] == [{"group_7", "group_8"}]


def test_changes_do_not_depend_on_names(default):
    def rename(config):
        config["protocols"] = {NAMES.get(name, name): protocol for name, protocol in config["protocols"].items()}
        config["noise"]["levels"] = {
            {"mgy10": "low", "mgy1": "high"}.get(name, name): level for name, level in config["noise"]["levels"].items()
        }
        text = yaml.safe_dump(config["analyses"])
        for name, new in {"mgy10": "low", "mgy1": "high", **NAMES}.items():
            text = text.replace(f"- {name}\n", f"- {new}\n").replace(f": {name}\n", f": {new}\n")
        config["analyses"] = yaml.safe_load(text)

    renamed = pairs(rename)
    assert [pair.kind for pair in renamed] == [pair.kind for pair in default]
    back = {new: name for name, new in NAMES.items()}
    for kind in ("reconstruction", "slice thickness"):
        ends = [[back.get(end[0], end[0]) for end in pair] for pair in between(renamed, kind)]
        assert ends == [[end[0] for end in pair] for pair in between(default, kind)]


def test_repositioned_repeats_are_compared_with_the_others_only(default):
    for pair in default:
        if pair.kind == "re-positioning":
            assert not set(pair.first.seeds) & set(pair.second.seeds) and len(pair.second.seeds) == 2
        elif pair.kind != "any two protocols":
            assert len(pair.first.seeds) in (3, 8)  # of 5 and 10 repeats, without the re-positioned ones


def test_repositioned_repeats_alone_are_no_random_repeats():
    def reposition(config):
        config["repeats"]["repositioned"] = max(level["repeats"] for level in config["noise"]["levels"].values())
        config["analyses"] = {"stability": config["analyses"]["stability"]}

    found = pairs(reposition)
    assert {pair.kind for pair in found if pair.relation == "repeats"} == {"re-positioning"}
    assert "random repeats" not in {pair.kind for pair in found}


def test_projections_and_algorithm_of_the_paper():
    counts = Counter(pair.kind for pair in pairs(file="paper_groups.yaml"))
    assert counts["projections"] and counts["reconstruction"] and not counts["slice thickness"]


def test_study_without_stability_has_no_pairs():
    assert pairs(lambda config: config.update(analyses={})) == ()
