"""Studies of one ROI, one tissue class or one protocol, and protocols with their own noise levels."""

import copy
from pathlib import Path

import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.config.config import check, read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.study import analyses
from virtual_phantom.study.changes import extraction_pairs, setting_pairs

ROOT = Path(__file__).resolve().parents[2]
DEFAULT = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
NEED_CLASSES = {"figure_stability_discrimination", "top_features", "pca", "figure_pca_fbp"}
ANY = {"stability_measures", "merge_features", "figure_rois", "index_page"}


def config_of(classes, groups=8, **analyses_of_study):
    config = copy.deepcopy(DEFAULT)
    rois = [{"name": f"roi_{i}", "tissue_class": name, "label": i} for i, name in enumerate(classes, 1)]
    config["phantom"] = {"source": "ct", "ct": {"image": "ct.nii.gz", "labels": "l.nii.gz", "rois": rois}}
    config["measured"] = {"overlay": False}
    for name, protocol in config["protocols"].items():
        if protocol.get("group", 0) > groups:
            config["protocols"][name] = {key: value for key, value in protocol.items() if key != "group"}
    config["analyses"] |= analyses_of_study
    return config


def plan_of(*arguments, **changes):
    return Plan(read_study(config_of(*arguments, **changes)))


def rules(plan):
    return {job.outputs[0].rule for job in analyses.jobs(plan)}


def test_two_classes_allow_everything():
    plan = plan_of(["liver", "cyst"])
    assert analyses.impossible(plan) == [] and rules(plan) >= NEED_CLASSES | ANY | {"trust", "stability"}


def test_one_roi_has_stability_and_no_discrimination():
    plan = plan_of(["lesion"])
    assert rules(plan) >= ANY | {"trust", "stability"} and not rules(plan) & NEED_CLASSES
    assert analyses.impossible(plan) == [
        "Discriminative power, rankings and principal components: not possible, since the study has one ROI. Add an "
        "ROI of another tissue.",
        "ICC and CCC: not possible, since they compare several ROIs. Use W, CV or QCD.",
    ]


def test_one_class_is_named():
    plan = plan_of(["liver", "liver"])
    (sentence,) = analyses.impossible(plan)
    assert "since all ROIs have the tissue class liver. Add an ROI of another tissue." in sentence
    assert not rules(plan) & NEED_CLASSES


def test_parts_of_a_region_are_several_rois():
    config = config_of(["lesion"])
    config["phantom"]["ct"]["rois"][0]["parts"] = 3
    assert list(Plan(read_study(config)).tissue_classes) == ["roi_1_1", "roi_1_2", "roi_1_3"]


def test_one_protocol_has_repeatability_only():
    plan = plan_of(["liver", "cyst"], 1)
    assert rules(plan) >= ANY | {"trust"} and not rules(plan) & {"stability", "top_features", "overlap"}
    (sentence,) = analyses.impossible(plan)
    assert sentence.startswith("Stability between protocols: not possible, since only sirt_150 has a group.")
    with pytest.raises(InputError, match="analyses.stability needs a protocol with a group number"):
        check(config_of(["liver", "cyst"], 0))


def test_settings_of_one_roi_need_several_conditions():
    single = plan_of(["lesion"], 1, extraction={"bin_width": [10]})
    assert "extraction_settings" not in rules(single)
    assert analyses.impossible(single)[-1].startswith(
        "Extraction settings: not compared, since one ROI in one protocol"
    )
    assert "extraction_settings" in rules(plan_of(["lesion"], 2, extraction={"bin_width": [10]}))


def test_further_levels_are_scanned_by_all_groups():
    config = copy.deepcopy(DEFAULT)
    config["analyses"] = {"stability": {"noise": ["dose10", "double"]}}
    config["protocols"]["fbp_150"]["noise"] = ["double"]
    config["protocols"]["sirt_150"]["noise"] = ["dose10", "half"]
    plan = Plan(read_study(config))
    compared = plan.compared_levels()
    assert compared.pop("fbp_150") == "double" and set(compared.values()) == {"dose10"}
    assert {noise for protocol, noise in plan.acquisitions() if protocol == "fbp_150"} == {"double"}
    assert {noise for protocol, noise in plan.acquisitions() if protocol == "sirt_150"} == {"dose10"}
    assert {noise for protocol, noise in plan.acquisitions() if protocol == "fbp_200"} == {"dose10", "double"}


def test_one_level_is_the_same_as_a_list_of_one():
    config = copy.deepcopy(DEFAULT)
    listed = copy.deepcopy(DEFAULT)
    listed["analyses"]["stability"]["noise"] = [config["analyses"]["stability"]["noise"]]
    first, second = (Plan(read_study(one)) for one in (config, listed))
    assert first.study == second.study and first.scored_settings() == second.scored_settings()


@pytest.mark.parametrize(
    "levels, message",
    [
        (["dose"], "protocols.fbp_150.noise names 'dose', which does not exist; did you mean 'dose10'"),
        (["double"], "protocols.fbp_150.noise has none of the levels of analyses.stability.noise, dose10; add one"),
        ([], "protocols.fbp_150.noise"),
        (["dose10"], "analyses.pca.fbp needs protocols.fbp_150 at dose10_plus6; add dose10_plus6 to its noise"),
    ],
)
def test_levels_of_a_protocol_are_checked(levels, message):
    config = copy.deepcopy(DEFAULT)
    config["protocols"]["fbp_150"]["noise"] = levels
    with pytest.raises(InputError) as error:
        check(config)
    assert message in str(error.value)


def test_unknown_level_of_a_protocol_is_the_only_mistake():
    config = copy.deepcopy(DEFAULT)
    config["protocols"]["fbp_150"]["noise"] = ["dose"]
    with pytest.raises(InputError) as error:
        check(config)
    line = "config: protocols.fbp_150.noise names 'dose', which does not exist; did you mean 'dose10'?"
    assert str(error.value) == line


def test_changes_of_dose_and_of_both_follow_the_levels_of_the_analysis():
    config = copy.deepcopy(DEFAULT)
    config["analyses"] = {"stability": {"noise": ["dose10", "double"]}}
    config["protocols"]["fbp_150"]["noise"] = ["double"]
    pairs = setting_pairs(Plan(read_study(config)))
    kinds = {kind: [pair for pair in pairs if pair.kind == kind] for kind in ("dose", "protocol and dose")}
    assert len(kinds["dose"]) == 7  # of eight protocols, one has a single level
    assert all(pair.first.where["protocol"] == pair.second.where["protocol"] for pair in kinds["dose"])
    # Each of the 21 pairs of protocols with both levels twice. fbp_150 is already compared with the others at dose10.
    assert len(kinds["protocol and dose"]) == 2 * 21
    for pair in kinds["protocol and dose"]:
        assert all(pair.first.where[key] != pair.second.where[key] for key in ("protocol", "noise"))
    one_level = setting_pairs(Plan(read_study(DEFAULT)))
    assert not [pair for pair in one_level if pair.kind == "protocol and dose"]


def test_extraction_settings_are_changes_of_the_same_images():
    config = copy.deepcopy(DEFAULT)
    config["analyses"]["extraction"] = {"bin_width": [10, 25, 50], "bin_count": [32], "protocols": ["fbp_150"]}
    pairs = extraction_pairs(Plan(read_study(config)))
    names = [(pair.first.where["setting"], pair.second.where["setting"]) for pair in pairs]
    widths = [("study", "bin_width_10"), ("study", "bin_width_50"), ("bin_width_10", "bin_width_50")]
    assert names == [*widths, ("study", "bin_count_32")]
    assert {pair.first.where["noise"] for pair in pairs} == {"dose10"} and {pair.relation for pair in pairs} == {
        "paired"
    }
    assert extraction_pairs(Plan(read_study(DEFAULT))) == ()
