"""Faults that benchmarks add to real scans, and the scores of answers, against values by hand."""

import numpy as np
import pytest

from benchmarks import perturbed_discs as discs
from benchmarks.closing_the_loop import error_of
from virtual_phantom.base.streams import generator

INTENSITIES = np.array([[1.0, 0.5, 0.25, 1.0], [0.8, 0.4, 0.4, 0.8]])
MATCH, LEFT = {"verdict": "match"}, {"verdict": "mismatch partly explained"}


@pytest.mark.parametrize(
    ("fault", "strength", "expected"),
    [
        ("lag", 0.1, [[1.0, 0.5, 0.25, 1.0], [0.82, 0.41, 0.385, 0.82]]),
        ("constant", 0.1, [[1.1, 0.6, 0.35, 1.1], [0.9, 0.5, 0.5, 0.9]]),
        ("blur", 0.1, [[0.95, 0.525, 0.35, 0.925], [0.76, 0.44, 0.44, 0.76]]),
        ("start angle", 1, [[0.8, 0.4, 0.4, 0.8], [1.0, 0.5, 0.25, 1.0]]),
    ],
)
def test_faults(fault, strength, expected):
    changed, _ = discs.FAULTS[fault].perturb(INTENSITIES, strength, generator(0))
    np.testing.assert_allclose(changed, expected, rtol=1e-12)


def test_faults_of_columns_change_the_stated_columns():
    intensities = np.arange(1.0, 41.0)[None] / 40
    for name, value in (("strip", 0.5), ("repeated columns", 4)):
        changed, facts = discs.FAULTS[name].perturb(intensities, value, generator(3))
        first, last = facts["columns"]
        assert last - first == 3
        expected = intensities[0].copy()
        block = slice(first, last + 1)
        expected[block] = 0.5 * expected[block] if name == "strip" else expected[first - 1]
        np.testing.assert_array_equal(changed[0], expected)


def test_reduced_lines_average_intensities():
    lines = np.zeros((721, 8))
    lines[discs.VIEW_STEP] = -np.log([0.1, 0.2, 0.3, 0.4, 1, 1, 1, 1])
    found, _ = discs.reduced(lines, None, 0.0, None)
    assert found.shape == (40, 2)
    np.testing.assert_allclose(found[1], [-np.log(0.25), 0], atol=1e-12)


def test_cases_use_every_fault_and_only_discs_that_show_it():
    cases = discs.cases(1, [discs.SOLID, "ta"], 40)
    assert sorted(case["number"] for case in cases) == list(range(40))
    assert {case["disc"] for case in cases if discs.FAULTS[case["fault"]].with_holes} == {"ta"}
    assert discs.cases(1, ["ta"], 3)[0]["number"] == cases[0]["number"]


def effect(name, value=1.0, low=0.5, high=1.5):
    return {"name": name, "parameters": {"amount": {"value": value, "ci95": [low, high]}}}


def content(*effects, ambiguous=None, verdict=LEFT, where=(), **more):
    places = [{"where": one} for one in where]
    return {"effects": effects, "ambiguous_with": ambiguous or {}, "unexplained": places} | verdict | more


def score(fault, found, control=None, **facts):
    one = discs.scored(discs.FAULTS[fault], facts, found, control or content())
    return one["first"], one["anywhere"], one["wrong"]


def test_scores():
    right, wrong = effect("detector_offset"), effect("scatter")
    assert score("center", content(right)) == (1, 1, 0)
    assert score("center", content(wrong, right)) == (0, 1, 1)
    assert score("center", content(right, ambiguous={"detector_offset": ["centre_of_rotation"]})) == (0.5, 0.5, 0)
    assert score("blur", content(effect("xray_crosstalk"), ambiguous={"xray_crosstalk": ["optical_crosstalk"]}))[0] == 1
    assert score("center", content(setup={"mistakes": {"detector offset": "scan.column_offset_px: 2"}}))[:2] == (1, 1)
    assert score("center", content()) == (0, 0, 0)


def test_effects_of_the_control_count_only_with_another_value():
    control = content(effect("gain_pattern"))
    assert score("gains", content(effect("gain_pattern", 1.4)), control) == (0, 0, 0)
    assert score("gains", content(effect("gain_pattern", 1.6)), control) == (1, 1, 0)


def test_contradicted_declared_effect_is_named_with_another_value_than_in_the_control():
    def declared(value, off):
        return {
            "declared": {"dark_signal": {"level_units": {"value": value, "off": off, "ci95": [value - 1, value + 1]}}}
        }

    control = content(**declared(5.0, False))
    assert score("constant", content(effect("scatter"), **declared(6.5, True)), control) == (0, 1, 1)
    assert score("constant", content(**declared(6.5, False)), control) == (0, 0, 0)
    assert score("constant", content(**declared(5.5, True)), control) == (0, 0, 0)


@pytest.mark.parametrize(
    ("where", "verdict", "found"),
    [
        ("column 44 of 140", LEFT, True),
        ("views 3 to 9, rows 0 to 0, columns 35 to 47", LEFT, True),
        ("columns 50 to 60", LEFT, False),
        ("view 44 of 140", LEFT, False),
        ("column 44 of 140", MATCH, False),
    ],
)
def test_located_columns(where, verdict, found):
    answer = content(verdict=verdict, where=[where])
    assert score("strip", answer, columns=[44, 47])[:2] == (found, found)
    assert score("strip", answer, answer, columns=[44, 47])[:2] == (0, 0)


def test_start_angle_is_right_in_the_set_up_or_the_alignment():
    stated = {"setup": {"mistakes": {"start angle": "scan.start_angle_deg: 170.1"}}}
    assert score("start angle", content(**stated), turn_deg=10.0) == (1, 1, 0)
    assert score("start angle", content(**stated), turn_deg=9.0) == (0, 0, 0)
    turned = {"alignment": {"turn_deg": {"value": 1.1}}}
    assert score("start angle", content(effect("scatter"), **turned), turn_deg=1.0) == (0, 1, 1)


def test_feature_error_is_the_median_over_quantities():
    recorded = np.array([[1.0, 2.0, 4.0, -1.0], [1.0, 2.0, 4.0, 1.0]])
    assert error_of(recorded, np.array([[1.1, 2.0, 5.0, 7.0]])) == pytest.approx(0.1)
