"""Physics that is declared: in every model, never named as left out, and told where it is not so."""

import numpy as np
import pytest
from simulated_scans import body, chosen

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.candidates import candidates
from virtual_phantom.diagnosis.core.declared import declared
from virtual_phantom.diagnosis.core.verdict import diagnose
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.materials import Segmentation
from virtual_phantom.physics.scene import VoxelScene
from virtual_phantom.recordings.projections import Projections

PHOTONS = 1e5
GEOMETRY = circular(
    views=48,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=40,
    rows=4,
    column_pitch_mm=12.0,
    row_pitch_mm=12.0,
)
SCATTER = {"amount": 0.02, "width_mm": 60.0}
STATED = {"scatter": {"amount": {"value": 0.02, "sd": 0.002}, "width_mm": {"value": 60.0, "sd": 5.0}}}
OTHERS = ("electronic_noise", "detector_offset", "optical_crosstalk")


@pytest.fixture(scope="module")
def scene():
    return inserts_in_muscle()


def inserts_in_muscle():
    grid = Grid((16, 64, 64), (4.0, 4.5, 4.5))
    volume = body(grid, (110, 80), 20.0, [((50, 10, 5), 20, 800.0), ((-40, -20, -5), 18, -80.0)])
    return VoxelScene.of(volume, Segmentation(), 0.0193)


def found(scene, physics, baseline, tried=OTHERS, seed=1):
    state = Chain(scene, GEOMETRY, PHOTONS).state(physics)
    random = np.random.default_rng(seed)
    white = state.measured_air[0] * state.photons
    taken = observed.scans([Projections(state.counts(random), white, np.zeros_like(white)) for _ in range(4)])
    chain = Chain(scene, GEOMETRY, PHOTONS)
    given = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS, declared=declared(baseline, "baseline"))
    return diagnose("bench", given, chosen(given.fitter, tried)).content


def test_what_is_declared_is_in_every_model_and_is_not_what_was_left_out(scene):
    content = found(scene, {"scatter": SCATTER}, STATED)
    assert content["verdict"] == "match" and content["effects"] == [], content["sentence"]
    amount = content["declared"]["scatter"]["amount"]
    assert not amount["off"] and amount["ci95"][0] <= 0.02 <= amount["ci95"][1]
    # The data tell more of it than the statement does.
    assert amount["ci95"][1] - amount["ci95"][0] < 2 * 1.96 * 0.002


def test_what_is_missing_beside_it_is_named(scene):
    content = found(scene, {"scatter": SCATTER, "detector_offset": {"columns_px": 0.03}}, STATED)
    assert [one["name"] for one in content["effects"]] == ["detector_offset"], content["sentence"]
    low, high = content["effects"][0]["parameters"]["columns_px"]["ci95"]
    assert abs(0.03 - (low + high) / 2) <= high - low
    assert "scatter" not in content["sentence"]


def test_a_statement_that_is_not_so_is_told_with_the_value_that_is(scene):
    wrong = {"scatter": STATED["scatter"] | {"amount": {"value": 0.005, "sd": 0.001}}}
    content = found(scene, {"scatter": SCATTER}, wrong)
    amount = content["declared"]["scatter"]["amount"]
    assert amount["off"] and amount["pull"] > 5
    # Between the statement and the truth, by how well each is known.
    assert 0.005 < amount["value"] < 0.0205
    assert content["verdict"].startswith("mismatch") and content["effects"] == []
    assert "Declared otherwise than found: amount of scatter is" in content["sentence"]


def test_what_is_known_exactly_is_not_fitted(scene):
    exact = {"scatter": {key: {"value": value, "sd": 0} for key, value in SCATTER.items()}}
    content = found(scene, {"scatter": SCATTER}, exact)
    amount = content["declared"]["scatter"]["amount"]
    assert amount["value"] == 0.02 and amount["ci95"] == [0.02, 0.02] and amount["pull"] == 0 and not amount["off"]
    assert content["verdict"] == "match"


def test_pulls_of_statements_that_hold_are_standard_normal(scene):
    """Statements drawn about the truth as they say that they are uncertain: 16 pulls of known mean and SD."""
    random = np.random.default_rng(77)
    pulls = []
    for seed in range(16):
        drawn = {"scatter": {"amount": {"value": float(random.normal(0.02, 0.002)), "sd": 0.002}}}
        drawn["scatter"]["width_mm"] = {"value": 60.0, "sd": 0}
        pulls.append(found(scene, {"scatter": SCATTER}, drawn, (), seed)["declared"]["scatter"]["amount"]["pull"])
    assert abs(np.mean(pulls)) < 3 / np.sqrt(16)
    assert 0.5 < np.std(pulls, ddof=1) < 1.6  # 99.9 % of 16 normal values


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"scatters": {}}, "scatters"),
        ({"scatter": {"amount": {"value": 0.02, "sd": 0.1}}}, "nothing is stated of width_mm"),
        ({"scatter": {**STATED["scatter"], "depth": {"value": 1, "sd": 1}}}, "depth"),
        ({"scatter": STATED["scatter"] | {"amount": {"value": -3, "sd": 1}}}, "amount"),
        ({"gain_pattern": {}}, "one unknown per detector pixel"),
    ],
)
def test_statements_that_cannot_be_are_one_line(section, words):
    with pytest.raises(InputError, match=words) as caught:
        declared(section, "diagnosis.recordings.bench.baseline")
    assert str(caught.value).startswith("diagnosis.recordings.bench.baseline") and "\n" not in str(caught.value)


def test_what_is_declared_is_no_candidate():
    settings = {"baseline": STATED}
    assert "scatter" not in candidates(settings) and "scatter" in candidates({})
    with pytest.raises(InputError, match="scatter is declared under baseline; take it out"):
        candidates(settings | {"effects": ["scatter"]})
