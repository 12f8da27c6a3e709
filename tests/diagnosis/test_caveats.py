"""Cautions of a diagnosis: rejected recordings and warnings about others."""

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
from virtual_phantom.physics.scenes.shapes import DiscScene

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


def cautions(taken, simulated, candidates=(), **stated):
    prepared_data = prepare(taken, None, simulated, **stated)
    return diagnose("bench", prepared_data, chosen(prepared_data.fitter, candidates)).content["caveats"]


def test_correct_object_has_no_caution():
    assert cautions(scans(chain()), chain()) == []


def test_held_out_views_of_a_single_repeat_have_counts():
    one = scans(chain(views=60))
    assert cautions(observed.Scans(one.repeats[:1], None, one.usable), chain(views=60)) == []


def test_too_few_views_are_rejected():
    with pytest.raises(InputError, match="12 views are too few"):
        check_scans(scans(chain(views=12)), "bench")


def test_rays_without_counts_are_reported_or_rejected():
    usable = np.ones((24, 1, 64), bool)
    usable[:, :, 30] = False
    (line,) = cautions(scans(chain(), usable=usable), chain())
    assert line.startswith("1.6 % of the rays have no signal")
    usable[:, :, 10:] = False
    with pytest.raises(InputError, match="84 % of the rays have no signal"):
        check_scans(scans(chain(), usable=usable), "bench")


def test_saturated_pixels_are_excluded():
    counts = np.random.default_rng(2).poisson(1000, (24, 4, 64))
    assert not observed.saturated(counts).any()
    clipped = np.minimum(counts, 1020)
    assert (observed.saturated(clipped) == (clipped == 1020)).all()


def test_wrong_object_is_reported():
    # A disc off the isocenter instead of a much larger one at the center.
    assert any(
        "the object, its location or the geometry is wrong" in line
        for line in cautions(scans(chain(diameter_mm=20.0)), chain(diameter_mm=230.0))
    )


def test_corrected_recording_is_reported():
    """Monochromatic recording of a tube at 120 kV, thick enough to show beam hardening."""
    lines = cautions(scans(chain()), chain(), ("spectrum",), tube_kvp=120.0)
    assert any("corrected for it already" in line for line in lines)
    hardened = scans(chain(), {"spectrum": {"kvp": 120.0, "filtration_mm": 6.0, "sensor_mm": 0.6}})
    assert not any("corrected" in line for line in cautions(hardened, chain(), ("spectrum",), tube_kvp=120.0))
