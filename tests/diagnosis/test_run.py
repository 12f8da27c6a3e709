"""The same diagnosis of user recordings and of the blind validation.

A verdict depends on the recording, and not on earlier fits, processes or files.
"""

import json

import numpy as np
import pytest
from simulated_scans import body, noisy_lines

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.fitting.linearization import BASE, Linearization, LinearizationPoint
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.selection import trials
from virtual_phantom.diagnosis.selection.fit_cache import FitCache
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.scene import VoxelScene

PHOTONS = 1e5
ACCURACY = {"default": 0.15, "numerical": 0.1}
CANDIDATES = ("focal_spot", "scatter", "detector_offset")
GEOMETRY = circular(
    views=48,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=40,
    rows=4,
    column_pitch_mm=12.0,
    row_pitch_mm=12.0,
    view_interval_ms=10.0,
)


@pytest.fixture(scope="module")
def scene():
    grid = Grid((14, 48, 48), (4.0, 5.0, 5.0))
    volume = body(grid, (100, 75), 20.0, [((45, 10, 5), 18, 800.0), ((-40, -20, -5), 16, -80.0)])
    return VoxelScene.of(volume, Segmentation(), 0.0193)


def ready(scene, physics, seed=5):
    """Prepared recording with this physics; nothing has been computed with its model yet."""
    state = Chain(scene, GEOMETRY, PHOTONS).state(physics)
    lines = noisy_lines(state, 4, np.random.default_rng(seed)).astype(np.float32)
    white = state.measured_air.mean(axis=0) * state.photons
    taken = observed.Scans(lines, white, np.ones(lines[0].shape, bool))
    chain, floor = model_and_floor(scene, GEOMETRY, 1, photons=PHOTONS)
    return prepared.prepare(taken, None, chain, nominal_photons=PHOTONS, floor_chain=floor)


def written(content):
    return json.dumps(content, indent=1, allow_nan=False)


def test_verdict_is_the_same_in_several_processes_and_from_cached_fits(scene, tmp_path, monkeypatch):
    """The blind validation caches no fits and runs them in turn.

    A user's diagnosis has processes and may be interrupted.
    """
    physics = {"scatter": {"amount": 0.03, "width_mm": 60.0}, "detector_offset": {"columns_px": 0.05}}
    stored = FitCache(tmp_path, "this recording", lambda effect: "as it is")
    at_once = find_missing_physics("bench", ready(scene, physics), CANDIDATES, ACCURACY, processes=2, cache=stored)
    assert {effect["name"] for effect in at_once.content["effects"]} == set(physics)
    files = {path.name for path in tmp_path.glob("*.json")}
    # A focal spot has no first-order gain and is not fitted alone.
    assert {"alignment.json", "scatter.json", "detector_offset.json"} < files and "focal_spot.json" not in files
    assert any("+" in name for name in files)
    assert set(at_once.choice.alone) == set(CANDIDATES) and set(at_once.choice.singles) == set(physics)

    in_turn = find_missing_physics("bench", ready(scene, physics), CANDIDATES, ACCURACY)
    made = []
    monkeypatch.setattr(trials, "trial", lambda *task, **more: made.append(task[1]) or trial(*task, **more))
    (tmp_path / "scatter.json").write_text("{")  # like a full disk
    (tmp_path / "detector_offset.json").unlink()
    gone_on = find_missing_physics("bench", ready(scene, physics), CANDIDATES, ACCURACY, cache=stored)
    assert set(made) == {("detector_offset",), ("scatter",)} and len(made) == 2
    for other in (in_turn, gone_on):
        assert written(other.content) == written(at_once.content)
        for here, there in zip(other.after, at_once.after, strict=True):
            np.testing.assert_array_equal(here.map, there.map)


def test_cached_fit_is_used_for_its_own_inputs_only(scene, tmp_path):
    fitter = ready(scene, {}).fitter
    baseline = trial(fitter, ())
    stored = FitCache(tmp_path, "this recording", lambda effect: "as it is")
    stored.put(baseline, ("scatter",), baseline, baseline)
    request = ("scatter",), baseline, baseline
    assert stored.get(*request).fit == baseline.fit
    assert stored.get(("scatter",), None, baseline) is None and stored.get(("heel",), baseline, baseline) is None
    assert FitCache(tmp_path, "another recording", stored.code).get(*request) is None
    assert FitCache(tmp_path, "this recording", lambda effect: f"{effect}, mended").get(*request) is None


SETTINGS = (
    ({}, {"x_mm": 0.4}),
    ({"focal_spot": {"width_mm": 2.0, "length_mm": 1.0}}, {"x_mm": 0.401, "turn_deg": 0.003}),
    ({"detector_offset": {"columns_px": 0.02}}, {"y_mm": -0.2}),
    ({"motion": load("motion").values({"x_mm_per_s": 1.0})}, {"x_mm": 0.402}),
)


def test_predictions_do_not_depend_on_earlier_calls(scene):
    fresh, used = (ready(scene, {}) for _ in range(2))
    expected = {one.name: one.expected for one in fresh.fitter.model.base_nuisances}
    points = [LinearizationPoint(physics, {"x_mm": 0.4, **off}) for physics, off in SETTINGS[:2]]
    places = [BASE, *(Linearization(BASE.errors, rays) for rays in points)]

    def predicted(one, settings, place):
        physics, off = settings
        return one.fitter.model.predict(physics, expected | off, one.data, place).mean

    request = [(settings, place) for settings in SETTINGS for place in places]
    for one in reversed(request):
        predicted(used, *one)
    for one in request:
        np.testing.assert_array_equal(predicted(fresh, *one), predicted(used, *one))
    # Displaced rays are not traced again. The traced rays from which they are displaced must not depend on the call
    # order.
    near, far = (predicted(fresh, ({}, {"x_mm": 0.41}), place) for place in (places[1], BASE))
    assert not np.array_equal(near, far)
    assert np.abs(near - far).max() < 1e-3
