"""Effects that change the data equally: fits of one are fits of the other, and neither is ruled out."""

from dataclasses import replace

import numpy as np
import pytest

from virtual_phantom.base.geometry import circular, parallel_beam
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.selection import forward_selection
from virtual_phantom.diagnosis.selection.exchange import exchanged
from virtual_phantom.diagnosis.selection.forward_selection import AS_GOOD, LIKE, choose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.projections import Projections

PHOTONS = 1e5
# Sets of effects that a scan cannot distinguish: one moves the detector, the other the object, equally in every view.
PARALLEL = dict(parallel_beam(), column_pitch_mm=5.0)
ALIKE = {
    "parallel": (PARALLEL, {"detector_offset": {"columns_px": 0.9}, "centre_of_rotation": {"shift_mm": -4.5}}),
    "fan": (
        dict(source_to_isocentre_mm=5000.0, source_to_detector_mm=5500.0, column_pitch_mm=5.5),
        {"detector_offset": {"columns_px": 0.8}, "centre_of_rotation": {"shift_mm": -4.0}},
    ),
}


def ready(beam, physics):
    geometry = circular(views=36, columns=48, rows=1, row_pitch_mm=5.0, **beam)
    chain = Chain(DiscScene(120.0, "water"), geometry, PHOTONS, samples=3)
    state, random = chain.state(physics, Pose(15.0, -20.0)), np.random.default_rng(5)
    white = state.measured_air[0] * PHOTONS
    taken = [Projections(state.counts(random), white, np.zeros_like(white)) for _ in range(4)]
    return prepared.prepare(observed.scans(taken), None, chain, location={"x_mm": 15.0, "y_mm": -20.0}).fitter


@pytest.fixture(scope="module", params=[(beam, effect) for beam, (_, pair) in ALIKE.items() for effect in pair])
def scan(request):
    beam, effect = request.param
    geometry, pair = ALIKE[beam]
    (other,) = set(pair) - {effect}
    return ready(geometry, {effect: pair[effect]}), effect, other


def test_fit_starts_at_the_equivalent_fit_of_the_other_effect(scan):
    fitter, effect, other = scan
    found = trial(fitter, (effect,), trial(fitter, ()))
    exchange = exchanged(fitter, found.fit, effect, [other])[other]
    assert exchange.share > LIKE
    again = trial(fitter, (other,), replace(found, fit=exchange.start))
    assert again.fit.chi_square == pytest.approx(found.fit.chi_square, abs=2 * AS_GOOD)
    assert again.score == pytest.approx(found.score, abs=AS_GOOD)


def test_effect_is_not_ruled_out_if_its_fit_gets_stuck(scan, monkeypatch):
    """Other starts of the fit end after a tenth of the way, as in a valley with local minima."""
    fitter, effect, other = scan
    made = forward_selection.trials

    def stuck(fitter, tasks, *arguments, **settings):
        found = made(fitter, tasks, *arguments, **settings)
        for index, (effects, given, *_) in enumerate(tasks):
            if other in effects and (given is None or other not in given.fit.physics):
                fit = found[index].fit
                values = {key: value / 10 for key, value in fit.physics[other].items()}
                fit = replace(fit, physics=fit.physics | {other: values}, chi_square=fit.chi_square + 1e4)
                found[index] = replace(found[index], fit=fit, score=fitter.score(fit))
        return found

    monkeypatch.setattr(forward_selection, "trials", stuck)
    choice = choose(fitter, trial(fitter, ()), [effect, other, "scatter"])
    assert choice.chosen.fit.effects[0] in (effect, other)
    assert other not in choice.ruled_out and effect not in choice.ruled_out
    named = choice.chosen.fit.effects[0]
    assert ({effect, other} - {named}) <= set(choice.ambiguous_with(named))


def test_different_effects_are_not_equivalent(scan):
    fitter, effect, other = scan
    found = trial(fitter, (effect,), trial(fitter, ()))
    shares = {name: one.share for name, one in exchanged(fitter, found.fit, effect, ["scatter", "dark_signal"]).items()}
    assert shares and max(shares.values()) < LIKE
