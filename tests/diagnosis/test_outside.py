"""Kinds of change: null distribution, names, and comparison with effects."""

import numpy as np
import pytest
from simulated_scans import chosen
from test_declared import GEOMETRY, PHOTONS, inserts_in_muscle

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.residuals import KINDS
from virtual_phantom.diagnosis.selection import forward_selection
from virtual_phantom.diagnosis.verdict.unmodeled import changes
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.recordings.projections import Projections

NOISE_DRAWS = 10
TURN = np.arange(GEOMETRY.views)[:, None, None] * 2 * np.pi / GEOMETRY.views


@pytest.fixture(scope="module")
def chain():
    return Chain(inserts_in_muscle(), GEOMETRY, PHOTONS)


def simulated(chain, seed, changed=0.0):
    """Four repeats with changed line integrals."""
    state, random = chain.state({}), np.random.default_rng(seed)
    white = state.measured_air[0] * state.photons
    counts = [random.poisson(state.signal * np.exp(-changed) * PHOTONS).astype(float) for _ in range(4)]
    taken = observed.scans([Projections(count, white, np.zeros_like(white)) for count in counts])
    return prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)


def found(one, fit):
    return changes(one, fit)


def test_z_of_every_kind_is_standard_normal_for_noise_alone(chain):
    z = []
    for seed in range(NOISE_DRAWS):
        one = simulated(chain, seed)
        every = found(one, trial(one.fitter, ()).fit)
        assert min(change.p for change in every) * len(every) > 1e-3
        z += [change.z for change in every]
    # 14 kinds overlap and count as if half of them were independent.
    assert abs(np.mean(z)) < 3 / np.sqrt(len(z) / 2)
    assert np.std(z) == pytest.approx(1, abs=3 / np.sqrt(len(z)))


def lines(chain):
    return chain.state({}).line_integrals()


def shifted(array, columns):
    """Linear interpolation, which is not the derivative of the basis."""
    places = np.arange(array.shape[-1])
    return np.apply_along_axis(lambda row: np.interp(places - columns, places, row), -1, array)


def shifted_detector_module(chain):
    p = lines(chain)
    inside = (np.arange(p.shape[-1]) >= 10) & (np.arange(p.shape[-1]) < 15)
    return np.where(inside, shifted(p, 0.3) - p, 0.0)


@pytest.mark.parametrize(
    ("made", "called"),
    [
        (lambda chain: 0.02 * np.sin(lines(chain)), "depends on the line integral alone"),
        (lambda chain: 0.01 * np.sin(2 * TURN + 1) * np.ones_like(lines(chain)), "varies from view to view"),
        (lambda chain: -np.log(np.where(np.arange(48)[:, None, None] % 17 == 5, 0.97, 1.0)), "single views only"),
        (shifted_detector_module, "shifts parts of the detector along columns"),
        (lambda chain: 0.02 * lines(chain) + 0.003, None),  # another density and a drift, which the alignment absorbs
    ],
)
def test_change_is_named_by_its_dependence(chain, made, called):
    one = simulated(chain, 3, np.broadcast_to(made(chain), lines(chain).shape))
    every = found(one, trial(one.fitter, ()).fit)
    best = max(every, key=lambda change: change.gain)
    if called is None:
        assert best.gain < 4 and every[0].p > 1e-3, every[:3]
    else:
        assert called in best.words and best.z > 5, every[:3]


def test_remaining_change_and_better_explanation_are_reported(chain):
    """Line integrals with an S-shaped error; the only candidate effect is a power of the signal."""
    one = simulated(chain, 5, 0.03 * np.sin(2 * lines(chain)))
    content = diagnose("bench", one, chosen(one.fitter, ("dark_signal", "detector_offset"))).content
    assert content["verdict"] == "mismatch partly explained"
    assert KINDS in [place["domain"] for place in content["unexplained"]]
    (beaten,) = content["outside"].items()
    assert beaten[0] == content["effects"][0]["name"]
    assert beaten[1]["what"] == "depends on the line integral alone" and beaten[1]["better_by"] > 4
    assert "an unmodeled change that depends on the line integral alone" in content["sentence"]


def test_effect_that_removes_a_trace_of_a_fault_is_not_named(chain, monkeypatch):
    """Dim views have 100 times the chi-square that any effect removes."""
    dim = -np.log(np.where(np.arange(GEOMETRY.views)[:, None, None] % 17 == 5, 0.9, 1.0))
    one = simulated(chain, 3, np.broadcast_to(dim, lines(chain).shape))
    candidates = ("veiling_glare", "view_angle_error")
    content = diagnose("bench", one, chosen(one.fitter, candidates)).content
    assert content["verdict"] == "unexplained" and not content["effects"]
    monkeypatch.setattr(forward_selection, "LEAST_SHARE", 0.0)
    assert chosen(one.fitter, candidates).chosen.fit.effects


def test_noise_alone_has_no_excess(chain):
    fitter = simulated(chain, 11).fitter
    assert fitter.significant_excess(trial(fitter, ()).score) == 0.0


def test_true_effect_is_not_beaten(chain):
    state, random = chain.state({"scatter": {"amount": 0.02, "width_mm": 60.0}}), np.random.default_rng(9)
    white = state.measured_air[0] * state.photons
    taken = observed.scans([Projections(state.counts(random), white, np.zeros_like(white)) for _ in range(4)])
    one = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)
    content = diagnose("bench", one, chosen(one.fitter, ("scatter", "detector_offset"))).content
    assert [effect["name"] for effect in content["effects"]] == ["scatter"]
    assert content["verdict"] == "mismatch explained" and content["outside"] == {}, content["sentence"]
