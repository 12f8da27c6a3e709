"""Extraction settings as an axis: values equal those of pyradiomics with the setting, and mistakes are one line."""

import copy
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
import yaml
from radiomics.featureextractor import RadiomicsFeatureExtractor

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.config.config import check, read_study
from virtual_phantom.config.plan import Plan
from virtual_phantom.features import extraction
from virtual_phantom.features.names import FEATURES, NAMES
from virtual_phantom.features.parameters import DEFAULT, read_parameters, vary
from virtual_phantom.features.settings import SETTINGS, STUDY, Extraction
from virtual_phantom.features.variations import Variation, variations
from virtual_phantom.io.volumes import Volume
from virtual_phantom.reconstruction.boxes import boxes_around
from virtual_phantom.study.checks.preflight import problems

ROOT = Path(__file__).resolve().parents[1]
STUDY_FILE = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
SPACING = (2.0, 1.2, 1.2)  # z, y, x


@pytest.fixture(scope="module")
def scanned():
    """A noisy image with structure, and an ellipsoid that is not in its middle."""
    z, y, x = np.indices((20, 40, 44))
    image = np.random.default_rng(3).normal(60, 30, z.shape) + 40 * np.sin(x / 3) + 3 * z
    mask = ((z - 8) / 5) ** 2 + ((y - 22) / 11) ** 2 + ((x - 18) / 9) ** 2 < 1
    return Volume(image.astype(np.float32), Grid(z.shape, SPACING)), mask


def of_pyradiomics(array, mask, spacing, **settings):
    images = [sitk.GetImageFromArray(part) for part in (array, mask.astype(np.uint8))]
    for image in images:
        image.SetSpacing(spacing[::-1])
    extractor = RadiomicsFeatureExtractor(**{**SETTINGS, **settings})
    extractor.disableAllFeatures()
    extractor.enableFeaturesByName(**{family: names.split() for family, names in NAMES.items()})
    found = extractor.execute(*images)
    return [float(found[feature]) for feature in FEATURES]


def extracted(scanned, variation, parameters=DEFAULT, **options):
    volume, mask = scanned
    return extraction.extract(volume, {"roi": mask}, parameters=vary(parameters, variation), **options)


@pytest.mark.parametrize(
    "factor, value, settings",
    [
        ("bin_width", 10, {"binWidth": 10}),
        ("bin_count", 32, {"binCount": 32}),
        ("resampled_mm", 1.5, {"resampledPixelSpacing": [1.5, 1.5, 1.5]}),
        ("resampled_mm", 2, {"resampledPixelSpacing": [2, 2, 2]}),
        ("dimensions", "2d", {"force2D": True, "force2Ddimension": 0}),
    ],
)
def test_values_equal_those_of_pyradiomics(scanned, factor, value, settings):
    volume, mask = scanned
    actual = extracted(scanned, Variation(factor, value))
    np.testing.assert_allclose(
        actual[list(FEATURES)].to_numpy()[0], of_pyradiomics(volume.array, mask, SPACING, **settings), rtol=1e-9
    )
    assert not np.allclose(actual[list(FEATURES)].to_numpy()[0], of_pyradiomics(volume.array, mask, SPACING))


@pytest.mark.parametrize(
    "factor, value, spacing", [("dimensions", "largest", (1, 1)), ("resampled_mm", 2, SPACING[1:])]
)
def test_largest_section_equals_pyradiomics_in_2d(scanned, factor, value, spacing):
    """Its pixels have side 1, but their true size in mm when they are resampled."""
    volume, mask = scanned
    own = DEFAULT if factor == "dimensions" else read_parameters(None, "largest")
    actual = extracted(scanned, Variation(factor, value), own)
    largest = mask.sum(axis=(1, 2)).argmax()
    settings = {"resampledPixelSpacing": [2, 2]} if factor == "resampled_mm" else {}
    wanted = of_pyradiomics(volume.array[largest], mask[largest], spacing, **settings)
    np.testing.assert_allclose(actual[list(FEATURES)].to_numpy()[0], wanted, rtol=1e-9)


def test_slices_are_resampled_in_plane_if_textures_are_in_slices(scanned):
    own = Extraction(SETTINGS | {"force2D": True})
    changed, _ = Variation("resampled_mm", 2).apply(own, "whole")
    assert changed.settings["resampledPixelSpacing"] == [2, 2, 0]


def test_voxels_are_counted_after_resampling(scanned):
    volume, mask = scanned
    coarse = extracted(scanned, Variation("resampled_mm", 3))["n_voxels"][0]
    assert coarse == pytest.approx(mask.sum() * np.prod(SPACING) / 27, rel=0.1)


def test_resampling_does_not_see_the_air_around_boxes(scanned):
    """An image in boxes gives nearly the values of the whole image; with the air outside, they differ much more."""
    volume, mask = scanned
    (box,) = boxes_around([mask], volume.grid)
    boxed = np.full_like(volume.array, -1000)
    boxed[box] = volume.array[box]
    variation, inside = Variation("resampled_mm", 2), (Volume(boxed, volume.grid), mask)
    wanted = extracted(scanned, variation)["original_firstorder_Minimum"][0]
    kept = extracted(inside, variation, boxed=True)["original_firstorder_Minimum"][0]
    seen = extracted(inside, variation)["original_firstorder_Minimum"][0]
    assert abs(kept - wanted) < 3 and abs(kept - wanted) < abs(seen - wanted)


def test_settings_have_their_own_hash():
    hashes = {vary(DEFAULT, Variation("bin_width", width)).hash() for width in (10, 25, 50)} | {DEFAULT.hash()}
    assert len(hashes) == 4 and DEFAULT.hash() == "23e4155cfad53c0a"


def test_own_settings_are_not_extracted_again():
    values = {"bin_width": [10, 25, 12.5], "bin_count": [32], "resampled_mm": ["none", 1], "dimensions": ["2d", "3d"]}
    found = list(variations(values, STUDY, "whole"))
    assert found == ["bin_width_10", "bin_width_12p5", "bin_count_32", "resampled_mm_1", "dimensions_2d"]
    flat = list(variations({"dimensions": ["2d", "3d", "largest"]}, STUDY, "largest"))
    assert flat == ["dimensions_2d", "dimensions_3d"]
    counted = Extraction(SETTINGS | {"binCount": 32})
    assert list(variations(values, counted, "whole"))[:3] == ["bin_width_10", "bin_width_25", "bin_width_12p5"]


def test_a_region_that_is_too_small_for_the_voxels_is_named(scanned):
    with pytest.raises(
        InputError, match=r"image: ROI roi: pyradiomics fails with analyses.extraction \(resampled_mm: 60"
    ):
        extracted(scanned, Variation("resampled_mm", 60))


def with_axis(axis, **more):
    config = copy.deepcopy(STUDY_FILE)
    config["analyses"]["extraction"] = axis
    return config | more


def test_axis_extracts_images_of_the_study_only():
    """The default images are those of the stability analysis: no further scan, and the same bundles of jobs."""
    before, plan = Plan(read_study(STUDY_FILE)), Plan(read_study(with_axis({"bin_width": [10, 25]})))
    assert plan.acquisitions() == before.acquisitions() and plan.bundles() == before.bundles()
    assert plan.extracted_images() == [(protocol, "dose10") for protocol in plan.groups()]
    assert list(plan.variations) == ["bin_width_10"]
    chosen = Plan(read_study(with_axis({"bin_count": [8], "protocols": ["fbp_150"], "noise": ["dose10", "double"]})))
    assert chosen.extracted_images() == [("fbp_150", "dose10"), ("fbp_150", "double")]


@pytest.mark.parametrize(
    "axis, message",
    [
        ({}, "analyses.extraction"),
        ({"bin_widht": [10]}, "unknown key 'bin_widht' in analyses.extraction; did you mean 'bin_width'"),
        ({"bin_width": []}, "analyses.extraction.bin_width"),
        ({"bin_width": [0]}, "analyses.extraction.bin_width.0: 0 is less than or equal to the minimum of 0"),
        ({"bin_width": [10, 10]}, "analyses.extraction.bin_width"),
        ({"bin_count": [1]}, "analyses.extraction.bin_count.0: 1 is less than the minimum of 2"),
        ({"bin_count": [32.5]}, "analyses.extraction.bin_count.0: 32.5"),
        ({"dimensions": ["4d"]}, "analyses.extraction.dimensions.0 is '4d'; use one of 2d, 3d, largest"),
        ({"resampled_mm": ["half"]}, "analyses.extraction.resampled_mm holds 'half'; give lengths in mm or none"),
        ({"resampled_mm": [-1]}, "analyses.extraction.resampled_mm.0: -1 is less than or equal to the minimum of 0"),
        (
            {"resampled_mm": [0.1]},
            "resampled_mm holds 0.1, less than every voxel side of protocol sirt_150; give at",
        ),
        ({"protocols": ["fbp_150"]}, "analyses.extraction varies no setting; give one of bin_width, bin_count"),
        ({"bin_width": [10], "protocols": ["fbp"]}, "analyses.extraction.protocols names 'fbp', which does not exist"),
        ({"bin_width": [10], "noise": ["dose"]}, "analyses.extraction.noise names 'dose', which does not exist"),
    ],
)
def test_mistakes_are_one_line(axis, message):
    with pytest.raises(InputError) as error:
        check(with_axis(axis))
    assert message in str(error.value) and "\n" not in str(error.value)


def test_an_axis_without_a_difference_is_reported():
    assert problems(with_axis({"bin_width": [25], "resampled_mm": ["none"]})) == [
        "config: analyses.extraction has only the settings of features; add a value that differs, or remove it"
    ]


def test_bins_of_an_image_type_are_not_overridden(tmp_path):
    content = {"imageType": {"Original": {"binWidth": 5}}, "featureClass": {"glcm": None}}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(content))
    features = {"parameters": str(tmp_path / "own.yaml")}
    (line,) = problems(with_axis({"bin_width": [10]}, features=features))
    assert line.startswith("features.parameters: imageType.Original has its own bins, and analyses.extraction varies")
    assert problems(with_axis({"dimensions": ["2d"]}, features=features)) == []
