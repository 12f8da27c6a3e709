"""Selection of fitted views in large scans, whose noise is still known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis import workload
from virtual_phantom.diagnosis.projections import first_noise, observed, prepared
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.shapes import DiscScene

GEOMETRY = circular(
    views=180,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=1000.0,
    columns=64,
    rows=1,
    column_pitch_mm=7.0,
    row_pitch_mm=7.0,
)
PHOTONS = 2e4


@pytest.mark.parametrize(
    ("shape", "samples", "step"),
    [((721, 1, 560), 1, 1), ((180, 16, 128), 2, 1), ((984, 64, 888), 1, 23), ((984, 64, 888), 2, 41)],
)
def test_number_of_fitted_views(shape, samples, step):
    """All views of a fan beam with 0.4 million rays are fitted; every 23rd of a clinical turn, if views cover
    the turn.
    """
    assert workload.step_for(shape, samples) == step


@given(st.integers(1, 5000), st.integers(1, 128), st.integers(1, 1024), st.integers(1, 3))
def test_step_is_odd_and_leaves_enough_views(views, rows, columns, samples):
    step = workload.step_for((views, rows, columns), samples)
    assert step % 2 == 1 and len(range(0, views, step)) >= min(views, workload.FEWEST_VIEWS)


@pytest.mark.parametrize("repeats", [1, 4])
def test_noise_of_selected_views_equals_that_of_all(monkeypatch, repeats):
    """Every seventh view has a seventh of the rays.

    Photons agree within five standard errors with the truth and with all.
    """
    chain = Chain(DiscScene(160.0, "water"), GEOMETRY, PHOTONS)
    state, random = chain.state({}), np.random.default_rng(np.random.SeedSequence(11))
    air = state.measured_air * PHOTONS
    lines = np.stack([-np.log(state.counts(random) / air) for _ in range(repeats)]).astype(np.float32)
    taken = observed.Scans(lines, air[0], np.ones(GEOMETRY.shape, bool))
    whole = prepared.prepare(taken, None, chain, step=7)
    monkeypatch.setattr(first_noise, "MOST_RAYS_FOR_NOISE", 0)
    some = prepared.prepare(taken, None, chain, step=7)
    assert some.data.mean.shape == whole.data.mean.shape
    np.testing.assert_array_equal(some.data.mean, whole.data.mean)
    rays = some.variance.size
    error = np.sqrt(
        (2 / 1 if repeats > 1 else 4) / rays
    )  # relative SD of a variance; second differences are correlated
    assert some.photons == pytest.approx(PHOTONS, rel=5 * error)
    assert some.photons == pytest.approx(whole.photons, rel=5 * error)


def test_views_at_given_positions():
    flown = circular(
        **{name: getattr(GEOMETRY, name) for name in ("source_to_isocentre_mm", "source_to_detector_mm", "columns")},
        views=12,
        rows=1,
        column_pitch_mm=7.0,
        row_pitch_mm=7.0,
        spots_mm=np.array([[-0.5, 0, 0], [0.5, 0, 0]]),
    )
    places = np.array([1, 4, 9])
    some = flown.at(places)
    np.testing.assert_array_equal(some.source_mm, flown.source_mm[places])
    np.testing.assert_array_equal(some.view_times, flown.view_times[places])
    np.testing.assert_array_equal(flown.by_vectors().at(places).source_mm, some.source_mm)
    assert len(flown.every(2).spots_mm) == 1 and len(flown.every(3).spots_mm) == 2
