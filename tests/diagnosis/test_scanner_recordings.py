"""Recordings of one scanner: inconsistent recordings, and recordings for testing only."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from test_joint import DISCS, SCATTER, prepare_recording

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.scanner.consistency import alone
from virtual_phantom.diagnosis.scanner.scanner import run_scanner_diagnosis
from virtual_phantom.diagnosis.uncertainty.model_error import influences_of_recordings
from virtual_phantom.diagnosis.uncertainty.prediction_error import changes_by_parameter_errors
from virtual_phantom.io.documents import SCANNER, schema_of_kind
from virtual_phantom.io.schema import defaults_of, validate
from virtual_phantom.report.scanner import scanner_page

ACCURACY = defaults_of("diagnosis", "model_accuracy")
EXACT = {"default": 0.0, "numerical": 0.0}


def differences(amounts, seed, accuracy):
    """Consistency tests of discs with these amounts of scatter, each against the others."""
    fitters = {
        name: prepare_recording(name, {"scatter": {"amount": amount, "width_mm": 60.0}}, seed).fitter
        for name, amount in amounts.items()
    }
    together = JointFitter(fitters)
    before, chosen = together.fit(()), together.fit(("scatter",))
    scans = influences_of_recordings(together, chosen, {"scatter": before}, accuracy)
    return {name: one.difference for name, one in alone(together, chosen, scans).items()}


def test_recordings_of_one_scanner_agree():
    """Amount and width differ by noise: the statistic follows chi-square with two degrees of freedom."""
    found = [differences({"large": 0.03, "small": 0.03}, seed, EXACT)["large"] for seed in range(60, 84)]
    assert {one.numbers for one in found} == {2} and not any(one.disagrees for one in found)
    assert stats.kstest([one.chi_square for one in found], stats.chi2(2).cdf).pvalue > 0.01


def test_difference_of_two_recordings_equals_the_loss_of_their_joint_fit():
    fitters = {name: prepare_recording(name, SCATTER, 61).fitter for name in ("large", "small")}
    together = JointFitter(fitters)
    chosen = together.fit(("scatter",))
    found = alone(together, chosen, influences_of_recordings(together, chosen, {}, EXACT))
    lost = chosen.chi_square - sum(one.fit.chi_square for one in found.values())
    for one in found.values():
        assert one.difference.chi_square == pytest.approx(lost, rel=0.25, abs=0.3)


def test_inconsistent_recording_is_named_and_the_others_are_not():
    found = differences({"large": 0.03, "middle": 0.04, "small": 0.03}, 20, ACCURACY)
    assert {name: one.disagrees for name, one in found.items()} == {"large": False, "middle": True, "small": False}
    assert found["middle"].against == ("large", "small")
    assert found["large"].against == ("small",)  # the inconsistent recording does not affect the others


def test_neither_of_two_inconsistent_recordings_is_preferred():
    assert all(
        difference.disagrees for difference in differences({"large": 0.03, "middle": 0.04}, 20, ACCURACY).values()
    )


def test_difference_within_model_errors_is_consistent():
    scatter_amounts = {"large": 0.03, "middle": 0.034}
    exact, inexact = (
        differences(scatter_amounts, 21, accuracy)["middle"] for accuracy in (EXACT, {"default": 0.5, "numerical": 0.0})
    )
    assert exact.disagrees and not inexact.disagrees and inexact.chi_square < 0.5 * exact.chi_square


def test_recordings_for_testing_are_not_used_in_selection_and_fit():
    made = {name: prepare_recording(name, SCATTER) for name in DISCS}
    two = {name: made[name] for name in ("large", "middle")}
    effects = ("scatter", "veiling_glare")
    plain = run_scanner_diagnosis("bench", two, effects, ACCURACY).content
    found = run_scanner_diagnosis("bench", made, effects, ACCURACY, test_recordings=["small"]).content
    validate(found, schema_of_kind(SCANNER), "scanner.json")
    assert [name for name, one in found["recordings"].items() if one["test"]] == ["small"]
    (actual,), (theirs,) = found["effects"], plain["effects"]
    assert actual["name"] == theirs["name"] == "scatter" and actual["evidence"] == theirs["evidence"]
    for key, one in actual["parameters"].items():
        assert one["value"] == theirs["parameters"][key]["value"] and set(one["without"]) == set(two)
        assert one["ci95"] == pytest.approx(theirs["parameters"][key]["ci95"])
    assert found["excess_rms_removed"] == plain["excess_rms_removed"]
    judged = found["excess_rms_removed_in_tests"]
    assert plain["excess_rms_removed_in_tests"] is None and judged["median"] == judged["worst"] > 0.8
    assert found["recordings"]["small"]["own"] == {} and not found["recordings"]["small"]["agreement"]["disagrees"]
    assert "in 2 recordings." in found["sentence"] and "Fit on small (not used for selection): " in found["sentence"]
    assert "(test recording)" in scanner_page(found) and "(test recording)" not in scanner_page(plain)


def test_inconsistent_test_recording_is_reported():
    strong = {"scatter": {"amount": 0.05, "width_mm": 60.0}}
    made = {name: prepare_recording(name, strong if name == "small" else SCATTER) for name in DISCS}
    found = run_scanner_diagnosis("bench", made, ("scatter",), ACCURACY, test_recordings=["small"]).content
    assert found["recordings"]["small"]["agreement"]["disagrees"] and found["verdict"] == "mismatch partly explained"
    assert "Disagreement: small disagrees with large, middle on shared parameters; " in found["sentence"]
    assert "<strong>disagrees</strong>" in scanner_page(found)
    amount = found["recordings"]["small"]["alone"]["scatter"]["amount"]
    assert amount["ci95"][0] < 0.05 < amount["ci95"][1]


def test_priors_do_not_hide_an_inconsistency():
    """A wrong declaration and different recordings are separate findings."""
    stated = {"scatter": {"amount": {"value": 0.001, "sd": 0.005}, "width_mm": {"value": 60.0, "sd": 1.0}}}
    made = {
        name: prepare_recording(name, {"scatter": {"amount": amount, "width_mm": 60.0}}, 20, stated)
        for name, amount in {"large": 0.03, "middle": 0.04}.items()
    }
    together = JointFitter({name: one.fitter for name, one in made.items()})
    chosen = together.fit(())
    found = alone(together, chosen, influences_of_recordings(together, chosen, {}, ACCURACY))
    assert all(one.difference.disagrees for one in found.values())


def test_no_recording_is_named_if_most_disagree():
    amounts = {"large": 0.03, "small": 0.05}
    made = {
        name: prepare_recording(name, {"scatter": {"amount": one, "width_mm": 60.0}}) for name, one in amounts.items()
    }
    found = run_scanner_diagnosis("bench", made, ("scatter",), ACCURACY).content
    assert "Disagreement: large, small disagree with each other on shared parameters." in found["sentence"]


def test_declared_parameters_are_taken_from_the_other_recordings():
    """A held-out recording does not affect declared scanner parameters."""
    stated = {"scatter": {"amount": {"value": 0.02, "sd": 0.01}, "width_mm": {"value": 60.0, "sd": 1.0}}}
    together = JointFitter({name: prepare_recording(name, SCATTER, 9, stated).fitter for name in DISCS})
    both = together.fit(())
    left = together.left_out(["small"], both)["small"]
    others = together.without(["small"]).fit((), both)
    assert left.free == 0 and left.physics["scatter"] == pytest.approx(others.physics["scatter"], rel=1e-3)
    assert left.errors["scatter"] == pytest.approx(others.fits["large"].errors["scatter"], rel=0.01)
    assert np.isfinite(left.chi_square)


def test_parameters_from_other_recordings_have_correlated_errors():
    """Amount and width of scatter are correlated over noise realizations, as the covariance states."""
    together = JointFitter({name: prepare_recording(name, SCATTER).fitter for name in ("large", "small")})
    left = together.left_out(["small"], together.fit(("scatter",)))["small"]
    rows = {key: np.array(row) for key, row in left.directions["scatter"].items()}
    numbers = {unknown.name: unknown for unknown in together.fitters["large"].model.unknowns(("scatter",))}
    for key, row in rows.items():
        error = numbers[key].number_error(left.physics["scatter"][key], left.errors["scatter"][key])
        assert np.linalg.norm(row) == pytest.approx(error, rel=1e-3)
    text = rows["amount"] @ rows["width_mm"] / np.prod([np.linalg.norm(row) for row in rows.values()])
    drawn = [
        prepare_recording("large", SCATTER, seed).fitter.fit(("scatter",)).physics["scatter"] for seed in range(90, 114)
    ]
    found = np.corrcoef([[numbers[key].of(one[key]) for one in drawn] for key in rows])[0, 1]
    assert abs(np.arctanh(found) - np.arctanh(text)) < 3 / np.sqrt(len(drawn) - 3) and text < -0.6


def test_correlated_errors_change_a_recording_less_than_independent_errors():
    """A voltage and a sensor thickness are known much better together than each alone."""
    spectrum = {"spectrum": {"kvp": 100.0, "filtration_mm": 6.0, "sensor_mm": 0.6}}
    together = JointFitter({name: prepare_recording(name, spectrum).fitter for name in ("large", "small")})
    left = together.left_out(["small"], together.fit(("spectrum",)))["small"]
    moved, scatter_amounts = (
        (changes_by_parameter_errors(together.fitters["small"], fit)[0] ** 2).sum()
        for fit in (left, replace(left, directions={}))
    )
    assert 0 < moved < 0.5 * scatter_amounts


def test_one_recording_plus_test_recordings_is_too_few():
    made = {name: prepare_recording(name, SCATTER) for name in ("large", "small")}
    with pytest.raises(InputError, match=r"diagnosis\.scanners\.bench\.recordings: needs two recordings"):
        run_scanner_diagnosis("bench", made, ("scatter",), ACCURACY, test_recordings=["small"])
