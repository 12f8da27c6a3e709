"""Features of a region's largest section, as in CT-Phantom4Radiomics, compared with direct calls of pyradiomics."""

import numpy as np
import pytest
import SimpleITK as sitk
from radiomics.featureextractor import RadiomicsFeatureExtractor

from virtual_phantom.base.geometry import Grid
from virtual_phantom.features.extraction import FEATURES, extract
from virtual_phantom.features.parameters import DEFAULT, read_parameters
from virtual_phantom.features.settings import CUSTOM_PREFIX
from virtual_phantom.io.volumes import Volume

GRID = Grid((5, 24, 26), (2.0, 0.7, 0.7))


@pytest.fixture(scope="module")
def scan():
    """An image and a region whose slices 1, 2 and 3 have 80, 130 and 99 voxels."""
    image = np.random.default_rng(6).normal(40, 30, GRID.shape).round().astype(np.int16)
    mask = np.zeros(GRID.shape, bool)
    mask[1, 4:12, 5:15] = mask[2, 4:14, 5:18] = mask[3, 3:12, 5:16] = True
    return Volume(image, GRID), mask


def direct_features(pixels, region):
    extractor = RadiomicsFeatureExtractor(binWidth=25)
    extractor.disableAllFeatures()
    for name in ("firstorder", "glcm", "glrlm", "glszm", "gldm"):
        extractor.enableFeatureClassByName(name)
    images = [sitk.GetImageFromArray(array) for array in (pixels.astype(np.float64), region.astype(np.uint8))]
    return extractor.execute(*images)


@pytest.mark.parametrize("offset", [0, 1024])
def test_largest_section_is_extracted_in_two_dimensions(scan, offset):
    volume, mask = scan
    row = extract(volume, {"a": mask}, parameters=read_parameters(None, "largest", offset)).iloc[0]
    expected = direct_features(volume.array[2] + offset, mask[2])
    in_hu = direct_features(volume.array[2], mask[2])
    assert row["n_voxels"] == 130 and len(FEATURES) == 86
    for feature in FEATURES:
        moved = "firstorder" in feature and not feature.endswith(("_Entropy", "_Uniformity"))
        assert row[feature] == pytest.approx((in_hu if moved else expected)[feature], rel=1e-9), feature


def test_margin_of_one_voxel_has_no_effect(scan):
    """Voxels above and below the section do not count."""
    volume, mask = scan
    other = volume.array.copy()
    other[[0, 1, 3, 4]] = 500
    one, two = (
        extract(Volume(a, GRID), {"a": mask}, parameters=read_parameters(None, "largest"))
        for a in (volume.array, other)
    )
    assert one[list(FEATURES)].equals(two[list(FEATURES)])


def test_settings_state_the_section():
    hashes = {
        read_parameters(None, *one).hash() for one in [("whole", 0), ("largest", 0), ("largest", 1024), ("whole", 1024)]
    }
    assert len(hashes) == 4 and DEFAULT.hash() in hashes
    assert all(one.startswith(CUSTOM_PREFIX) for one in hashes - {DEFAULT.hash()})
