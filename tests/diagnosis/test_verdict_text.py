"""Text of a verdict: lines for every outcome, doubts with advice, and numbers of locations."""

from types import SimpleNamespace

import numpy as np
import pytest
from simulated_scans import chosen, noisy_lines

from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.fitting.nuisance import nuisances
from virtual_phantom.diagnosis.fitting.priors import Statement
from virtual_phantom.diagnosis.projections import observed
from virtual_phantom.diagnosis.projections.model import ScansModel
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.diagnosis.verdict.warnings import advice, doubts
from virtual_phantom.diagnosis.verdict_text import (
    console_text,
    feature_lines,
    recording_lines,
    setup_lines,
    with_verdict_text,
)
from virtual_phantom.physics.beam import sensors
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.report import diagnosis as report

GEOMETRY = circular(
    views=48,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=900.0,
    columns=64,
    rows=1,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
)
SCENE = DiscScene(160.0, "water")
PHOTONS = 2e5
PLACE = {"domain": "columns", "where": "column 3 of 64", "z": 9.0, "p": 1e-9, "map": "columns.npy"}
EDGES = {"domain": "edges", "where": "the 10 % steepest rays"}
THRESHOLDS = {"hu": 1, "contrast_percent": 1, "noise_percent": 1, "resolution_percent": 1, "features_sd": 0.2}
SCATTER = {"amount": {"value": 0.0531, "unit": "1"}, "width_mm": {"value": 62.4, "unit": "mm"}}
RMS = {"rms_line_integral": {"before": 0.01696, "after": 0.01133, "floor": 0.011}}
DECLARED = {"value": 0.02, "ci95": [0.019, 0.021], "unit": "1", "stated": 0.005, "sd": 0.001, "off": True}
PIECE = {"x_mm": -35.2, "y_mm": -20.0, "z_mm": None, "width_mm": 30.0, "hu": -91.2}
SETUP = {"of": "line integrals", "share_stated": 0.88, "share": 0.23, "location": {}, "alike": []}
MOST_WORDS = 26


def content(*effects, **changes):
    return {
        "recording": "bench",
        "verdict": "mismatch explained",
        "locations": [PLACE],
        "effects": [{"name": name} for name in effects],
        "ambiguous_with": {},
        "unexplained": [],
        "doubts": [],
        "excess_removed": 0.942,
        "excess_rms_removed": 0.79,
        "held_out": RMS,
        "next_measurement": [],
    } | changes


def practice(small=(), **changes):
    return {"practice": {"thresholds": THRESHOLDS, "small": list(small), "differing": {}} | changes}


def written(lines):
    """Lines as in the documents: at most five, each with a label and few words."""
    found = with_verdict_text({}, lines)
    assert 1 <= len(found["verdict_lines"]) <= 5 and found["sentence"] == " ".join(found["verdict_lines"])
    for line in found["verdict_lines"]:
        assert line.endswith(".") and ": " in line and ".." not in line
        assert len(line.replace("diagnosis.recordings", "").split()) <= MOST_WORDS, line
    return found["verdict_lines"]


def lines_of(*effects, stated=None, **changes):
    return written(recording_lines(content(*effects, **changes), stated))


def test_missing_physics_is_reported_with_its_fit_and_the_remaining_mismatch():
    found = lines_of(
        unexplained=[EDGES],
        effects=[{"name": "scatter", "parameters": SCATTER}, {"name": "anti_scatter_grid"}],
        ambiguous_with={"anti_scatter_grid": ["dark_signal"]},
        **practice(["anti_scatter_grid"], remaining={"hu": {"value": -0.31, "error": 0.02}}),
    )
    assert found == [
        "Missing physics: scatter (amount 0.0531, kernel width 62.4 mm).",
        "Fit on held-out data: excess RMS of line integrals 0.0129 -> 0.00271 (79 % removed); noise 0.011.",
        "Remaining mismatch: largest in object edges (the 10 % steepest rays); up to 0.31 HU in images.",
        "Also significant, below the relevance thresholds: anti-scatter grid or dark signal.",
        "Next: to confirm scatter, repeat the scan with the beam collimated to a few rows.",
    ]


def test_alternatives_are_listed_for_each_effect():
    rivals = {"off_focal_radiation": ["veiling_glare", "scatter"], "spectrum": []}
    found = lines_of("spectrum", "dark_signal", "source_distance", "off_focal_radiation", ambiguous_with=rivals)
    assert found[0] == "Missing physics: spectrum, dark signal, source distance and off-focal radiation."
    assert found[1] == "Indistinguishable alternatives: veiling glare or scatter instead of off-focal radiation."
    outside = {"scatter": {"what": "depends on the view", "better_by": 9.0, "z": 5.0}}
    assert lines_of("scatter", outside=outside)[1] == (
        "Indistinguishable alternatives: an unmodeled change that depends on the view."
    )


def test_match_and_match_for_practical_purposes():
    assert lines_of(verdict="match") == [
        "Missing physics: none; bench and the simulation differ only by noise and alignment."
    ]
    found = lines_of("dark_signal", verdict="match for practical purposes", **practice(["dark_signal"]))
    assert found == [
        "Missing physics: none that is clinically relevant; image differences are below all thresholds.",
        "Also significant, below the relevance thresholds: dark signal.",
        "Relevance thresholds: 1 HU, contrast 1 %, noise 1 %, resolution 1 %, features 0.2 SD of repeats.",
    ]


def test_unexplained_difference():
    found = lines_of(
        verdict="unexplained",
        **practice(differing={"hu": 12.3, "resolution_percent": -1.23}),
        next_measurement=["repeat the scan"],
    )
    assert found == [
        "Missing physics: unknown; no effect of Virtual Phantom explains the difference.",
        "Largest mismatch: detector columns (column 3 of 64); in images: 12.3 HU, resolution -1.23 %.",
        "Next: repeat the scan.",
    ]


def test_doubts_and_data_remarks_are_cautions():
    doubted = lines_of("scatter", doubts=["chi-square per datum is 1.41", "b", "c"], excess_rms_removed=0.9999)
    assert doubted[0] == "Best explanation: scatter."
    assert "Caution: chi-square per datum is 1.41; 2 more in the report." in doubted
    assert "Caution: 3 % of the rays have no signal." in lines_of(
        "scatter", caveats=["3 % of the rays have no signal. They are excluded."]
    )


def test_all_is_removed_only_if_no_mismatch_remains():
    assert "(100 % removed)" in lines_of("scatter", excess_rms_removed=1.0)[1]
    assert "(over 99.9 % removed)" in lines_of("scatter", excess_rms_removed=1.0, unexplained=[PLACE])[1]
    assert "(over 99.9 % removed)" in lines_of("scatter", excess_rms_removed=0.9999)[1]
    # Without a smaller RMS there is no share.
    assert (
        lines_of("scatter", excess_rms_removed=-0.1)[1]
        == "Fit on held-out data: RMS of line integrals 0.017 -> 0.0113; noise 0.011."
    )


def test_object_mismatch_and_its_location():
    found = lines_of(
        verdict="unexplained",
        object={"corrected": False, "removes": 0.97, "pieces": [PIECE]},
        next_measurement=["turn"],
    )
    assert found == [
        "Local object mismatch: 30 mm rod along z at x -35.2, y -20 mm, 91.2 HU less than stated.",
        "Fit on held-out data: correcting the object removes 97 % of the difference, more than any effect.",
        "Next: turn.",
    ]
    corrected = lines_of(verdict="match", object={"corrected": True, "pieces": [PIECE]})
    assert corrected[1].startswith("Object corrected before the fit: 30 mm rod along z at x -35.2")
    moved = {"location": {"x_mm": 12.0, "y_mm": 0.0}}
    found = lines_of(verdict="match", setup=moved, alignment={"x_mm": {"value": 12.34}, "y_mm": {"value": 0.2}})
    assert found[1] == (
        "Object location: 12.3 mm off the isocenter; set diagnosis.recordings.bench.location: {x_mm: 12.3}."
    )


def test_declared_and_transferred_physics():
    found = lines_of(declared={"scatter": {"amount": DECLARED}})
    assert found[0] == "Missing physics: none; a declared value contradicts the data."
    assert found[1] == ("Contradicts declared physics: scatter: amount 0.02 (0.019 to 0.021), declared 0.005 ± 0.001.")
    taken = lines_of(effects=[{"name": "scatter", "taken_from": "disc"}], not_taken=["gain_pattern"])
    assert (
        "Source of the physics: transferred from disc; only the alignment is fitted; not transferred: gain pattern."
        in (taken)
    )
    assert not [line for line in taken if line.startswith("Next")]


def test_five_most_important_of_many_lines_are_shown():
    found = lines_of(
        "scatter",
        doubts=["a"],
        declared={"scatter": {"amount": DECLARED}},
        unexplained=[EDGES],
        ambiguous_with={"scatter": ["veiling_glare"]},
        next_measurement=["b"],
    )
    assert [line.partition(":")[0] for line in found] == [
        "Best explanation",
        "Fit on held-out data",
        "Remaining mismatch",
        "Caution",
        "Contradicts declared physics",
    ]


@pytest.mark.parametrize(
    ("setup", "expected"),
    [
        (
            {"kind": "description", "mistakes": {"direction": "scan.direction: -1"}},
            [
                "Scan set-up error: direction.",
                "Correction: scan.direction: -1.",
                "Unexplained variance of line integrals: 88 % with the stated set-up, 23 % after correction.",
                "Effects: none fitted; correct the set-up first.",
            ],
        ),
        (
            {"kind": "object", "of": "HU inside the body"},
            [
                "Wrong object: the scan does not show the study's phantom.",
                "Unexplained variance of HU inside the body: at least 23 % for all tested voxel orders and locations.",
                "Next: state the scanned object and all else in the beam, such as a table.",
                "Effects: none fitted; correct the set-up first.",
            ],
        ),
        (
            {"kind": "empty"},
            [
                "Empty beam: line integrals are not correlated with those of the study's phantom.",
                "Next: check that the repeats in recording.yaml are scans of the object, not air scans.",
                "Effects: none fitted; correct the set-up first.",
            ],
        ),
    ],
)
def test_wrong_set_up(setup, expected):
    assert written(setup_lines(SETUP | setup, "the study's phantom")) == expected


def test_features_and_their_properties():
    place = {"domain": "family", "where": "texture of liver"}
    document = {
        "verdict": "unexplained",
        "locations": [place],
        "effects": [],
        "candidates": {"noise_texture": {"held_out": 0.12}},
        "ambiguous_with": {},
        "unexplained": [],
        "next_measurement": ["scan again"],
    }
    assert written(feature_lines(document | {"verdict": "match"})) == [
        "Differing image property: none; features differ by no more than between repeats."
    ]
    assert written(feature_lines(document)) == [
        "Differing image property: unknown; no single property explains the difference.",
        "Largest mismatch: family (texture of liver).",
        "Closest property: noise texture, which removes 12 % of the difference on held-out regions.",
        "Next: scan again.",
    ]
    effect = {"name": "noise_texture", "evidence": {"held_out_gain": 0.8}}
    found = written(
        feature_lines(document | {"verdict": "mismatch explained", "effects": [effect], "unexplained": [place]})
    )
    assert found[:2] == [
        "Differing image property: noise texture.",
        "Fit on held-out regions: 80 % of the difference removed.",
    ]


def test_console_names_the_recording():
    found = with_verdict_text(content(verdict="match"), recording_lines(content(verdict="match")))
    assert console_text(found).splitlines() == [
        "bench: match",
        "  Missing physics: none; bench and the simulation differ only by noise and alignment.",
    ]


def doubted(physics, nuisance=None, sensor=None, pulls=None, **known):
    """Doubts and advice for a fit with these parameters, all of them well constrained."""
    chain = Chain(SCENE, GEOMETRY, PHOTONS, sensor=sensor or sensors.sensor_from_label())
    model = ScansModel(chain, nuisances(np.log(PHOTONS), 0.02, {}), **known)
    values = {one.name: one.expected for one in model.base_nuisances} | (nuisance or {})
    errors = {name: dict.fromkeys(numbers, 1e-6) for name, numbers in physics.items()}
    if pulls is None:
        pulls = {one.name: one.pull(values[one.name]) for one in model.nuisances_for(tuple(physics))}
    fit = SimpleNamespace(effects=tuple(physics), physics=physics, errors=errors, nuisance=values, pulls=pulls)
    choice = SimpleNamespace(chosen=SimpleNamespace(fit=fit))
    return doubts(choice, model, {}), advice(fit, model)


def spectrum(kvp=60.0, sensor_mm=0.6):
    return {"spectrum": {"kvp": kvp, "filtration_mm": 3.0, "sensor_mm": sensor_mm}}


@pytest.mark.parametrize(
    ("physics", "known", "expected"),
    [
        (spectrum(), {}, []),
        (
            spectrum(kvp=75.0),
            {"tube_kvp": 80.0},
            ["tube voltage of spectrum is at its lower bound, 75 kV (stated: 80 ± 1)"],
        ),
        (
            spectrum(kvp=150.0),
            {},
            ["tube voltage of spectrum is at its upper bound, 150 kV (not stated)"],
        ),
        (
            spectrum(sensor_mm=0.01),
            {},
            ["sensor thickness of spectrum is at its lower bound, 0.01 mm (not stated)"],
        ),
        (
            {"scatter": {"amount": 0.6, "width_mm": 60.0}},
            {"declared": {"scatter": {"amount": Statement(0.5, 0.02)}}},
            ["amount of scatter is at its upper bound, 0.6 (stated: 0.5 ± 0.02)"],
        ),
        (
            {"scatter": {"amount": 0.1, "width_mm": 200.0}},
            {},
            ["kernel width of scatter is at its upper bound, 200 mm (not stated)"],
        ),
        ({"veiling_glare": {"share": 0.05, "width_mm": 60.0, "beyond": 1.0}}, {}, []),  # a fraction may be 1
    ],
)
def test_parameter_at_its_bound_is_reported_with_its_declaration(physics, known, expected):
    assert doubted(physics, **known) == (expected, [])


def test_declared_sensor_is_called_declared():
    """Five standard deviations of 5 % in the logarithm: a factor of 1.28."""
    thin = 0.6 * np.exp(-5 * sensors.STATED_SD)
    found, _ = doubted(spectrum(sensor_mm=thin), sensor=sensors.sensor_from_label("caesium_iodide", 0.6))
    assert found == ["sensor thickness of spectrum is at its lower bound, 0.467 mm (stated: 0.6 ± 5 %)"]


def test_shift_of_the_alignment_is_reported_with_the_setting_to_correct():
    found, advised = doubted({}, {"scale": 0.975, "offset": 0.01, "log_photons": np.log(PHOTONS) - 0.1})
    assert found == [
        "logarithm of the photons is 12.1 (prior 12.2 ± 0.02), object density scale is 0.975 (prior 1 ± 0.005) and air "
        "offset is 0.01 (prior 0 ± 0.002), at the limit of the fit (5 SD of the prior)"
    ]
    # Photons have their own setting.
    assert [" ".join(line.split()[:3]) for line in advised] == ["The object density", "The air offset"]
    assert "density of the object" in advised[0] and "alignment: {scale: SD}" in advised[0]
    assert "prior SD of 0.002. If its error may be larger" in advised[1] and "alignment: {offset: SD}" in advised[1]
    assert doubted({}, {"scale": 0.98}) == ([], [])
    # A density found on another recording has another prior than the model's own.
    assert doubted({}, {"scale": 0.9}, pulls={"scale": -0.1}) == ([], [])


@pytest.fixture(scope="module")
def stepped():
    """Every second view of a scan whose view 20 has 5 % more signal."""
    chain = Chain(SCENE, GEOMETRY, PHOTONS)
    repeats = noisy_lines(chain.state({}), 4, np.random.default_rng(3)).astype(np.float32)
    repeats[:, 20] *= 1.05
    taken = observed.Scans(repeats, None, np.ones(repeats.shape[1:], bool))
    document = prepare(taken, None, chain, step=2)
    return document, diagnose("bench", document, chosen(document.fitter, ("scatter",)))


def test_locations_use_the_numbers_of_the_recording(stepped):
    _, found = stepped
    where = {place.domain: place.where for place in found.after}
    assert where["views"] == "view 20, 1 of 2 views compared"
    first, last = map(int, where["projections"].partition(",")[0].removeprefix("views ").split(" to "))
    assert first <= 20 <= last and first % 2 == last % 2 == 0


def test_figures_use_the_numbers_of_the_recording(stepped, monkeypatch):
    """24 selected views and 64 columns, of which two are one column of the map."""
    _, found = stepped
    drawn = {}
    monkeypatch.setattr(report, "PIXELS_ACROSS", 32)
    for name in ("draw_data", "draw_maps", "draw_profiles"):
        real = getattr(report.figures, name)
        monkeypatch.setattr(
            report.figures, name, lambda *a, _real=real, _name=name, **k: drawn.setdefault(_name, _real(*a, **k))
        )
    page = report.diagnosis_page(found, report.residual_maps(found))
    (image,) = drawn["draw_maps"].axes[0].get_images()
    assert image.get_array().shape == (24, 32) and image.get_extent() == [-0.5, 63.5, 47.5, -0.5]
    assert np.abs(image.get_array()).max(axis=1).argmax() == 10
    recorded, modeled, before, after = (panel.get_images()[0] for panel in drawn["draw_data"].axes[:4])
    assert recorded.get_array().shape == (24, 64) and recorded.get_extent() == [-0.5, 63.5, 47.5, -0.5]
    fitter = found.prepared.fitter
    mean = found.prepared.held_out.mean[:, 0]
    np.testing.assert_allclose(recorded.get_array(), mean, rtol=1e-6)
    model = fitter.predicted(found.choice.chosen.fit, held_out=True).mean.reshape(mean.shape)
    np.testing.assert_allclose(recorded.get_array() - after.get_array(), model, atol=1e-5)
    np.testing.assert_allclose(modeled.get_array(), model, atol=1e-5)
    letters = [panel.get_title(loc="left") for figure in drawn.values() for panel in figure.axes]
    assert [letter for letter in letters if letter] == list("abcdefghi")
    columns, views = (panel.get_lines()[0].get_xdata() for panel in drawn["draw_profiles"].axes[:2])
    assert columns.max() <= 63 and set(views) <= set(range(0, 48, 2)) and views.max() == 46
    assert "<h2>Cautions</h2>" in page and page.index("<h2>Cautions") < page.index("<h2>Residuals")
    assert found.content["doubts"]
    assert all(f"<li>{doubt}." in page for doubt in found.content["doubts"])
    assert all(f"<li>{line}</li>" in page for line in found.content["caveats"])
