"""Feature tables with a known difference: the changed property is named, and no other."""

import numpy as np
import pandas as pd
import pytest
from scipy import ndimage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.features import selection
from virtual_phantom.diagnosis.features.changes import property_tables, sampled
from virtual_phantom.diagnosis.features.properties import calibration, folds, properties
from virtual_phantom.diagnosis.features.responses import Curve, Responses, responses
from virtual_phantom.diagnosis.features.verdict import diagnose_features, misses, overlay
from virtual_phantom.features import extraction
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.features.names import MEAN

GRID = Grid((10, 36, 52), (2.0, 1.5, 1.5))
CLASSES = {"cyst_1": "cyst", "cyst_2": "cyst", "liver_1": "liver", "liver_2": "liver"}
HU = {"cyst_1": 20, "cyst_2": 45, "liver_1": 90, "liver_2": 130}
NOISE_HU = 15.0
REPEATS = 8
DRAWS = 199  # enough for 5 % over six properties


@pytest.fixture(autouse=True)
def fewer_realizations(monkeypatch):
    monkeypatch.setattr(selection, "DRAWS", DRAWS)


@pytest.fixture(scope="module")
def scene():
    """A structured object and four regions in it."""
    rng = np.random.default_rng(5)
    mean = 40 * ndimage.gaussian_filter(rng.normal(size=GRID.shape), 0.6)
    masks = {roi: np.zeros(GRID.shape, bool) for roi in CLASSES}
    for roi, (y, x) in zip(CLASSES, ((2, 2), (19, 2), (2, 28), (19, 28)), strict=True):
        masks[roi][1:9, y : y + 15, x : x + 22] = True
        mean[masks[roi]] += HU[roi]
    return mean, masks


def scans(mean, noise_hu=NOISE_HU, sigma=0.0, seed=0):
    noise = np.random.default_rng(seed).normal(size=(REPEATS, *GRID.shape))
    noise = np.stack([ndimage.gaussian_filter(one, sigma) for one in noise])
    return mean + noise_hu / noise.std() * noise


def blurred(images, sigma):
    """Blur by a Gaussian in frequency; a sampled Gaussian of half a voxel would have a standard deviation of 0.46
    voxels.
    """
    return np.fft.ifftn(ndimage.fourier_gaussian(np.fft.fftn(images), sigma)).real


def recording(images, masks):
    table = extraction.extract_repeats(images, GRID, masks, "recorded")
    return table.assign(tissue_class=table["roi"].map(CLASSES))


@pytest.fixture(scope="module")
def tables(scene):
    """Tables of the simulation with every property changed; the recording is only used for the HU calibration."""
    mean, masks = scene
    recorded = recording(scans(mean + 30, seed=1), masks)
    made = pd.concat(property_tables(scans(mean), GRID, masks, folds(CLASSES), recorded), ignore_index=True)
    return made.assign(tissue_class=made["roi"].map(CLASSES))


def diagnosed(tables, recorded):
    data = responses(tables, recorded, FEATURES, GRID)
    return data, diagnose_features("test", data, {}).content


def test_equal_tables_are_a_match(scene, tables):
    mean, masks = scene
    _, found = diagnosed(tables, recording(scans(mean, seed=1), masks))
    assert found["verdict"] == "match", found["sentence"]
    assert found["locations"] == found["effects"] == found["unexplained"] == []


CHANGED = {
    "resolution": (lambda mean: scans(ndimage.gaussian_filter(mean, 0.55), seed=1), {"sigma_voxels": 0.55}),
    "noise_texture": (lambda mean: scans(mean, sigma=0.6, seed=1), {"sigma_voxels": 0.6}),
    "photon_flux": (lambda mean: scans(mean, 1.6 * NOISE_HU, seed=1), {"factor": 1.6**-2}),
    "hu_calibration": (lambda mean: scans(mean + 30, seed=1), {"offset_hu": 30, "scale": 1}),
    "reconstruction_kernel": (
        lambda mean: blurred(scans(mean, seed=1), (0, 0, 0.5, 0.5)),
        {"sigma_mm": 0.75},
    ),
}


@pytest.fixture(scope="module", params=CHANGED)
def changed(request, scene, tables):
    """A changed property, the data and the diagnosis."""
    mean, masks = scene
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "DRAWS", DRAWS)
        return request.param, *diagnosed(tables, recording(CHANGED[request.param][0](mean), masks))


def test_the_property_that_was_changed_is_named(changed):
    name, data, found = changed
    truth = CHANGED[name][1]
    assert found["verdict"] in ("mismatch explained", "mismatch partly explained"), found["sentence"]
    assert found["effects"][0]["name"] == name, found["candidates"]
    # The mean of eight repeats has an eighth of the noise variance, which no change of the noise alone reaches.
    assert found["excess_removed"] > 0.5, found["candidates"]
    squares = found["held_out"]["mean_squared_shift"]
    assert squares["after"] < 0.25 * squares["before"]
    for key, value in truth.items():
        low, high = found["effects"][0]["parameters"][key]["ci95"]
        # Features are interpolated between simulated strengths: within a step of the truth.
        assert low - 0.12 * abs(value) - 0.02 <= value <= high + 0.12 * abs(value) + 0.02, (key, low, high)
    expected = {name} if name in ("photon_flux", "hu_calibration", "reconstruction_kernel") else set()
    assert set(overlay(data, found)["physics"]) == expected


def test_repair_removes_most_mismatches_in_held_out_regions(changed):
    name, _, found = changed
    counts = {one: candidate["families"]["all"] for one, candidate in found["candidates"].items()}
    assert len({(count["cells"], count["misses"]) for count in counts.values()}) == 1
    best = max(counts, key=lambda one: (counts[one]["repaired"], counts[one]["median_removed_share"]))
    assert best == name and counts[name]["median_removed_share"] > 0.5, counts


def test_mismatches_are_counted_by_family(scene, tables):
    mean, masks = scene
    recorded = recording(scans(mean + 30, seed=1), masks)
    data, found = diagnosed(tables, recorded)
    families = found["candidates"]["hu_calibration"]["families"]
    assert next(iter(families)) == "all" and families["all"]["cells"] == len(data.rois) * len(data.features)
    for key in ("cells", "misses", "repaired", "broken"):
        assert families["all"][key] == sum(one[key] for family, one in families.items() if family != "all")
    column = data.features.index(MEAN)
    means = {"recorded": data.center[:, column], "simulated": data.baseline[..., column].mean(axis=0)}
    missed = np.abs(means["simulated"] - means["recorded"]) > data.unit[:, column]
    assert missed.all()  # by 30 HU, and each is repaired
    unchanged = misses(data, data.baseline, 1.0)["all"]
    assert unchanged["repaired"] == unchanged["broken"] == unchanged["median_removed_share"] == 0
    exact = np.broadcast_to(data.center, data.baseline.shape)
    assert misses(data, exact, 1.0)["all"]["repaired"] == unchanged["misses"]
    assert misses(data, exact, 1.0)["all"]["median_removed_share"] == 1
    assert misses(data, data.baseline, 1e9)["all"] == {
        **{"cells": unchanged["cells"], "misses": 0, "repaired": 0, "broken": 0},
        "median_removed_share": None,
    }


def test_coarser_and_finer_voxels_hold_the_same_object(scene):
    mean, masks = scene
    mean = 100 + mean - sum(HU[roi] * mask for roi, mask in masks.items())  # no steps: voxels at edges mix little
    images, grid, own_masks = sampled(scans(mean, seed=2), GRID, masks, (1.0, 0.75, 0.75))
    assert grid.spacing == (1.0, 0.75, 0.75) and images.shape[1:] == grid.shape
    for roi, mask in masks.items():
        assert own_masks[roi].sum() * np.prod(grid.spacing) == pytest.approx(
            mask.sum() * np.prod(GRID.spacing), rel=0.05
        )
        assert images[:, own_masks[roi]].mean() == pytest.approx(mean[mask].mean(), abs=4)
        centres = [
            np.argwhere(part).mean(axis=0)[::-1] * np.array(on.spacing[::-1]) + on.affine[:3, 3]
            for part, on in ((mask, GRID), (own_masks[roi], grid))
        ]
        np.testing.assert_allclose(*centres, atol=0.1)


@pytest.mark.parametrize("alike", [True, False], ids=["alike in all regions", "apart in every region"])
def test_random_offsets_are_unexplained(scene, tables, alike):
    mean, masks = scene
    recorded = recording(scans(mean, seed=1), masks)
    rng = np.random.default_rng(3)
    spread = recorded.groupby("roi")[list(FEATURES)].std()
    offsets = {roi: rng.normal(size=len(FEATURES)) for roi in CLASSES}
    for roi in CLASSES:
        rows = recorded["roi"] == roi
        offset = 8 * offsets["cyst_1" if alike else roi] * spread.loc[roi].to_numpy()
        recorded.loc[rows, list(FEATURES)] += offset
    _, found = diagnosed(tables, recorded)
    assert found["verdict"] == "unexplained", found["sentence"]
    assert found["effects"] == [] and found["excess_removed"] is None and found["next_measurement"]


def test_calibration_of_recordings_without_compared_means_has_no_values():
    rng, rois = np.random.default_rng(7), list(CLASSES)
    features = [feature for feature in FEATURES if feature != MEAN][:30]
    baseline = rng.normal(size=(REPEATS, len(rois), len(features)))
    recorded = [rng.normal(5.0, 1.0, (REPEATS, len(features))) for _ in rois]
    (calibrated,) = (one for one in properties() if one.name == "hu_calibration")
    curve = Curve(np.array([0.0, 1.0]), np.stack([baseline, baseline + 5]))
    fold = np.array([folds(CLASSES)[roi] for roi in rois])
    data = Responses(rois, features, CLASSES, fold, recorded, baseline, {calibrated: {1: curve, 2: curve}})
    found = diagnose_features("test", data, {}).content
    (effect,) = found["effects"]
    assert effect["name"] == "hu_calibration" and effect["parameters"] == {}
    assert overlay(data, found) == {"physics": {}}


def test_recording_without_means_is_refused_before_features_are_extracted(scene):
    mean, masks = scene
    recorded = pd.DataFrame({"roi": list(CLASSES), "tissue_class": list(CLASSES.values())})
    with pytest.raises(InputError, match=f"recorded features: lack {MEAN}"):
        next(property_tables(scans(mean), GRID, masks, folds(CLASSES), recorded))


def test_folds_hold_every_class_that_has_two_regions():
    fold_of = folds(CLASSES)
    assert all({fold_of[f"{name}_1"], fold_of[f"{name}_2"]} == {1, 2} for name in ("cyst", "liver"))
    with pytest.raises(InputError, match="1 ROI to compare"):
        folds({"cyst_1": "cyst"})


def test_hu_calibration_is_the_line_through_the_means():
    simulated = np.array([0.0, 50.0, 100.0])
    assert calibration(simulated, 1.05 * simulated - 12) == pytest.approx({"scale": 1.05, "offset_hu": -12})
    assert calibration(simulated[:2], simulated[:2] + 7) == pytest.approx({"scale": 1.0, "offset_hu": 7})
