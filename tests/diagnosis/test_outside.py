"""Kinds of change: what noise alone gives, what each is called, and when one beats an effect."""

import numpy as np
import pytest
from simulated_scans import chosen
from test_declared import GEOMETRY, PHOTONS, inserts_in_muscle

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.residuals.residual_tests import KINDS
from virtual_phantom.diagnosis.verdict.unmodeled import changes
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.recordings.projections import Projections

NOISE_DRAWS = 10
TURN = np.arange(GEOMETRY.views)[:, None, None] * 2 * np.pi / GEOMETRY.views


@pytest.fixture(scope="module")
def chain():
    return Chain(inserts_in_muscle(), GEOMETRY, PHOTONS)


def given(chain, seed, changed=0.0):
    """Four repeats, whose line integrals are larger by what is changed."""
    state, random = chain.state({}), np.random.default_rng(seed)
    white = state.measured_air[0] * state.photons
    counts = [random.poisson(state.signal * np.exp(-changed) * PHOTONS).astype(float) for _ in range(4)]
    taken = observed.scans([Projections(one, white, np.zeros_like(white)) for one in counts])
    return prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)


def found(one, fit):
    return changes(one, fit)


def test_noise_alone_gives_standard_normal_z_of_every_kind(chain):
    z = []
    for seed in range(NOISE_DRAWS):
        one = given(chain, seed)
        every = found(one, trial(one.fitter, ()).fit)
        assert min(change.p for change in every) * len(every) > 1e-3
        z += [change.z for change in every]
    # Of 14 kinds, which overlap: counted as if half of them were independent.
    assert abs(np.mean(z)) < 3 / np.sqrt(len(z) / 2)
    assert np.std(z) == pytest.approx(1, abs=3 / np.sqrt(len(z)))


def lines(chain):
    return chain.state({}).line_integrals()


def shifted(array, columns):
    """By linear interpolation: not the basis' own derivative."""
    places = np.arange(array.shape[-1])
    return np.apply_along_axis(lambda row: np.interp(places - columns, places, row), -1, array)


def a_module_beside_its_place(chain):
    p = lines(chain)
    inside = (np.arange(p.shape[-1]) >= 10) & (np.arange(p.shape[-1]) < 15)
    return np.where(inside, shifted(p, 0.3) - p, 0.0)


@pytest.mark.parametrize(
    ("made", "called"),
    [
        (lambda chain: 0.02 * np.sin(lines(chain)), "depends on the line integral alone"),
        (lambda chain: 0.01 * np.sin(2 * TURN + 1) * np.ones_like(lines(chain)), "varies from view to view"),
        (lambda chain: -np.log(np.where(np.arange(48)[:, None, None] % 17 == 5, 0.97, 1.0)), "single views only"),
        (a_module_beside_its_place, "moves along columns, in a part of the columns"),
        (lambda chain: 0.02 * lines(chain) + 0.003, None),  # another density and a drift: alignment takes that up
    ],
)
def test_a_change_is_called_by_what_it_depends_on(chain, made, called):
    one = given(chain, 3, np.broadcast_to(made(chain), lines(chain).shape))
    every = found(one, trial(one.fitter, ()).fit)
    best = max(every, key=lambda change: change.gain)
    if called is None:
        assert best.gain < 4 and every[0].p > 1e-3, every[:3]
    else:
        assert called in best.words and best.z > 5, every[:3]


def test_what_is_left_and_what_beats_an_effect_is_told(chain):
    """Line integrals that bend one way and back, where a power of the signal is all that the library is let try."""
    one = given(chain, 5, 0.03 * np.sin(2 * lines(chain)))
    content = diagnose("bench", one, chosen(one.fitter, ("dark_signal", "detector_offset"))).content
    assert content["verdict"] == "mismatch partly explained"
    assert KINDS in [place["domain"] for place in content["unexplained"]]
    (beaten,) = content["outside"].items()
    assert beaten[0] == content["effects"][0]["name"]
    assert beaten[1]["what"] == "depends on the line integral alone" and beaten[1]["better_by"] > 4
    assert "an unmodeled change that depends on the line integral alone" in content["sentence"]


def test_an_effect_that_is_right_is_not_beaten(chain):
    state, random = chain.state({"scatter": {"amount": 0.02, "width_mm": 60.0}}), np.random.default_rng(9)
    white = state.measured_air[0] * state.photons
    taken = observed.scans([Projections(state.counts(random), white, np.zeros_like(white)) for _ in range(4)])
    one = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)
    content = diagnose("bench", one, chosen(one.fitter, ("scatter", "detector_offset"))).content
    assert [effect["name"] for effect in content["effects"]] == ["scatter"]
    assert content["verdict"] == "mismatch explained" and content["outside"] == {}, content["sentence"]
