"""What a diagnosis says in words: its sentence, its doubts with what to do about them, and the numbers of places."""

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
from virtual_phantom.diagnosis.verdict.doubts import advice, doubts
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.diagnosis.wording import sentence
from virtual_phantom.physics.beam import sensors
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import DiscScene
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


def content(*effects, **changes):
    return {
        "recording": "bench",
        "verdict": "mismatch explained",
        "locations": [PLACE],
        "effects": [{"name": name} for name in effects],
        "ambiguous_with": {},
        "unexplained": [],
        "doubts": [],
        "excess_removed": 0.763,
        "excess_rms_removed": 0.513,
        "held_out": {"rms_line_integral": {"before": 0.00326, "after": 0.00321, "floor": 0.0021}},
    } | changes


def test_many_effects_are_a_list_with_alternatives_in_brackets():
    rivals = {"off_focal_radiation": ["veiling_glare", "scatter"], "spectrum": []}
    said = sentence(content("spectrum", "dark_signal", "source_distance", "off_focal_radiation", ambiguous_with=rivals))
    assert said.startswith("bench and the simulation differ, most in columns (column 3 of 64); left out were ")
    assert (
        "left out were spectrum, dark signal, source distance and off focal radiation (or veiling glare or scatter), "
        "which together remove 76.3 % of the difference on data not fitted (51.3 % of its root mean square: 0.00326, "
        "then 0.00321; noise alone 0.0021)." in said
    )
    outside = {"scatter": {"what": "depends on the view", "better_by": 9.0, "z": 5.0}}
    assert "left out was scatter (or something outside of the library that depends on the view), which removes" in (
        sentence(content("scatter", outside=outside))
    )


def test_not_all_is_removed_where_something_is_left():
    doubted = content("scatter", excess_removed=0.9998, excess_rms_removed=0.982, doubts=["a", "b", "c"])
    said = sentence(doubted)
    assert "the best that the library offers is scatter, which removes over 99.9 % of the difference" in said
    assert "(98.2 % of its root mean square: " in said and "100" not in said
    assert said.endswith("). But a, b and c: something else was left out as well, or instead.")
    assert "removes 100.0 %" in sentence(content("scatter", excess_removed=1.0))
    assert "removes over 99.9 %" in sentence(content("scatter", excess_removed=1.0, unexplained=[PLACE]))
    # A root that has not become smaller has no share.
    assert "(root mean square 0.00326, then" in sentence(content("scatter", excess_rms_removed=-0.1))


def doubted(physics, nuisance=None, sensor=None, pulled=None, **known):
    """Doubts and advice for a fit of these numbers, all of them well known by the data."""
    chain = Chain(SCENE, GEOMETRY, PHOTONS, sensor=sensor or sensors.stated())
    model = ScansModel(chain, nuisances(np.log(PHOTONS), 0.02, {}), **known)
    values = {one.name: one.expected for one in model.aligned} | (nuisance or {})
    errors = {name: dict.fromkeys(numbers, 1e-6) for name, numbers in physics.items()}
    if pulled is None:
        pulled = {one.name: one.off(values[one.name]) for one in model.alignment(tuple(physics))}
    fit = SimpleNamespace(effects=tuple(physics), physics=physics, errors=errors, nuisance=values, pulled=pulled)
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
            ["kVp of spectrum is 75 kV (stated: 80, known within 1)"],
        ),
        (
            spectrum(kvp=150.0),
            {},
            ["kVp of spectrum is 150 kV (not stated, the upper end of its range)"],
        ),
        (
            spectrum(sensor_mm=0.01),
            {},
            ["sensor thickness of spectrum is 0.01 mm (not stated, the lower end of its range)"],
        ),
        (
            {"scatter": {"amount": 0.6, "width_mm": 60.0}},
            {"declared": {"scatter": {"amount": Statement(0.5, 0.02)}}},
            ["amount of scatter is 0.6 (stated: 0.5, known within 0.02)"],
        ),
        (
            {"scatter": {"amount": 0.1, "width_mm": 200.0}},
            {},
            ["width of scatter is 200 mm (not stated, the upper end of its range)"],
        ),
    ],
)
def test_a_number_at_its_bound_is_said_with_what_was_stated(physics, known, expected):
    assert doubted(physics, **known) == (expected, [])


def test_a_stated_sensor_is_called_stated():
    """Five standard deviations of 5 % of the logarithm: a factor of 1.28."""
    thin = 0.6 * np.exp(-5 * sensors.STATED_SD)
    found, _ = doubted(spectrum(sensor_mm=thin), sensor=sensors.stated("caesium_iodide", 0.6))
    assert found == ["sensor thickness of spectrum is 0.467 mm (stated: 0.6, known within 5 %)"]


def test_what_the_alignment_had_to_be_pulled_by_is_said_with_what_to_state():
    found, advised = doubted({}, {"scale": 0.975, "offset": 0.01, "log_photons": np.log(PHOTONS) - 0.1})
    assert found == [
        "log photons, scale and offset of the alignment had to be pulled as far as a fit may (5 standard deviations: "
        "to 12.1, known: 12.2 ± 0.02; to 0.975, known: 1 ± 0.005; to 0.01, known: 0 ± 0.002)"
    ]
    # Photons are stated elsewhere.
    assert [line.split()[0] for line in advised] == ["Scale", "Offset"]
    assert "density of the object" in advised[0] and "alignment: {scale: ...}" in advised[0]
    assert "known to 0.002. If it may be farther off" in advised[1] and "alignment: {offset: ...}" in advised[1]
    assert doubted({}, {"scale": 0.98}) == ([], [])
    # A density that was found on another recording is known otherwise than the model's own.
    assert doubted({}, {"scale": 0.9}, pulled={"scale": -0.1}) == ([], [])


@pytest.fixture(scope="module")
def stepped():
    """One view of two of a scan that has 5 % more of everything in its view 20."""
    chain = Chain(SCENE, GEOMETRY, PHOTONS)
    repeats = noisy_lines(chain.state({}), 4, np.random.default_rng(3)).astype(np.float32)
    repeats[:, 20] *= 1.05
    taken = observed.Scans(repeats, None, np.ones(repeats.shape[1:], bool))
    given = prepare(taken, None, chain, step=2)
    return given, diagnose("bench", given, chosen(given.fitter, ("scatter",)))


def test_places_have_the_recording_s_numbers(stepped):
    _, found = stepped
    where = {place.domain: place.where for place in found.after}
    assert where["views"] == "view 20, one in 2 being compared"
    first, last = map(int, where["projections"].partition(",")[0].removeprefix("views ").split(" to "))
    assert first <= 20 <= last and first % 2 == last % 2 == 0


def test_figures_have_the_recording_s_numbers(stepped, monkeypatch):
    """Of 24 views that were taken and of 64 columns, of which two are one of the map's here."""
    given, found = stepped
    drawn = {}
    monkeypatch.setattr(report, "PIXELS_ACROSS", 32)
    for name in ("draw_maps", "draw_profiles"):
        real = getattr(report.figures, name)
        monkeypatch.setattr(
            report.figures, name, lambda *a, _real=real, _name=name, **k: drawn.setdefault(_name, _real(*a, **k))
        )
    page = report.page(found, given, 0.01, report.residual_maps(found, given))
    (image,) = drawn["draw_maps"].axes[0].get_images()
    assert image.get_array().shape == (24, 32) and image.get_extent() == [-0.5, 63.5, 47.5, -0.5]
    assert np.abs(image.get_array()).max(axis=1).argmax() == 10
    columns, views = (panel.get_lines()[0].get_xdata() for panel in drawn["draw_profiles"].axes[:2])
    assert columns.max() <= 63 and set(views) <= set(range(0, 48, 2)) and views.max() == 46
    assert "<h2>Doubts</h2>" in page and page.index("<h2>Doubts") < page.index("<h2>Where they differ")
    assert found.content["doubts"]
    assert all(f"<li>{doubt}." in page for doubt in found.content["doubts"])
    assert all(f"<li>{line}</li>" in page for line in found.content["caveats"])
    assert "Caution" not in page
