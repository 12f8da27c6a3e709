"""Clinical relevance: differences in images against known differences, and the resulting verdict."""

import numpy as np
import pytest
from scipy import special

from virtual_phantom.diagnosis.comparison.agreement import Features, Regions
from virtual_phantom.diagnosis.comparison.relevance import above_thresholds, image_changes, judge_relevance
from virtual_phantom.diagnosis.verdict_text import PRACTICAL

SPACING = (2.0, 1.0, 1.0)
THRESHOLDS = {"hu": 1, "contrast_percent": 1, "noise_percent": 1, "resolution_percent": 1, "features_sd": 0.2}


@pytest.fixture(scope="module")
def regions():
    y, x = np.mgrid[:80, :80] - 39.5
    distance = np.broadcast_to(np.hypot(y, x) - 28.3, (3, 80, 80))
    return Regions(SPACING, {"object": distance < -4, "air": distance > 4}, distance, np.ones(distance.shape, bool))


def images(regions, seed, *, repeats=6, hu=0.0, sigma=10.0, blur=1.0, more=0.0):
    random = np.random.default_rng(np.random.SeedSequence(seed))
    clean = -1000 + (hu + 1000) * (1 - special.erf(regions.distance_mm / (np.sqrt(2) * blur))) / 2
    return clean + more + sigma * random.normal(size=(repeats, *clean.shape))


def independent(regions):
    """Independent values of white noise."""
    return regions.inner.sum()


def changes(reference, others, regions):
    return image_changes(reference, others, regions, independent(regions))


def test_known_changes_are_reported(regions):
    base = images(regions, 1)
    twins = {
        "hu": (images(regions, 1, hu=-20.0), -20.0),
        "contrast_percent": (images(regions, 1, hu=-20.0), -2.0),
        "noise_percent": (images(regions, 1, sigma=9.0), -10.0),
        "resolution_percent": (images(regions, 1, blur=1.1), 100 * (1 / 1.1 - 1)),
    }
    for quantity, (twin, truth) in twins.items():
        found = image_changes(base, twin, regions, independent(regions), paired=True)[quantity]
        assert found.value == pytest.approx(truth, rel=0.05), quantity
    same = image_changes(base, base, regions, independent(regions), Features(regions), paired=True)
    assert set(same) == set(THRESHOLDS) and all(one.value == one.error == 0 for one in same.values())


def test_rings_of_a_single_repeat_are_reported(regions):
    """Without repeats there is no noise to compare with: the change is certain."""
    y, x = np.mgrid[:80, :80] - 39.5
    rings = 4.0 * np.sign(np.sin(2 * np.pi * np.hypot(y, x) / 3))
    one, other = (images(regions, 1, repeats=1, more=more) for more in (0.0, rings))
    assert image_changes(one, other, regions, np.nan, paired=True)["hu"].least == pytest.approx(4.0, rel=0.01)


def test_noise_alone_is_never_reported_as_relevant(regions):
    """None of 40 pairs of recordings that differ by noise alone exceeds a threshold, however low it is."""
    lowest = dict.fromkeys(THRESHOLDS, 0.0)
    reported = [
        above_thresholds(as_told(images(regions, 2 * i), images(regions, 2 * i + 1), regions), lowest)
        for i in range(40)
    ]
    # One in 22 of the three relative measures exceeds two standard errors; one in 20 of the largest HU, for two
    # measures.
    assert sum(len(one) for one in reported) <= 20
    assert not [one for one in reported if over_by_margin(one)]


def test_noise_of_two_repeats_is_rarely_reported_as_a_difference_in_hu(regions):
    """One in 20 for each of two measures; with normal quantiles, nearly all were reported."""
    pairs = (
        changes(images(regions, 2 * i, repeats=2), images(regions, 2 * i + 1, repeats=2), regions)["hu"]
        for i in range(20)
    )
    assert sum(change.least > 0 for change in pairs) <= 5


def as_told(without, with_it, regions):
    return {name: {"value": one.value, "error": one.error} for name, one in changes(without, with_it, regions).items()}


def over_by_margin(found):
    return {name: value for name, value in found.items() if name == "contrast_percent" and abs(value) > 1}


def test_local_difference_outside_of_all_regions_is_detected(regions):
    """A lump of 5 HU between the regions, and rings of zero mean."""
    lump, rings = np.zeros((80, 80)), np.zeros((80, 80))
    lump[32:40, 32:40] = 5.0
    y, x = np.mgrid[:80, :80] - 39.5
    rings[:] = 4.0 * np.sign(np.sin(2 * np.pi * np.hypot(y, x) / 3))
    for more, size in ((lump, 5.0), (rings, 4.0)):
        found = changes(images(regions, 3), images(regions, 4, more=more), regions)["hu"]
        assert abs(found.value) == pytest.approx(size, abs=2 * found.error + 0.3)
        assert abs(found.value) - 2 * found.error > 1


def reported(recorded, effects, together=None):
    def stated(values):
        return {name: {"value": value, "error": 0.0} for name, value in values.items()}

    each = {name: stated(values) for name, values in effects.items()}
    return {"recorded": stated(recorded), "effects": each, "together": stated(together or {})}


def content(verdict, effects, practice):
    place = {"domain": "columns", "where": "column 3", "z": 9.0, "p": 1e-9, "map": "columns.npy"}
    return {
        "recording": "bench",
        "verdict": verdict,
        "locations": [place],
        "effects": [{"name": name} for name in effects],
        "ambiguous_with": {},
        "unexplained": [],
        "doubts": [],
        "excess_removed": 0.763,
        "held_out": {"rms_line_integral": {"before": 0.00326, "after": 0.00321, "floor": 0.0021}},
        "agreement": {"metrics": {}, "left_out": {}, "practice": practice},
    }


def test_effect_below_the_relevance_thresholds_is_not_reported_as_missing():
    effects = {"dark_signal": {"hu": 0.03, "contrast_percent": 0.02}, "veiling_glare": {"hu": -0.2}}
    found = judge_relevance(content("mismatch explained", effects, reported({"hu": 0.4}, effects)), THRESHOLDS)
    assert found["verdict"] == PRACTICAL and found["practice"]["small"] == list(effects)
    differs = judge_relevance(
        content("mismatch explained", effects, reported({"resolution_percent": -1.23}, effects)), THRESHOLDS
    )
    assert differs["verdict"] == "unexplained"
    assert differs["practice"]["differing"] == {"resolution_percent": -1.23}
    exact = judge_relevance(content("mismatch explained", effects, reported({}, effects)), dict.fromkeys(THRESHOLDS, 0))
    assert exact["verdict"] == "mismatch explained" and exact["practice"]["small"] == []


def test_relevant_effect_is_named_and_the_other_is_listed():
    effects = {"scatter": {"hu": -12.0}, "dark_signal": {"hu": 0.03}}
    found = judge_relevance(content("mismatch explained", effects, reported({"hu": -12.0}, effects)), THRESHOLDS)
    assert found["verdict"] == "mismatch explained"
    assert found["practice"]["small"] == ["dark_signal"]


def test_effects_that_are_only_relevant_together_are_all_named():
    effects = {"scatter": {"hu": 0.8}, "bowtie": {"hu": 0.7}}
    found = judge_relevance(
        content("mismatch explained", effects, reported({"hu": 1.5}, effects, {"hu": 1.5})), THRESHOLDS
    )
    assert found["practice"]["small"] == [] and found["verdict"] == "mismatch explained"


def test_recording_without_images_has_no_relevance():
    without = content("mismatch explained", {"scatter": {}}, None) | {
        "agreement": {"metrics": {}, "left_out": {"images": "no"}}
    }
    assert judge_relevance(without, THRESHOLDS) == without


def test_wrong_declaration_is_no_match_even_if_images_agree():
    off = {"stated": 0.005, "sd": 0.001, "value": 0.02, "ci95": [0.019, 0.021], "unit": "1", "pull": 15.0, "off": True}
    document = content("mismatch explained", {}, reported({}, {})) | {"declared": {"scatter": {"amount": off}}}
    found = judge_relevance(document, THRESHOLDS)
    assert found["verdict"] == "mismatch explained"
