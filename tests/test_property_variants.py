"""A recording that differs from the simulation in one property alone: that property is named."""

import numpy as np
import pytest
from scipy import ndimage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.features import simulated_variants as properties
from virtual_phantom.features import extraction
from virtual_phantom.features.extraction import FEATURES
from virtual_phantom.statistics.attribution import attribute

GRID = Grid((12, 40, 40), (2.0, 1.5, 1.5), (3.0, -2.0, 50.0))
NOISE_HU = 12.0  # well under the structure's 40 HU: total variance alone cannot tell a blur from less noise


@pytest.fixture(scope="module")
def scene():
    """A structured object and two ROIs in it."""
    rng = np.random.default_rng(5)
    mean = 100 + 60 * ndimage.gaussian_filter(rng.normal(size=GRID.shape), 0.6)
    masks = {name: np.zeros(GRID.shape, bool) for name in ("left", "right")}
    masks["left"][2:10, 8:32, 4:18] = True
    masks["right"][2:10, 8:32, 22:36] = True
    mean[masks["right"]] += 40
    return mean, masks


def scans(mean, noise_hu=NOISE_HU, sigma=0.0, seed=0, repeats=6):
    noise = np.random.default_rng(seed).normal(size=(repeats, *GRID.shape))
    noise = np.stack([ndimage.gaussian_filter(one, sigma) for one in noise]) if sigma else noise
    return mean + noise_hu / noise.std() * noise


def features(images, masks):
    return extraction.extract_repeats(images, GRID, masks, "recorded")


RECORDED = {
    "noise amplitude": lambda mean: scans(mean, 2 * NOISE_HU, seed=1),
    "noise texture": lambda mean: scans(mean, sigma=0.7, seed=1),
    "resolution": lambda mean: scans(ndimage.gaussian_filter(mean, 0.7), seed=1),
    "contrast": lambda mean: scans(mean + 55, seed=1),
}


@pytest.mark.parametrize("name", RECORDED)
def test_the_property_that_differs_is_named_first(scene, name):
    mean, masks = scene
    recorded = features(RECORDED[name](mean), masks)
    made = properties.property_variants(scans(mean), GRID, masks, recorded)
    tables = {variant: extraction.extract_repeats(images, grid, own, variant) for variant, images, grid, own in made}
    found = attribute(tables, recorded, list(FEATURES), resamples=50).properties.query("family == 'all'")
    best = found.set_index("rank").loc[1]
    assert best["variant"].startswith(name) and best["median_removed_share"] > 0.5, found.to_string()


def test_the_noise_factor_leaves_structure_out(scene):
    mean, masks = scene
    recorded = features(scans(mean, 3 * NOISE_HU, seed=2), masks)
    assert properties.noise_factor(scans(mean), masks, recorded) == pytest.approx(3, rel=0.03)
    quiet = features(scans(0.2 * mean, 1.0, seed=2), masks)
    assert properties.noise_factor(scans(mean), masks, quiet) == 0


def test_other_voxels_hold_the_same_object(scene):
    mean, masks = scene
    recorded = features(scans(mean, seed=2), masks)
    made = properties.property_variants(scans(mean), GRID, masks, recorded, (1.0, 0.75, 0.75))
    images, grid, own = {name: rest for name, *rest in made}["voxels"]
    assert grid.spacing == (1.0, 0.75, 0.75) and images.shape[1:] == grid.shape
    for roi, mask in masks.items():
        assert own[roi].sum() * np.prod(grid.spacing) == pytest.approx(mask.sum() * np.prod(GRID.spacing), rel=0.05)
        assert images[:, own[roi]].mean() == pytest.approx(mean[mask].mean(), abs=4)
        centres = [
            np.argwhere(part).mean(axis=0)[::-1] * np.array(on.spacing[::-1]) + on.affine[:3, 3]
            for part, on in ((mask, GRID), (own[roi], grid))
        ]
        np.testing.assert_allclose(*centres, atol=0.1)


def test_what_a_recording_lacks_is_said(scene):
    mean, masks = scene
    recorded = features(scans(mean, seed=2), masks)
    with pytest.raises(InputError, match="lack original_firstorder_Variance"):
        next(properties.property_variants(scans(mean), GRID, masks, recorded.drop(columns=properties.VARIANCE)))
    with pytest.raises(InputError, match="no ROI left"):
        next(properties.property_variants(scans(mean), GRID, masks, recorded.query("roi == 'right'")))
