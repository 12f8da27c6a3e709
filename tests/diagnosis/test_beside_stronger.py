"""What moves rays beside a strong effect: named by what inexact models of that cannot make up, however little it is."""

import numpy as np
import pytest
from simulated_scans import disc_bench, scans_of

from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.selection import forward_selection, screening
from virtual_phantom.diagnosis.uncertainty.model_error import shapes
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import DiscScene

PHOTONS = 1e5
TRIED = ("dark_signal", "motion", "afterglow")
STRONG = {"dark_signal": {"level_units": 800.0, "drift_units_per_s": 0.0}}
WEAK = {"motion": {"x_mm_per_s": 0.25, "y_mm_per_s": 0.0, "z_mm_per_s": 0.0}}
ACCURACY = {"default": 0.3, "numerical": 0.0}
CHAIN = Chain(DiscScene(160.0, "water"), disc_bench(view_interval_ms=25.0), PHOTONS)


def chosen(physics, tried=TRIED, added=0.0, seed=3):
    """The choice of four repeats, to whose lines something is added."""
    scans = scans_of(CHAIN.state(physics), 4, np.random.default_rng(seed), added)
    fitter = prepared.prepare(scans, None, CHAIN, nominal_photons=PHOTONS).fitter
    return forward_selection.choose(fitter, trial(fitter, ()), tried, accuracy=ACCURACY)


def test_it_is_named_beside_what_is_stronger_by_far(monkeypatch):
    choice = chosen(STRONG | WEAK)
    assert choice.chosen.fit.effects == ("dark_signal", "motion") and choice.unconfounded == {"motion"}
    assert 0 < choice.gains["motion"] < choice.tolerance
    assert choice.ambiguous_with("motion") == [] and "afterglow" in choice.ruled_out
    assert choice.chosen.fit.physics["motion"]["x_mm_per_s"] == pytest.approx(0.25, rel=0.2)
    monkeypatch.setattr(screening, "KEPT_BESIDE_MODEL_ERROR", np.inf)
    choice = chosen(STRONG | WEAK)
    assert choice.chosen.fit.effects == ("dark_signal",) and list(choice.undecided) == ["motion"]


@pytest.mark.parametrize("shape", range(6))
def test_what_an_inexact_model_leaves_is_no_motion(shape):
    """However strong: a tenth of what the dark signal changes is spread otherwise than its model has it."""
    exact, none = (CHAIN.state(physics).line_integrals() for physics in (STRONG, {}))
    spread = list(shapes(exact).values())[shape]
    choice = chosen(STRONG, added=0.1 * spread * (exact - none))
    assert "motion" not in choice.chosen.fit.effects and not choice.unconfounded


def test_of_two_that_are_alike_neither_is():
    """Where inexact models may make up as much and two effects explain it alike, nothing tells them from a model."""
    both = ("dark_signal", "centre_of_rotation", "detector_offset")
    choice = chosen(STRONG | {"detector_offset": {"columns_px": 0.01}}, both)
    assert choice.chosen.fit.effects == ("dark_signal",) and not choice.unconfounded
    assert set(choice.undecided) == set(both[1:])
