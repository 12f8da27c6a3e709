"""What speaks against a diagnosis: recordings that are refused, and what is said of others."""

import numpy as np
import pytest
from simulated_scans import chosen, noisy_lines

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.projections import observed
from virtual_phantom.diagnosis.projections.lost_rays import check_scans
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import DiscScene

PHOTONS = 2e5


def chain(diameter_mm=160.0, views=24, material="water"):
    geometry = circular(
        views=views,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=900.0,
        columns=64,
        rows=1,
        column_pitch_mm=8.0,
        row_pitch_mm=8.0,
    )
    return Chain(DiscScene(diameter_mm, material), geometry, PHOTONS)


def scans(made, physics=None, usable=None, seed=1):
    repeats = noisy_lines(made.state(physics or {}), 4, np.random.default_rng(seed))
    whole = np.ones(repeats.shape[1:], bool)
    return observed.Scans(repeats.astype(np.float32), None, whole if usable is None else usable)


def said(taken, simulated, candidates=(), **stated):
    given = prepare(taken, None, simulated, **stated)
    return diagnose("bench", given, chosen(given.fitter, candidates)).content["caveats"]


def test_all_is_well_with_its_own_object():
    assert said(scans(chain()), chain()) == []


def test_views_that_are_held_out_of_a_single_repeat_have_measured_something():
    one = scans(chain(views=60))
    assert said(observed.Scans(one.repeats[:1], None, one.usable), chain(views=60)) == []


def test_too_few_views_are_refused():
    with pytest.raises(InputError, match="12 views are too few"):
        check_scans(scans(chain(views=12)), "bench")


def test_rays_that_measured_nothing_are_said_or_refused():
    usable = np.ones((24, 1, 64), bool)
    usable[:, :, 30] = False
    (line,) = said(scans(chain(), usable=usable), chain())
    assert line.startswith("1.6 % of the rays have no signal")
    usable[:, :, 10:] = False
    with pytest.raises(InputError, match="84 % of the rays measured nothing"):
        check_scans(scans(chain(), usable=usable), "bench")


def test_a_saturated_detector_is_left_out():
    counts = np.random.default_rng(2).poisson(1000, (24, 4, 64))
    assert not observed.saturated(counts).any()
    clipped = np.minimum(counts, 1020)
    assert (observed.saturated(clipped) == (clipped == 1020)).all()


def test_another_object_is_said():
    # A disc beside the isocentre against one in the middle that is far larger.
    assert any(
        "the object, its location or the geometry is wrong" in line
        for line in said(scans(chain(diameter_mm=20.0)), chain(diameter_mm=230.0))
    )


def test_a_corrected_recording_is_said():
    """A monochromatic recording of a tube at 120 kV, thick enough that its hardening would show."""
    lines = said(scans(chain()), chain(), ("spectrum",), tube_kvp=120.0)
    assert any("corrected for it already" in line for line in lines)
    hardened = scans(chain(), {"spectrum": {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}})
    assert not any("corrected" in line for line in said(hardened, chain(), ("spectrum",), tube_kvp=120.0))
