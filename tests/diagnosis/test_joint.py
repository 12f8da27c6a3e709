"""Joint fits of several recordings of one scanner: physics is shared, alignment is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated_scans import noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.fitting.priors import declared
from virtual_phantom.diagnosis.projections import observed
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.diagnosis.scanner.scanner import protocols_of, run_scanner_diagnosis
from virtual_phantom.diagnosis.selection.joint_selection import MOST_FOLDS, choose_jointly, recording_folds
from virtual_phantom.diagnosis.uncertainty import model_error
from virtual_phantom.diagnosis.uncertainty.model_error import (
    errors_with_models,
    influences_of_recordings,
    joint_errors_with_models,
)
from virtual_phantom.io.documents import SCANNER, schema_of_kind
from virtual_phantom.io.schema import defaults_of, validate
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.report.scanner import scanner_page

PHOTONS = 2e5
GEOMETRY = circular(
    views=24,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=900.0,
    columns=64,
    rows=1,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
)
SCATTER = {"scatter": {"amount": 0.03, "width_mm": 60.0}}
DISCS = {"large": (160.0, (0.4, -0.3)), "middle": (120.0, (-0.5, 0.2)), "small": (70.0, (0.1, 0.6))}


def prepare_recording(name, physics, seed=1, stated=None):
    diameter, (x, y) = DISCS[name]
    chain = Chain(DiscScene(diameter, "water"), GEOMETRY, PHOTONS)
    state = chain.state(physics, Pose(x_mm=x, y_mm=y))
    lines = noisy_lines(state, 4, np.random.default_rng(np.random.SeedSequence((seed, int(diameter)))))
    taken = observed.Scans(lines.astype(np.float32), None, np.ones(lines.shape[1:], bool))
    return prepare(taken, None, chain, declared=declared(stated or {}, "bench"))


def fitter(name, physics, seed=1):
    return prepare_recording(name, physics, seed).fitter


@pytest.fixture(scope="module")
def fitters():
    return {name: fitter(name, SCATTER) for name in DISCS}


@pytest.fixture(scope="module")
def joint(fitters):
    return JointFitter(fitters).fit(("scatter",))


def test_joint_fit_of_one_recording_equals_its_single_fit(fitters):
    alone = fitters["large"].fit(("scatter",))
    both = JointFitter({"large": fitters["large"]}).fit(("scatter",))
    assert both.chi_square == pytest.approx(alone.chi_square, abs=0.1)
    for key, value in alone.physics["scatter"].items():
        assert both.physics["scatter"][key] == pytest.approx(value, abs=0.1 * alone.errors["scatter"][key])
        assert both.fits["large"].errors["scatter"][key] == pytest.approx(alone.errors["scatter"][key], rel=0.02)


def test_physics_is_shared_and_alignment_is_not(joint):
    for name, fit in joint.fits.items():
        assert fit.physics["scatter"] == joint.physics["scatter"]
        x, y = DISCS[name][1]
        assert fit.nuisance["x_mm"] == pytest.approx(x, abs=0.02) and fit.nuisance["y_mm"] == pytest.approx(y, abs=0.02)


def test_truth_lies_within_the_errors(joint):
    for key, truth in SCATTER["scatter"].items():
        assert abs(joint.physics["scatter"][key] - truth) < 4 * joint.fits["large"].errors["scatter"][key]


def test_joint_errors_are_smaller_than_single_errors(fitters, joint):
    for key in SCATTER["scatter"]:
        alone = [fitter.fit(("scatter",)).errors["scatter"][key] for fitter in fitters.values()]
        assert joint.fits["large"].errors["scatter"][key] < min(alone)


INEXACT = {"default": 0.1, "numerical": 0.5}


def test_model_errors_of_one_recording_equal_those_of_its_single_fit(fitters):
    one = {"large": fitters["large"]}
    without, both = JointFitter(one).fit(()), JointFitter(one).fit(("scatter",))
    shared = joint_errors_with_models(influences_of_recordings(JointFitter(one), both, {"scatter": without}, INEXACT))[
        "large"
    ]
    fit, less = both.fits["large"], without.fits["large"]
    alone = errors_with_models(fitters["large"], fit, {"scatter": less}, INEXACT).physics["scatter"]
    assert shared["scatter"] == pytest.approx(alone)
    assert all(alone[key] > 1.2 * fit.errors["scatter"][key] for key in alone)


def test_more_recordings_do_not_reduce_a_model_error(fitters, joint, monkeypatch):
    """A model that is too weak by a tenth gives an amount that is off by a tenth, for three discs as for one."""
    monkeypatch.setattr(model_error, "shapes", lambda mean: {0: np.ones(mean.shape)})
    monkeypatch.setattr(model_error, "kernel_error", lambda parameter, share: 0.0)
    without = JointFitter(fitters).fit(())
    accuracy = INEXACT | {"numerical": 0.0}
    errors = joint_errors_with_models(
        influences_of_recordings(JointFitter(fitters), joint, {"scatter": without}, accuracy)
    )["large"]["scatter"]
    by_model = np.sqrt(errors["amount"] ** 2 - joint.fits["large"].errors["scatter"]["amount"] ** 2)
    assert by_model == pytest.approx(0.1 * joint.physics["scatter"]["amount"], rel=0.2)


def test_joint_fit_minimizes_the_sum(fitters, joint):
    """No recording's alignment and no shared parameter can be improved."""
    total = sum(fit.chi_square for fit in joint.fits.values())
    assert total == pytest.approx(joint.chi_square)
    for key in SCATTER["scatter"]:
        for side in (-1, 1):
            moved = {**joint.physics["scatter"]}
            moved[key] += side * joint.fits["large"].errors["scatter"][key]
            worse = sum(_at(one, {"scatter": moved}, joint.fits[name]) for name, one in fitters.items())
            assert worse > joint.chi_square


def _at(fitter, physics, given):
    """Chi-square with fitted alignment at fixed physics."""
    return fitter.of(fitter.model.with_fixed(physics)).fit(("scatter",), given).chi_square


def test_unfitted_recording_is_predicted_by_the_physics_of_the_others(fitters, joint):
    together = JointFitter(fitters)
    for name, one in fitters.items():
        plain = one.score(one.fit(()))
        held_out = together.left_out([name], joint)[name]
        assert one.score(held_out) > plain + 10
        assert held_out.free == 0


def test_gain_pattern_belongs_to_one_scan(fitters):
    with pytest.raises(InputError, match="recordings cannot share it"):
        JointFitter(fitters).fit(("gain_pattern",))


def test_no_recording_is_rejected():
    with pytest.raises(InputError, match="there is none"):
        JointFitter({})


LIBRARY = ("scatter", "detector_offset", "electronic_noise", "veiling_glare")


def test_missing_effects_of_the_scanner_are_selected_on_held_out_recordings(fitters):
    found = choose_jointly(JointFitter(fitters), LIBRARY)
    assert found.chosen.effects == ("scatter",)
    assert found.gains["scatter"] > 100 and found.p["scatter"] < 1e-3
    assert all(score["after"] > score["before"] + 10 for score in found.scores.values())
    assert found.left_out["small"].physics["scatter"] != found.chosen.physics["scatter"]


def test_no_effect_is_selected_if_none_is_missing():
    found = choose_jointly(JointFitter({name: fitter(name, {}, seed=5) for name in DISCS}), LIBRARY)
    assert found.chosen.effects == () and found.gains == {}
    assert all(score["after"] == score["before"] for score in found.scores.values())


def test_effect_of_one_scan_is_not_attributed_to_the_scanner():
    """The detector moved in one of three scans; the other two lose log score by this effect."""
    moved = {"detector_offset": {"columns_px": 0.08}}
    fitters = {name: fitter(name, moved if name == "middle" else {}, seed=6) for name in DISCS}
    assert "detector_offset" not in choose_jointly(JointFitter(fitters), LIBRARY).chosen.effects


def test_single_recording_cannot_be_held_out(fitters):
    with pytest.raises(InputError, match="needs two recordings"):
        choose_jointly(JointFitter({"large": fitters["large"]}), LIBRARY)


def test_scanner_diagnosis_writes_a_document_and_a_page():
    made = {name: prepare_recording(name, SCATTER) for name in DISCS}
    found = run_scanner_diagnosis(
        "bench", made, ("scatter", "veiling_glare"), defaults_of("diagnosis", "model_accuracy")
    )
    content = found.content
    validate(content, schema_of_kind(SCANNER), "scanner.json")
    assert content["verdict"] == "mismatch explained", content["sentence"]
    assert [effect["name"] for effect in content["effects"]] == ["scatter"]
    assert content["verdict_lines"][0].startswith("Shared missing physics: scatter (amount 0.0")
    assert content["verdict_lines"][0].endswith("), in 3 recordings.")
    assert content["verdict_lines"][1].startswith("Fit on held-out recordings: ")
    assert content["excess_rms_removed"]["worst"] > 0.8
    amount = content["effects"][0]["parameters"]["amount"]
    assert set(amount["without"]) == set(DISCS) and amount["ci95"][0] < 0.03 < amount["ci95"][1] * 1.1
    written = scanner_page(content)
    for name in DISCS:
        assert f"<strong>{name}</strong>" in written
    assert all(line in written for line in content["verdict_lines"]) and "data:image" in written


def test_scanner_without_missing_physics_is_a_match():
    made = {name: prepare_recording(name, {}, seed=9) for name in DISCS}
    found = run_scanner_diagnosis("bench", made, ("scatter",), defaults_of("diagnosis", "model_accuracy")).content
    assert found["verdict"] == "match"
    assert found["verdict_lines"] == ["Shared missing physics: none; 3 recordings agree with the simulation."]
    validate(found, schema_of_kind(SCANNER), "scanner.json")
    scanner_page(found)


def test_wrong_declarations_on_a_scanner_are_reported():
    """Three discs with the same scatter, declared correctly and declared far too weak."""
    accuracy = defaults_of("diagnosis", "model_accuracy")

    def reported(amount, protocols=None):
        stated = {"scatter": {"amount": {"value": amount, "sd": 0.002}, "width_mm": {"value": 60.0, "sd": 1.0}}}
        made = {name: prepare_recording(name, SCATTER, 9, stated) for name in DISCS}
        content = run_scanner_diagnosis("bench", made, ("veiling_glare",), accuracy, protocols).content
        validate(content, schema_of_kind(SCANNER), "scanner.json")
        return content

    right = reported(0.03)
    assert right["verdict"] == "match" and not right["declared"]["scatter"]["amount"]["off"]
    assert not right["declared_of_protocols"] and "Contradicts" not in right["sentence"]
    wrong = reported(0.015, {"narrow": ["small"]})
    assert set(wrong["declared"]["scatter"]) == {"width_mm"}
    assert {name: set(one["scatter"]) for name, one in wrong["declared_of_protocols"].items()} == {
        "voltage not stated": {"amount"},
        "narrow": {"amount"},
    }
    amount = wrong["declared_of_protocols"]["narrow"]["scatter"]["amount"]
    assert amount["off"] and amount["pull"] > 5 and 0.015 < amount["value"] < 0.032
    assert wrong["verdict"].startswith("mismatch") and not wrong["effects"]
    assert "Contradicts declared physics: scatter of protocol narrow: amount 0.0" in wrong["sentence"]
    assert "protocol narrow" in scanner_page(wrong) and "0.015 ± 0.002" in scanner_page(wrong)


OWN_DRIFTS = {"large": 3e3, "middle": 0.0, "small": -2e3}  # photons per second


@pytest.fixture(scope="module")
def drifting():
    """Discs with one dark signal and a different drift in each; one second per scan."""
    made = {}
    for name, (diameter, (x, y)) in DISCS.items():
        chain = Chain(DiscScene(diameter, "water"), replace(GEOMETRY, view_interval_ms=1e3 / 24), PHOTONS)
        physics = {"dark_signal": {"level_units": 2e3, "drift_units_per_s": OWN_DRIFTS[name]}}
        lines = noisy_lines(chain.state(physics, Pose(x_mm=x, y_mm=y)), 4, np.random.default_rng(int(diameter)))
        taken = observed.Scans(lines.astype(np.float32), None, np.ones(lines.shape[1:], bool))
        made[name] = prepare(taken, None, chain)
    return made


def test_effects_of_each_scan_are_not_shared(drifting):
    """The level is common and each drift is fitted to its own scan, as also in a held-out recording."""
    fitters = {name: one.fitter for name, one in drifting.items()}
    together = JointFitter(fitters)
    both = together.fit(("dark_signal",))
    assert both.free == 1 + 3
    level = both.physics["dark_signal"]["level_units"]
    (error,) = {fit.errors["dark_signal"]["level_units"] for fit in both.fits.values()}
    assert abs(level - 2e3) < 4 * error
    assert both.physics["dark_signal"]["drift_units_per_s"] == 0
    for name, drift in OWN_DRIFTS.items():
        fit, left = both.fits[name], together.left_out([name], both)[name]
        assert fit.physics["dark_signal"]["level_units"] == level
        found, error = (one["dark_signal"]["drift_units_per_s"] for one in (fit.physics, fit.errors))
        assert abs(found - drift) < 4 * error < 500
        # The level is that of the other recordings, with an error other than the drift's.
        assert left.physics["dark_signal"]["drift_units_per_s"] == pytest.approx(drift, abs=300)


def test_scanner_report_lists_effects_of_each_scan(drifting):
    accuracy = defaults_of("diagnosis", "model_accuracy")
    content = run_scanner_diagnosis("bench", drifting, ("dark_signal", "scatter"), accuracy).content
    validate(content, schema_of_kind(SCANNER), "scanner.json")
    (effect,) = content["effects"]
    assert effect["name"] == "dark_signal" and set(effect["parameters"]) == {"level_units"}
    drifts = {name: one["own"]["dark_signal"]["drift_units_per_s"] for name, one in content["recordings"].items()}
    assert drifts["small"] < drifts["middle"] < drifts["large"]
    assert "drift" in scanner_page(content)


AMOUNTS = {"large": 0.03, "small": 0.03, "middle": 0.07, "further": 0.07}  # scatter of two collimations
PROTOCOLS = {"narrow": ["large", "small"], "wide": ["middle", "further"]}


@pytest.fixture(scope="module")
def collimated():
    """Discs with scatter of one width; half of them have another amount."""
    return {
        name: prepare_recording(
            name if name in DISCS else "large", {"scatter": {"amount": amount, "width_mm": 60.0}}, seed=7
        )
        for name, amount in AMOUNTS.items()
    }


def test_recordings_of_one_protocol_share_protocol_parameters(collimated):
    fitters = {name: one.fitter for name, one in collimated.items()}
    similar = JointFitter(fitters).fit(("scatter",))
    together = JointFitter(fitters, protocols_of(collimated, PROTOCOLS))
    fit = together.fit(("scatter",))
    assert (similar.free, fit.free) == (2, 3)
    assert fit.chi_square < similar.chi_square - 100
    assert len({one.errors["scatter"]["width_mm"] for one in fit.fits.values()}) == 1
    for name, amount in AMOUNTS.items():
        found, error = (one["scatter"]["amount"] for one in (fit.fits[name].physics, fit.fits[name].errors))
        assert abs(found - amount) < 4 * error < 0.1 * amount
        assert fit.fits[name].physics["scatter"]["width_mm"] == fit.physics["scatter"]["width_mm"]
    assert fit.fits["large"].physics["scatter"] == fit.fits["small"].physics["scatter"]


def test_held_out_recording_takes_its_protocol_parameters_from_others_or_itself(collimated):
    fitters = {name: one.fitter for name, one in collimated.items()}
    together = JointFitter(fitters, protocols_of(collimated, PROTOCOLS))
    fit = together.fit(("scatter",))
    left = together.left_out(["further"], fit)["further"]
    assert left.free == 0 and left.elsewhere == {"scatter": ["amount", "width_mm"]}
    assert left.physics["scatter"]["amount"] == pytest.approx(0.07, rel=0.05)
    single = together.without(["middle"])
    left = single.left_out(["further"], single.fit(("scatter",), fit))["further"]
    assert left.free == 1 and left.elsewhere == {"scatter": ["width_mm"]}
    assert left.physics["scatter"]["amount"] == pytest.approx(0.07, rel=0.05)


def test_recordings_of_one_object_are_held_out_together(collimated):
    names = list("abcd")
    assert recording_folds(names) == [["a"], ["b"], ["c"], ["d"]]
    assert recording_folds(names, dict.fromkeys(names, "disc")) == [["a"], ["b"], ["c"], ["d"]]
    assert recording_folds(names, {"a": "disc", "b": "body", "c": "disc", "d": "body"}) == [["a", "c"], ["b", "d"]]
    many = recording_folds([str(number) for number in range(30)])
    assert len(many) == MOST_FOLDS and sorted(len(one) for one in many) == [2] * 6 + [3] * 6
    objects = {name: "same" if name in ("large", "small") else name for name in AMOUNTS}
    together = JointFitter({name: one.fitter for name, one in collimated.items()})
    found = choose_jointly(together, ("scatter",), objects=objects)
    alone = together.without(["large", "small"]).fit(("scatter",), found.chosen)
    assert found.left_out["small"].physics["scatter"] == pytest.approx(alone.physics["scatter"], rel=0.01)
    assert found.left_out["small"].physics["scatter"] == found.left_out["large"].physics["scatter"]


def test_errors_are_listed_with_their_parameters(collimated):
    """A parameter of a protocol is listed among those of the scanner."""
    fitters = {name: one.fitter for name, one in collimated.items()}
    together = JointFitter(fitters, protocols_of(collimated, PROTOCOLS))
    fit, none = together.fit(("scatter",)), dict.fromkeys(("default", "numerical"), 0.0)
    found = joint_errors_with_models(influences_of_recordings(together, fit, {}, none))
    for name, one in fit.fits.items():
        assert found[name]["scatter"] == pytest.approx(one.errors["scatter"], rel=0.05)


def test_scanner_report_lists_parameters_of_each_protocol(collimated):
    accuracy = defaults_of("diagnosis", "model_accuracy")
    content = run_scanner_diagnosis("bench", collimated, ("scatter", "veiling_glare"), accuracy, PROTOCOLS).content
    validate(content, schema_of_kind(SCANNER), "scanner.json")
    (effect,) = content["effects"]
    assert effect["name"] == "scatter" and set(effect["parameters"]) == {"width_mm"}
    amounts = {name: one["amount"]["value"] for name, one in effect["protocols"].items()}
    assert amounts == {"narrow": pytest.approx(0.03, rel=0.05), "wide": pytest.approx(0.07, rel=0.05)}
    assert set(effect["protocols"]["wide"]["amount"]["without"]) == set(PROTOCOLS["wide"])
    assert content["recordings"]["further"]["protocol"] == "wide" and not content["recordings"]["further"]["own"]
    text = scanner_page(content)
    assert "<td>narrow</td>" in text and "<td>all recordings</td>" in text


def test_recordings_with_other_tube_voltages_are_of_other_protocols():
    def stating(*voltages):
        models = [SimpleNamespace(fitter=SimpleNamespace(model=SimpleNamespace(tube_kvp=kvp))) for kvp in voltages]
        return {f"scan{number}": one for number, one in enumerate(models)}

    assert set(protocols_of(stating(80.0, 80.0)).values()) == {""}
    assert list(protocols_of(stating(80.0, 120.0, None)).values()) == ["80 kV", "120 kV", "voltage not stated"]
    assert protocols_of(stating(80.0, 80.0), {"wide": ["scan1"]}) == {"scan0": "80 kV", "scan1": "wide"}
