"""Physics of one recording applied to another, objects given as masks, and the selection of effects."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy import ndimage
from simulated_scans import noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.config import complete
from virtual_phantom.diagnosis.fitting.fit import Fit
from virtual_phantom.diagnosis.fitting.trial import Trial, trial
from virtual_phantom.diagnosis.noise.gain_pattern import estimate
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.run import apply_known_physics
from virtual_phantom.diagnosis.scanned_object import mask_scene
from virtual_phantom.diagnosis.selection import forward_selection
from virtual_phantom.diagnosis.selection.screening import Screened, best_few
from virtual_phantom.diagnosis.selection.transfer import (
    Physics,
    fit_with_fixed_physics,
    with_declared,
    with_physics_source,
)
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.diagnosis.uncertainty.intervals import half_width
from virtual_phantom.diagnosis.uncertainty.prediction_error import changes_by_parameter_errors
from virtual_phantom.diagnosis.verdict.verdict import diagnose, excess_rms_removed
from virtual_phantom.diagnosis.verdict_text import recording_lines
from virtual_phantom.io import volumes
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.importers.htc2022 import with_partial_pixels
from virtual_phantom.recordings.projections import Projections

PHOTONS, DENSITY = 1e5, 1.03
# A fitter; the selection reads its declared physics, and number and weight of data.
BARE = SimpleNamespace(
    model=SimpleNamespace(with_declared_effects=tuple),
    weights=(np.ones(2),),
    held_weights=(np.ones(2),),
    finished=lambda fit: fit,
    comparable=lambda fit, without: fit,
    significant_excess=lambda score: 0.0,
)
GEOMETRY = circular(
    views=60,
    source_to_isocentre_mm=410.0,
    source_to_detector_mm=553.0,
    columns=100,
    rows=1,
    column_pitch_mm=1.1,
    row_pitch_mm=1.1,
)
TRUTH = {
    "spectrum": {"kvp": 90.0, "filtration_mm": 3.0, "sensor_mm": 0.6},
    "scatter": {"amount": 0.1, "width_mm": 40.0},
}


def mask_of(path, inside, size=160, spacing=0.5):
    axis = (np.arange(size) - (size - 1) / 2) * spacing
    share = ndimage.uniform_filter(inside(axis[None], axis[:, None]).astype(np.float32), 2)
    volume = volumes.Volume(share[None], Grid((1, size, size), (1.0, spacing, spacing)))
    volumes.write_nifti(volume, path)
    return path


def found_on(disc, scale, effects=TRUTH, **extra):
    """A diagnosis.json of another recording."""
    parameters = {
        name: {key: {"value": value, "ci95": [0.99 * value, 1.01 * value], "unit": "1"} for key, value in one.items()}
        for name, one in effects.items()
    }
    content = {
        "recording": disc,
        "effects": [
            {"name": name, "physics": "", "parameters": values, "evidence": {"held_out_gain": 9.0, "p": 0.0}}
            for name, values in parameters.items()
        ],
        "alignment": {"scale": {"value": scale, "ci95": [scale - 0.001, scale + 0.001]}},
        "verdict": "mismatch explained",
        "sentence": "",
        "excess_removed": 1.0,
        "held_out_data": "",
        **{key: {} for key in ("ambiguous_with", "ruled_out", "fit", "held_out")},
        **{key: [] for key in ("locations", "unexplained", "next_measurement")},
    }
    return content | extra


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A prepared disc with a notch and another density than listed, and the path of its mask."""
    folder = tmp_path_factory.mktemp("other")
    mask = mask_of(folder / "object.nii.gz", lambda x, y: (np.hypot(x, y) < 35) & ~((x > 5) & (np.abs(y) < 6)))
    scene = mask_scene(mask, "pmma")
    dense = mask_scene(mask, "pmma")
    dense._voxels._amounts = dense._voxels._amounts * DENSITY
    state = Chain(dense, GEOMETRY, PHOTONS).state(TRUTH)
    random, air = np.random.default_rng(3), state.measured_air.mean(axis=0) * PHOTONS
    taken = observed.scans([Projections(state.counts(random), air, 0 * air) for _ in range(4)])
    prepared_data = prepared.prepare(
        taken, None, Chain(PosedScene(scene), GEOMETRY, PHOTONS), tube_kvp=90.0, known={"scale": 1.0}
    )
    return prepared_data, mask, folder


def test_physics_of_another_recording_removes_the_excess(other):
    prepared_data, _, folder = other
    (folder / "diagnosis.json").write_text(json.dumps(found_on("disc", DENSITY)))
    physics = Physics.read(folder / "diagnosis.json")
    baseline = trial(prepared_data.fitter, ())
    choice = fit_with_fixed_physics(prepared_data.fitter, baseline, physics, same_material=True)
    assert choice.chosen.fit.physics == TRUTH and choice.chosen.fit.free == 0
    assert choice.chosen.fit.nuisance["scale"] == pytest.approx(DENSITY, abs=0.003)
    assert all(gain > 100 for gain in choice.gains.values())
    content = with_physics_source(diagnose("notch", prepared_data, choice).content, physics)
    json.dumps(content, allow_nan=False)
    assert content["excess_removed"] > 0.9 and content["excess_rms_removed"] > 0.8
    assert any("transferred from disc" in str(line) for line in recording_lines(content))
    for effect in content["effects"]:
        assert effect["taken_from"] == "disc" and effect["evidence"]["p"] is None
        low, high = effect["parameters"][next(iter(effect["parameters"]))]["ci95"]
        assert high > low


def test_accuracy_of_discretization_is_that_of_the_configuration(other):
    prepared_data, _, folder = other
    (folder / "numerical.json").write_text(json.dumps(found_on("disc", DENSITY)))
    found = apply_known_physics("notch", prepared_data, Physics.read(folder / "numerical.json"), True, numerical=0.34)
    assert found.choice.numerical == 0.34


def test_noise_and_model_errors_are_stated_separately(other):
    prepared_data, _, folder = other
    content = found_on("disc", DENSITY)
    for effect in content["effects"]:
        for one in effect["parameters"].values():
            one["ci95_noise"] = [0.999 * one["value"], 1.001 * one["value"]]
    (folder / "apart.json").write_text(json.dumps(content))
    choice = fit_with_fixed_physics(
        prepared_data.fitter, trial(prepared_data.fitter, ()), Physics.read(folder / "apart.json"), same_material=True
    )
    for effect in diagnose("notch", prepared_data, choice).content["effects"]:
        for one in effect["parameters"].values():
            whole, noise, half = (one[key][1] - one["value"] for key in ("ci95", "ci95_noise", "ci50"))
            assert (whole, noise) == pytest.approx((0.01 * one["value"], 0.001 * one["value"]), rel=1e-3)
            assert half == pytest.approx(half_width(0.5, noise / 1.959964, whole / 1.959964), rel=1e-3)


def test_intervals_truncated_at_a_bound_keep_their_length(tmp_path):
    spot = {"width_mm": (0.0, [0.0, 3.9]), "length_mm": (3.5, [1.5, 4.0])}
    content = found_on("disc", 1.0)
    content["effects"] = [
        {
            "name": "focal_spot",
            "physics": "",
            "evidence": {"held_out_gain": 9.0, "p": 0.0},
            "parameters": {key: {"value": value, "ci95": ends, "unit": "mm"} for key, (value, ends) in spot.items()},
        }
    ]
    (tmp_path / "d.json").write_text(json.dumps(content))
    errors = Physics.read(tmp_path / "d.json").errors["focal_spot"]
    assert errors == pytest.approx({"width_mm": 3.9 / 1.959964, "length_mm": 2.0 / 1.959964})


def test_wrong_density_removes_less(other):
    prepared_data, _, folder = other
    baseline = trial(prepared_data.fitter, ())
    (folder / "light.json").write_text(json.dumps(found_on("disc", 0.95)))
    wrong = fit_with_fixed_physics(
        prepared_data.fitter, baseline, Physics.read(folder / "light.json"), same_material=True
    )
    right = fit_with_fixed_physics(
        prepared_data.fitter, baseline, Physics.read(folder / "light.json"), same_material=False
    )
    assert wrong.chosen.score < right.chosen.score - 1000


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "is no diagnosis"),
        ("{", "is no diagnosis"),
        (json.dumps({"recording": "disc", "effects": []}), "is no diagnosis"),
        (json.dumps(found_on("disc", 1.0, {})), "found no effect to test on another recording"),
        (json.dumps(found_on("disc", 1.0, {"scatter": {"amount": 7.0}})), "is out of the plausible range"),
    ],
)
def test_other_files_are_rejected_in_one_line(tmp_path, content, message):
    if content is not None:
        (tmp_path / "d.json").write_text(content)
    with pytest.raises(InputError, match=message) as error:
        Physics.read(tmp_path / "d.json")
    assert "\n" not in str(error.value)


def test_pixel_patterns_stay_with_their_scan(tmp_path):
    pattern = {"gain_pattern": {"rms": 0.004, "detector": 1.0}}
    (tmp_path / "d.json").write_text(json.dumps(found_on("disc", 1.0, TRUTH | pattern)))
    physics = Physics.read(tmp_path / "d.json")
    assert set(physics.effects) == set(TRUTH) and physics.not_taken == ("gain_pattern",)
    scatter = {"scatter": TRUTH["scatter"]}
    (tmp_path / "d.json").write_text(json.dumps(found_on("disc", 1.0, scatter)))
    assert Physics.read(tmp_path / "d.json").scale is None  # without a spectrum it also contains the energy


def test_invalid_masks_are_rejected(tmp_path):
    good = volumes.read_nifti(mask_of(tmp_path / "good.nii.gz", lambda x, y: np.hypot(x, y) < 20))
    for name, array, message in (
        ("empty", 0 * good.array, "is empty"),
        ("hu", 1000 * good.array, "holds values outside 0 to 1"),
        ("nan", np.where(good.array > 0.5, np.nan, 0).astype(np.float32), "holds values outside 0 to 1"),
    ):
        volumes.write_nifti(replace(good, array=array), tmp_path / f"{name}.nii.gz")
        with pytest.raises(InputError, match=message):
            mask_scene(tmp_path / f"{name}.nii.gz", "pmma")
    with pytest.raises(InputError, match="no such file"):
        mask_scene(tmp_path / "none.nii.gz", "pmma")


def test_threshold_gets_an_edge_of_one_pixel_at_the_outline():
    axis = np.arange(200) - 99.5
    radius = 60.3
    inside = np.hypot(axis[:, None], axis) < radius
    share = with_partial_pixels(inside)
    assert share.sum() == pytest.approx(np.pi * radius**2, rel=2e-3)
    assert share.min() == 0 and share.max() == 1 and ((share > 0) & (share < 1)).sum() < 3 * 2 * np.pi * radius
    distance = radius - np.hypot(axis[:, None], axis)
    exact = np.clip(0.5 + distance, 0, 1)
    assert np.abs(share - exact).mean() < 0.6 * np.abs(inside - exact).mean()


def test_excess_is_the_squared_rms_beyond_noise():
    assert excess_rms_removed(before=5.0, after=np.sqrt(3**2 + 2**2), floor=3.0) == pytest.approx(0.5)
    assert excess_rms_removed(before=5.0, after=2.9, floor=3.0) == 1.0
    assert excess_rms_removed(before=3.0, after=3.0, floor=3.0) is None


def test_best_few_and_all_near_the_best_are_fitted():
    gains = {f"e{i}": Screened(0.0, gain) for i, gain in enumerate([10, 9, 8, 7, 6, 5.5, 5.0, 4.9, 1, 0.5])}
    assert best_few(gains) == [f"e{i}" for i in range(7)]
    assert best_few({"one": Screened(1.0, 0.0)}) == ["one"]


def test_effects_with_less_than_a_tenth_of_the_expected_gain_are_not_fitted():
    gains = {"best": Screened(0.0, 100.0), "some": Screened(0.0, 11.0), "little": Screened(0.0, 9.0)}
    assert best_few(gains) == ["best", "some"]
    assert best_few(gains, needed=500.0) == ["best"]
    assert best_few(gains, needed=2000.0) == []


def test_every_nth_view_keeps_the_noise_of_all(other):
    prepared_data, mask, _ = other
    chain = Chain(PosedScene(mask_scene(mask, "pmma")), GEOMETRY, PHOTONS)
    random = np.random.default_rng(5)
    state = chain.state({})
    air = state.measured_air.mean(axis=0) * PHOTONS
    taken = observed.scans([Projections(state.counts(random), air, 0 * air)])
    whole = prepared.prepare(taken, None, chain)
    thinned = prepared.prepare(taken, None, chain, step=3)
    assert thinned.photons == whole.photons and thinned.step == 3
    assert thinned.data.mean.shape == (20, 1, 100)
    np.testing.assert_array_equal(thinned.variance, whole.variance[::3])
    chi_square = -2 * trial(thinned.fitter, ()).score / (thinned.fitter.held_weights[0] > 0).sum()
    assert chi_square == pytest.approx(1, abs=0.25)


@pytest.fixture
def scored(monkeypatch):
    """Selection with made-up scores: heel is best alone, but scatter explains more together with motion."""
    monkeypatch.setattr(forward_selection, "MOST_EFFECTS", 2)
    scores = {
        (): 0,
        ("heel",): 500,
        ("scatter",): 400,
        ("motion",): 100,
        ("heel", "motion"): 700,
        ("motion", "scatter"): 900,
    }
    scores |= {("heel", "scatter"): 505, ("heel", "motion", "scatter"): 901}

    def made(effects):
        fit = Fit(tuple(effects), {}, {}, {}, {}, -2.0 * scores[tuple(sorted(effects))], (), len(effects))
        return Trial(fit, scores[tuple(sorted(effects))], 0.0)

    monkeypatch.setattr(forward_selection, "trials", lambda fitter, tasks, **_: [made(task[0]) for task in tasks])

    def filtered(fitter, fit, names, fitted_too=False, **more):
        made_up = Screened(1.0, 0.0) if fitted_too else None  # model errors may explain all of it
        gains = {name: 2 * (made((*fit.effects, name)).score - made(fit.effects).score) for name in names}
        return {name: Screened(0.0, gain, with_model_error=made_up) for name, gain in gains.items()}

    monkeypatch.setattr(forward_selection, "screened", filtered)
    monkeypatch.setattr(
        forward_selection, "exchanged", lambda *_: {}
    )  # scores without data that effects could change equally
    return made


SINGLES = ("heel", "scatter", "motion")


def test_effect_that_is_worse_with_the_others_is_replaced(scored):
    singles = SINGLES
    choice = forward_selection.choose(BARE, scored(()), singles)
    assert set(choice.chosen.fit.effects) == {"motion", "scatter"}
    assert choice.gains == {"motion": 500, "scatter": 800}
    assert choice.alternatives == {"motion": {"heel": 395}, "scatter": {"heel": 200}}
    assert choice.ruled_out == {"heel": 200} and choice.ambiguous_with("scatter") == []


def test_possible_additional_effect_is_undecided_and_not_ruled_out(scored):
    """Instead of heel, motion loses 400; with heel, it gains 200, which model errors of heel may cause."""
    singles = SINGLES[::2]
    choice = forward_selection.choose(BARE, scored(()), singles, accuracy={"default": 0.7})
    assert choice.chosen.fit.effects == ("heel",)
    assert choice.undecided == {"motion": 200} and choice.ruled_out == {}


def test_default_model_accuracy_is_that_of_the_configuration(scored):
    singles = SINGLES[::2]
    root = Path(__file__).resolve().parents[2]
    default = yaml.safe_load((root / "config/paper_groups.yaml").read_text())
    stated = complete(default)["diagnosis"]["model_accuracy"]
    assert set(stated) > {"default", "numerical"} and stated["default"] > 0
    prepared_data, taken = (
        forward_selection.choose(BARE, scored(()), singles, **one) for one in ({"accuracy": stated}, {})
    )
    assert (prepared_data.undecided, prepared_data.ruled_out, prepared_data.tolerance) == (
        taken.undecided,
        taken.ruled_out,
        taken.tolerance,
    )
    assert taken.tolerance > forward_selection.choose(BARE, scored(()), singles, accuracy={"default": 0.0}).tolerance


def test_effect_without_template_is_fitted(scored, monkeypatch):
    """A matched filter cannot exclude an effect without change at its typical strength."""
    plain = forward_selection.screened

    def filtered(fitter, fit, names, **more):
        blind = {"motion": Screened(1.0, 0.0, blind=True)} if "motion" in names else {}
        return plain(fitter, fit, names, **more) | blind

    monkeypatch.setattr(forward_selection, "screened", filtered)
    choice = forward_selection.choose(BARE, scored(()), SINGLES)
    assert set(choice.chosen.fit.effects) == {"motion", "scatter"}


def test_p_values_follow_chi_square():
    """A likelihood ratio of 3.84 has p = 0.05 for one parameter (tables). A gain pattern has its own."""
    without = Fit((), {}, {}, {}, {}, 100.0, (), 0)
    one = Fit(("scatter",), {}, {}, {}, {}, 100 - 3.841459, (), 1)
    assert forward_selection.effect_p_value(one, without, "scatter") == pytest.approx(0.05, abs=1e-6)
    random = np.random.default_rng(1)
    residual = random.standard_normal((40, 4, 60)) + 0.05 * random.standard_normal((4, 60))
    pattern = estimate(residual, np.ones(residual.shape))
    assert 1e-6 < pattern.p < 0.5
    rings = Fit(("gain_pattern",), {}, {}, {}, {}, 0.0, (), 1, pattern=pattern)
    assert forward_selection.effect_p_value(rings, without, "gain_pattern") == pattern.p


def test_gain_within_model_error_is_no_evidence(scored):
    """heel gains 500 and motion another 200: two fifths, the square of 0.63."""
    singles = SINGLES[::2]
    for accuracy, named in ((0.6, {"heel", "motion"}), (0.7, {"heel"})):
        choice = forward_selection.choose(BARE, scored(()), singles, accuracy={"default": accuracy})
        assert set(choice.chosen.fit.effects) == named


def test_small_gain_that_model_errors_cannot_explain_is_named(scored, monkeypatch):
    """motion alone; heel moves no rays and is not considered."""
    plain = forward_selection.screened

    def filtered(fitter, fit, names, fitted_too=False, **more):
        return plain(fitter, fit, names, **more)

    monkeypatch.setattr(forward_selection, "screened", filtered)
    choice = forward_selection.choose(BARE, scored(()), SINGLES[::2], accuracy={"default": 0.7})
    assert choice.chosen.fit.effects == ("heel", "motion") and choice.unconfounded == {"motion"}
    monkeypatch.setattr(forward_selection, "MOST_DATA", -1)
    assert not forward_selection.choose(BARE, scored(()), SINGLES[::2], accuracy={"default": 0.7}).unconfounded


@pytest.mark.parametrize(
    ("accuracy", "named"),
    [({"default": 0.0, "heel": 0.7}, {"heel"}), ({"default": 0.7, "heel": 0.0}, {"heel", "motion"})],
)
def test_effect_has_its_declared_accuracy(scored, accuracy, named):
    singles = SINGLES[::2]
    assert set(forward_selection.choose(BARE, scored(()), singles, accuracy=accuracy).chosen.fit.effects) == named


@pytest.mark.parametrize(("corrected", "named"), [(990.0, ("heel",)), (1010.0, ())])
def test_gain_within_discretization_error_is_no_evidence(scored, corrected, named):
    """heel alone gains 500 in log score, 1000 in chi-square."""
    baseline = scored(())
    baseline = replace(baseline, fit=replace(baseline.fit, corrected=corrected))
    choice = forward_selection.choose(BARE, baseline, ("heel",), accuracy={"default": 0.0, "numerical": 1.0})
    assert choice.chosen.fit.effects == named


def test_effect_has_its_full_value_after_a_redundant_one_is_removed(scored, monkeypatch):
    """heel is added first, then motion, then scatter. With both, heel gains 1 and is removed; 900 are explained."""
    monkeypatch.setattr(forward_selection, "MOST_EFFECTS", 4)
    singles = SINGLES
    choice = forward_selection.choose(BARE, scored(()), singles, accuracy={"default": 0.1})
    assert set(choice.chosen.fit.effects) == {"motion", "scatter"}
    assert choice.tolerance == pytest.approx(0.1**2 * 900)


def test_transferred_physics_can_be_declared(tmp_path):
    """The declaration has its errors. Declarations of the other recording are included; the user's own come first."""
    stated = {"stated": 20.0, "sd": 5.0, "value": 24.0, "ci95": [20.08, 27.92], "unit": "ms", "pull": 1.0, "off": False}
    glow = {"time_constant_ms": stated, "share": stated | {"value": 0.03, "ci95": [0.0104, 0.0496], "unit": "1"}}
    (tmp_path / "d.json").write_text(json.dumps(found_on("disc", 1.0, declared={"afterglow": glow})))
    own = {"scatter": {"amount": {"value": 0.01, "sd": 0.001}}}
    model = from_mapping(FitSettings, {"folder": "here", "settings": {"samples": 1, "baseline": own}})
    settings = with_declared(model, tmp_path / "d.json").settings
    assert settings.samples == 1 and settings.baseline["scatter"] == own["scatter"]
    assert set(settings.baseline) == set(TRUTH) | {"afterglow"}
    assert settings.baseline["afterglow"]["time_constant_ms"] == pytest.approx({"value": 24.0, "sd": 2.0}, rel=1e-4)
    errors = Physics.read(tmp_path / "d.json").errors
    for name in set(TRUTH) - {"scatter"}:
        for key, value in TRUTH[name].items():
            assert settings.baseline[name][key] == pytest.approx({"value": value, "sd": errors[name][key]})
    assert model.settings.baseline == own and with_declared(model, None) == model


NOTHING_STATED = from_mapping(FitSettings, {"settings": {}})
DRIFTS = {"dark_signal": {"level_units": 2e3, "drift_units_per_s": 3e3}}


def test_transferred_effect_of_each_scan_sets_its_range(tmp_path):
    (tmp_path / "d.json").write_text(json.dumps(found_on("disc", 1.0, DRIFTS)))
    stated = with_declared(NOTHING_STATED, tmp_path / "d.json").settings.baseline["dark_signal"]
    errors = Physics.read(tmp_path / "d.json").errors["dark_signal"]
    assert stated["level_units"] == pytest.approx({"value": 2e3, "sd": errors["level_units"]})
    assert stated["drift_units_per_s"] == pytest.approx({"value": 0.0, "sd": 3e3 + errors["drift_units_per_s"]})


def test_effect_of_each_scan_is_fitted_with_transferred_physics(tmp_path):
    """The level of the other scan; the drift of this scan, which has the opposite sign."""
    chain = Chain(DiscScene(70.0, "pmma"), replace(GEOMETRY, view_interval_ms=1e3 / GEOMETRY.views), PHOTONS)
    here = {"dark_signal": {"level_units": 2e3, "drift_units_per_s": -1e3}}
    lines = noisy_lines(chain.state(here), 4, np.random.default_rng(7)).astype(np.float32)
    prepared_data = prepared.prepare(observed.Scans(lines, None, np.ones(lines.shape[1:], bool)), None, chain)
    (tmp_path / "d.json").write_text(json.dumps(found_on("disc", 1.0, DRIFTS)))
    physics = Physics.read(tmp_path / "d.json")
    units = {parameter.name: parameter.unit for parameter in prepared_data.fitter.model.parameters("dark_signal")}
    choice = fit_with_fixed_physics(
        prepared_data.fitter, trial(prepared_data.fitter, ()), replace(physics, units={"dark_signal": units}), True
    )
    found, errors = (one["dark_signal"] for one in (choice.chosen.fit.physics, choice.chosen.fit.errors))
    assert found["level_units"] == 2e3 and errors["level_units"] == physics.errors["dark_signal"]["level_units"]
    assert abs(found["drift_units_per_s"] + 1e3) < 4 * errors["drift_units_per_s"] < 500
    # The level was fitted elsewhere and has the error from there. All others have errors from the data.
    fit, worse = choice.chosen.fit, {"dark_signal": errors | {"level_units": 10 * errors["level_units"]}}
    known, unsure = (
        changes_by_parameter_errors(prepared_data.fitter, one) for one in (fit, replace(fit, errors=worse))
    )
    assert unsure[0][0] == pytest.approx(10 * known[0][0], rel=1e-6) and np.abs(known[0][0]).max() > 0
    np.testing.assert_allclose(unsure[0][1:], known[0][1:])


def test_diagnosis_without_effects_declares_none(tmp_path):
    (tmp_path / "d.json").write_text(json.dumps(found_on("disc", 1.0, {})))
    with pytest.raises(InputError, match="d.json: has no effect of the scanner; remove baseline_from"):
        with_declared(NOTHING_STATED, tmp_path / "d.json")
