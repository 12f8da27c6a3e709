"""Ranking of further recordings by their information on effects that look alike."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.optimize import lsq_linear
from simulated_scans import SCAN, noisy_lines

from virtual_phantom.base.data import SCHEMAS
from virtual_phantom.diagnosis.planning.candidates import candidate_measurements
from virtual_phantom.diagnosis.planning.information import (
    MeasurementInformation,
    correlation,
    expected,
    expected_log_score_loss,
    information_gain,
    normal_equations,
    profiled_information,
)
from virtual_phantom.diagnosis.planning.measurement import FurtherScan
from virtual_phantom.diagnosis.planning.ranking import (
    Ambiguity,
    RankedMeasurement,
    conditions_of,
    effect_similarity,
    found_in,
    order,
    possible,
    rank,
    refit,
    refit_jointly,
    settles,
)
from virtual_phantom.diagnosis.planning.tables import (
    best_measurement_text,
    ranking_table,
    recording_template,
    similarity_table,
)
from virtual_phantom.diagnosis.projections import observed
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.figures.next_measurement import draw_ranking
from virtual_phantom.io.schema import read_schema, validate
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.scan import scan_geometry

PHOTONS = 1e5
GEOMETRY = scan_geometry(SCAN, "the scan")
SECTION = {"disc": {"diameter_mm": 160, "material": "water"}}
CONTENT = {"name": "disc", "kind": "projections", "scan": SCAN, "nominal": {"photons": 100.0}, "repeats": ["a.h5"]}
OFFSET, AXIS = "detector_offset", "centre_of_rotation"


def prepare_recording(physics, seed=1):
    chain = Chain(DiscScene(160.0, "water"), GEOMETRY, PHOTONS, samples=2)
    lines = noisy_lines(chain.state(physics, Pose(x_mm=0.4, y_mm=-0.3)), 4, np.random.default_rng(seed))
    return prepare(observed.Scans(lines.astype(np.float32), None, np.ones(lines.shape[1:], bool)), None, chain)


def measurement(name, seed, shared=2, own=3, data=40, prior_precision=0.0):
    random = np.random.default_rng(seed)
    keys = (*(("effect", str(i)) for i in range(shared)), *((name, "alignment", str(i)) for i in range(own)))
    count = shared + own
    margins = np.tile([-np.inf, np.inf], (count, 1))
    changes, predicted = random.normal(size=(data, count)), random.normal(size=data)
    return MeasurementInformation(keys, changes, predicted, np.full(count, prior_precision), margins, np.ones(count))


GROUP = [("effect", "0"), ("effect", "1")]


def test_profiled_information_is_the_inverse_of_the_covariance():
    sums = normal_equations([measurement("a", 1, prior_precision=0.3), measurement("b", 2, prior_precision=0.3)])
    assert len(sums.keys) == 8
    inside = [sums.keys.index(key) for key in GROUP]
    covariance = np.linalg.inv(sums.information)[np.ix_(inside, inside)]
    np.testing.assert_allclose(profiled_information(sums, GROUP), np.linalg.inv(covariance), rtol=1e-8)


def test_prior_of_a_shared_parameter_counts_once():
    one, two = measurement("a", 1, prior_precision=5.0), measurement("b", 2, prior_precision=5.0)
    bare = normal_equations([measurement("a", 1), measurement("b", 2)])
    np.testing.assert_allclose(np.diag(normal_equations([one, two]).information - bare.information), 5.0)


def test_repeated_measurement_gains_half_log_two_per_parameter():
    """All parameters are shared: the information doubles."""
    one = measurement("a", 3, own=0)
    assert information_gain(normal_equations([one]), normal_equations([one, one]), GROUP) == pytest.approx(
        2 * 0.5 * np.log(2)
    )


def test_difference_that_parameters_do_not_absorb_separates_explanations():
    one, difference = measurement("a", 4), np.random.default_rng(5).normal(size=40)
    left = np.linalg.lstsq(one.changes, difference, rcond=None)[1][0]
    assert expected_log_score_loss(normal_equations([one], [difference])) == pytest.approx(left / 2)
    margins = np.tile([-0.05, 0.05], (5, 1))
    held_out = MeasurementInformation(one.keys, one.changes, one.predicted, one.prior_precision, margins, one.steps)
    bounded = lsq_linear(one.changes, difference, (-0.05, 0.05), method="bvls")
    assert (
        expected_log_score_loss(normal_equations([held_out], [difference])) == pytest.approx(bounded.cost)
        and bounded.cost > left / 2 * 1.01
    )


def test_parameters_with_equal_effect_have_a_correlation_of_one():
    one = measurement("a", 6)
    changes = one.changes.copy()
    changes[:, 1] = -3 * changes[:, 0] + changes[:, 2]  # the alignment absorbs the rest
    similar = MeasurementInformation(one.keys, changes, one.predicted, one.prior_precision, one.margins, one.steps)
    assert correlation(normal_equations([similar]), GROUP[:1], GROUP[1:]) == pytest.approx(1)
    assert correlation(normal_equations([one]), GROUP[:1], GROUP[1:]) < 0.5


@pytest.fixture(scope="module")
def moved():
    """Scan of a disc by a shifted detector, which a shifted axis of rotation explains equally well."""
    prepared = {"disc": prepare_recording({OFFSET: {"columns_px": 0.15}})}
    chosen, ambiguities = refit(prepared["disc"], "disc", {OFFSET: [AXIS]})
    suggested = ("same", "less_magnified", "half_current", "air", "dark_frames")
    some = [one for one in possible(prepared) if one.name in suggested]
    assert [one.name for one in some] == ["same", "less_magnified", "half_current", "air", "dark_frames"]
    return prepared, chosen, ambiguities, rank(prepared, chosen, ambiguities, some)


def test_detector_offset_and_axis_offset_separate_at_another_magnification(moved):
    *_, found = moved
    (pair,) = found.now.scores
    assert found.now.alike[pair] > 0.99 and not settles(found.now)
    assert found.ranked[0].measurement.name == "less_magnified" and settles(found.ranked[0])
    gains = {one.measurement.name: one.gain for one in found.ranked}
    assert gains["less_magnified"] > gains["same"] + 0.5 and gains["same"] > gains["half_current"] > gains["air"]
    assert gains["dark_frames"] == pytest.approx(0, abs=1e-6)
    for one in found.ranked:
        assert one.scores[pair] >= found.now.scores[pair] - 1e-6


def test_expected_gain_of_a_pair_equals_that_of_two_fits():
    """Glare and scatter, which the present recording distinguishes: fits give the true separation."""
    prepared = prepare_recording({"veiling_glare": {"share": 0.05, "width_mm": 60.0, "beyond": 0.0}}, seed=3)
    fitter = prepared.fitter
    fits = {name: fitter.fit((name,)) for name in ("veiling_glare", "scatter")}
    scan, model = FurtherScan("disc", "", fitter.model.chain.scene, GEOMETRY), fitter.model
    noise_fit, conditions = fits["veiling_glare"], conditions_of(prepared)
    parts = {
        name: [scan.information(model, fit, conditions, existing=True, noise_fit=noise_fit)]
        for name, fit in fits.items()
    }
    measured = fitter.score(fits["veiling_glare"]) - fitter.score(fits["scatter"])
    assert measured > 1000
    assert expected(parts, "veiling_glare", "scatter") == pytest.approx(measured, rel=0.3)


def test_dark_frames_measure_a_dark_signal():
    prepared = {"disc": prepare_recording({"dark_signal": {"level_units": 400.0, "drift_units_per_s": 0.0}}, seed=4)}
    fitter = prepared["disc"].fitter
    fits = {name: {"disc": fitter.fit((name,))} for name in ("dark_signal", "scatter")}
    frames = [one for one in possible(prepared) if one.name in ("dark_frames", "air")]
    found = rank(prepared, fits["dark_signal"], [Ambiguity(fits)], frames)
    assert [one.measurement.name for one in found.ranked] == ["dark_frames", "air"]
    assert found.ranked[0].least > found.now.least + 100


def test_similarity_of_effects_equals_that_of_templates(moved):
    prepared, *_ = moved
    baseline = {"disc": prepared["disc"].fitter.fit(())}
    similar = effect_similarity(prepared, baseline, (OFFSET, AXIS, "scatter", "gain_pattern"))
    assert set(similar) == {(OFFSET, AXIS), (OFFSET, "scatter"), (AXIS, "scatter")}  # a pattern has no parameters
    assert similar[OFFSET, AXIS]["disc"] > 0.95 and similar[OFFSET, "scatter"]["disc"] < 0.2
    assert similar[OFFSET, AXIS][""] == pytest.approx(similar[OFFSET, AXIS]["disc"])
    rows = similarity_table(similar)
    assert list(rows.columns) == ["effect", "other", "disc", "together"] and rows["together"].is_monotonic_decreasing


def test_ambiguity_of_a_scanner_diagnosis_is_found(moved):
    prepared, *_ = moved
    baseline = {"disc": prepared["disc"].fitter.fit(())}
    similar = effect_similarity(prepared, baseline, (OFFSET, AXIS, "scatter"))
    chosen, ambiguities = refit_jointly(prepared, (OFFSET,), (OFFSET, AXIS, "scatter"), similar)
    assert chosen["disc"].effects == (OFFSET,)
    assert [list(ambiguity.fits) for ambiguity in ambiguities] == [[OFFSET, AXIS]]


def test_without_ambiguity_the_named_effects_are_measured_better(moved):
    prepared, chosen, _, _ = moved
    some = [one for one in possible(prepared) if one.name in ("same", "air")]
    found = rank(prepared, chosen, [], some)
    assert [one.measurement.name for one in found.ranked] == ["same", "air"]
    assert found.ranked[0].least is None and not settles(found.ranked[0]) and found.ranked[0].gain > 0


def test_pixel_patterns_are_assigned_to_an_air_scan():
    named = {
        "effects": [{"name": OFFSET}, {"name": "gain_pattern"}],
        "ambiguous_with": {OFFSET: [AXIS, "gain_pattern"]},
    }
    assert found_in(named) == {OFFSET: [AXIS]}


def test_table_figure_and_recording_template_are_written(moved):
    *_, found = moved
    rows = ranking_table(found)
    assert list(rows["name"][:2]) == ["now", "less_magnified"] and rows["settles"][1]
    assert best_measurement_text(found).startswith("the object nearer to the detector")
    assert [axes.get_xlabel() for axes in draw_ranking(rows, 3.0).axes][0].startswith("expected information gain")
    for one in found.ranked:
        text = recording_template("disc", one, CONTENT, SECTION, 4)
        filled = yaml.safe_load(text)
        validate(filled, read_schema(SCHEMAS / "recording.schema.yaml"), "recording.yaml")
        assert one.measurement.words in text and len(filled["repeats"]) == 4
        if one.measurement.name == "half_current":
            assert filled["nominal"]["photons"] == 50
        if one.measurement.name == "less_magnified":
            assert filled["scan"]["source_to_isocentre_mm"] > 700 and SCAN["source_to_isocentre_mm"] == 500


def template_of(name, content, settings):
    """Return the recording.yaml of a measurement, and the configuration in its comments."""
    measurements = candidate_measurements(GEOMETRY, DiscScene(160.0, "water"))
    (made,) = (one for one in measurements if one.name == name)
    text = recording_template("disc", RankedMeasurement(made, 0.0, {}, {}), CONTENT | content, settings, 2)
    lines = [line.removeprefix("# ") for line in text.splitlines() if line.startswith("#")]
    return yaml.safe_load(text), yaml.safe_load("\n".join(lines[lines.index("Then add to the configuration:") + 1 :]))


def test_further_scan_of_the_object_keeps_its_settings():
    settings = SECTION | {"object_exact": True, "samples": 3, "alignment": {"scale": 0.01}}
    _, configured = template_of("less_magnified", {}, settings)
    assert configured["diagnosis"]["recordings"]["disc_less_magnified"] == settings
    _, configured = template_of("pmma", {}, settings)
    assert configured["diagnosis"]["recordings"]["disc_pmma"]["object"]["kind"] == "pmma_disc"


def test_nominal_settings_follow_current_and_speed():
    nominal = {"tube_kvp": 100.0, "photons": 100.0, "tube_current_ma": 40.0, "mas": 10.0, "exposure_time_ms": 5.0}
    (half, _), (slow, _) = (template_of(name, {"nominal": nominal}, SECTION) for name in ("half_current", "half_speed"))
    assert half["nominal"] == nominal | {"photons": 50.0, "tube_current_ma": 20.0, "mas": 5.0}
    assert slow["nominal"] == nominal | {"tube_current_ma": 20.0, "exposure_time_ms": 10.0}


def test_explanations_are_compared_with_the_same_noise():
    """Both kinds of crosstalk blur alike and differ slightly in noise: repeating the scan separates them little."""
    prepared = {"disc": prepare_recording({"xray_crosstalk": {"column": 0.012, "row": 0.0}}, seed=7)}
    fitter = prepared["disc"].fitter
    fits = {name: {"disc": fitter.fit((name,))} for name in ("xray_crosstalk", "optical_crosstalk")}
    some = [one for one in possible(prepared) if one.name in ("same", "air")]
    found = rank(prepared, fits["xray_crosstalk"], [Ambiguity(fits)], some)
    for one in [found.now, *found.ranked]:
        assert one.least < 20, one


def test_unconstrained_parameters_are_not_the_target():
    """A fan beam has no information on crosstalk between rows."""
    prepared = {"disc": prepare_recording({"xray_crosstalk": {"column": 0.012, "row": 0.0}}, seed=7)}
    fitter = prepared["disc"].fitter
    fits = {"disc": fitter.fit(("xray_crosstalk",))}
    some = [one for one in possible(prepared) if one.name == "same"]
    far = {
        "disc": replace(
            fits["disc"], physics={"xray_crosstalk": fits["disc"].physics["xray_crosstalk"] | {"row": 0.15}}
        )
    }
    gains = [rank(prepared, one, [], some).ranked[0].gain for one in (fits, far)]
    # Two parameters: the share to other columns and its tail.
    assert gains[0] == pytest.approx(gains[1], rel=1e-6) and 0.4 < gains[0] < 2 * 0.5 * np.log(2) * 1.05


def test_recordings_of_several_protocols_share_only_scanner_parameters():
    """Scatter has an amount per protocol and a width per scanner; the dark signal's drift is per scan."""
    prepared = prepare_recording({"scatter": {"amount": 0.05, "width_mm": 60.0}})
    effects = ("scatter", "dark_signal")
    model, fit = prepared.fitter.model, prepared.fitter.fit(effects)
    again = possible({"disc": prepared})[0]
    conditions = conditions_of(prepared)

    def numbers(name, protocol=""):
        told_of = replace(again, name=name).information(model, fit, conditions, protocol=protocol)
        return {key for key in told_of.keys if "alignment" not in key}

    drift = "drift_units_per_s"
    shared = {("scatter", "amount"), ("scatter", "width_mm"), ("dark_signal", "level_units")}
    assert numbers("a") & numbers("b") == shared and ("a", "dark_signal", drift) in numbers("a")
    assert numbers("a", "low") & numbers("b", "low") == shared - {("scatter", "amount")} | {
        ("protocol low", "scatter", "amount")
    }
    assert numbers("a", "low") & numbers("b", "high") == shared - {("scatter", "amount")}


def test_displacement_changes_nothing_without_an_object_in_the_beam():
    """The step of other parameters is not affected."""
    prepared = prepare_recording({OFFSET: {"columns_px": 0.15}})
    fit, model = prepared.fitter.fit((OFFSET,)), prepared.fitter.model
    nothing = FurtherScan("air", "", DiscScene(1e-6, "air"), GEOMETRY)
    told_of = nothing.information(model, fit, conditions_of(prepared))
    assert np.isfinite(told_of.changes).all() and (told_of.steps > 0).all()
    offset = told_of.keys.index(("air", "alignment", "offset"))
    assert np.linalg.norm(told_of.changes[:, offset]) > 1e3


def test_scan_that_leaves_a_pair_ambiguous_ranks_below_one_that_separates_all():
    """By the total gain alone, the order would be reversed."""
    of_some = RankedMeasurement(None, 5.8, {("glare", "scatter"): 0.1, ("dark", "scatter"): 900.0}, {})
    of_all = RankedMeasurement(None, 1.2, {("glare", "scatter"): 4.0, ("dark", "scatter"): 5.0}, {})
    faint = RankedMeasurement(None, 0.3, {("glare", "scatter"): 2.0, ("dark", "scatter"): 5.0}, {})
    assert sorted([faint, of_some, of_all], key=order) == [of_all, of_some, faint]
    alone = [RankedMeasurement(None, gain, {}, {}) for gain in (0.1, 0.4)]
    assert sorted(alone, key=order) == alone[::-1]
