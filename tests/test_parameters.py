"""Parameter files of pyradiomics: values equal those of pyradiomics' command, and mistakes are one line."""

import json
import logging
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import SimpleITK as sitk
import yaml
from pyradiomics_batch import LABELS, PYRADIOMICS, SHAPE, SPACING_MM, label_map, scans
from radiomics import getParameterValidationFiles
from radiomics.featureextractor import RadiomicsFeatureExtractor
from scipy import ndimage

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.units import HU_AIR
from virtual_phantom.features import extraction, parameter_checks, settings, tables
from virtual_phantom.features.names import FEATURES, family, features_of
from virtual_phantom.features.parameters import DEFAULT, read_parameters
from virtual_phantom.features.settings import differences, distinct_extractions, read_extraction, read_extractions
from virtual_phantom.io.volumes import Volume

FILTERED = {
    "imageType": {"Original": {}, "Wavelet": {"wavelet": "haar"}, "LoG": {"sigma": [3.0], "binWidth": 5}},
    "featureClass": {"firstorder": ["Mean", "Entropy"], "glcm": None, "ngtdm": ["Busyness"], "shape": ["MeshVolume"]},
    "setting": {"binWidth": 10, "label": 1},
}
PREPARED = {
    "featureClass": {"firstorder": None, "glszm": None},
    "setting": {"resampledPixelSpacing": [2, 2, 2], "interpolator": "sitkLinear", "normalize": True, "binCount": 16},
}


def written(folder, content):
    path = folder / "parameters.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return str(path)


def test_default_settings_are_unchanged():
    """The hash of the default study, as in tables from before parameter files."""
    assert read_parameters(None) is DEFAULT and DEFAULT.features == FEATURES
    assert extraction.DEFAULT.hash() == "23e4155cfad53c0a"


@pytest.mark.parametrize("content", [FILTERED, PREPARED], ids=["filters", "resampled and normalised"])
def test_values_equal_those_of_pyradiomics_own_command(tmp_path, content):
    path = written(tmp_path, content)
    ((_, image),) = scans(tmp_path, doses=(10,), repeats=1).items()
    cases = [{"Image": image, "Mask": tmp_path / "labels.nii.gz", "Label": label} for label in LABELS.values()]
    pd.DataFrame(cases).to_csv(tmp_path / "cases.csv", index=False)
    command = [PYRADIOMICS, tmp_path / "cases.csv", "--param", path, "--format", "csv", "--out", tmp_path / "t.csv"]
    assert subprocess.run([str(one) for one in command], capture_output=True).returncode == 0
    theirs = pd.read_csv(tmp_path / "t.csv")

    parameters = read_parameters(path)
    array = sitk.GetArrayFromImage(sitk.ReadImage(str(image)))
    labels = label_map()
    masks = {name: labels == label for name, label in LABELS.items()}
    actual = extraction.extract(Volume(array, Grid(SHAPE, SPACING_MM[::-1])), masks, parameters=parameters)
    assert features_of(actual) == features_of(theirs) == list(parameters.features)
    pd.testing.assert_frame_equal(actual[features_of(actual)], theirs[features_of(actual)], rtol=1e-6, atol=1e-9)
    assert not differences(read_extraction(path), *distinct_extractions(read_extractions(theirs, "t.csv")))
    assert {family(name) for name in parameters.features} >= {"first order"}


def test_table_of_user_features_is_read_back_completely(tmp_path):
    parameters = read_parameters(written(tmp_path, FILTERED))
    image = np.random.default_rng(3).normal(0, 50, (12, 12, 12))
    mask = np.zeros(image.shape, bool)
    mask[3:9, 3:9, 3:9] = True
    found = extraction.extract(Volume(image, Grid(image.shape, (2.0, 2.0, 2.0))), {"spot": mask}, "i", parameters)
    acquisition = dict.fromkeys(tables.ACQUISITION, 1)
    table = tables.add_acquisition(found, {"spot": "tumour"}, acquisition)
    table.to_csv(tmp_path / "features.csv", index=False)
    back = tables.read_features(tmp_path / "features.csv")
    assert features_of(back) == list(parameters.features) and back["settings_hash"].iloc[0] == parameters.hash()
    (sub := tmp_path / "other").mkdir()
    other = read_parameters(written(sub, FILTERED | {"setting": {"binWidth": 11}}))
    assert other.features == parameters.features and other.hash() != parameters.hash()


def test_settings_of_a_filter_only_affect_its_features(tmp_path):
    actual = read_extraction(written(tmp_path, FILTERED))
    other = FILTERED | {"imageType": {"Original": {}, "Wavelet": {"wavelet": "db1"}, "LoG": {"binWidth": 7}}}
    found = {
        str(difference): difference for difference in differences(actual, read_extraction(written(tmp_path, other)))
    }
    assert set(found) == {"LoG: binWidth is 7, the study's 5", "Wavelet: wavelet is db1, the study's haar"}
    log, wavelet = (found[name] for name in sorted(found))
    assert log.changes("log-sigma-3-0-mm-3D_glcm_Idn") and not log.changes("log-sigma-3-0-mm-3D_firstorder_Mean")
    assert wavelet.changes("wavelet-LLH_firstorder_Mean")
    assert not log.changes("original_glcm_Idn") and not wavelet.changes("original_firstorder_Mean")


@pytest.mark.parametrize(
    "content, message",
    [
        ({"setting": {"binwidth": 10}}, "Key 'binwidth' was not defined. Path: '/setting'"),
        ({"setting": {"binWidth": "wide"}}, "Value 'wide' is not of type 'float'. Path: '/setting/binWidth'"),
        ({"imageType": {"Wavelets": {}}}, "Image Type Wavelets is not recognized"),
        ({"imageType": {"LoG": {}}}, "imageType LoG gives no features; complete its settings (LoG needs sigma)"),
        ({"featureClass": {"firstorder": ["Meen"]}}, "contains unrecognized features: {'Meen'}"),
        ({"featureClass": {"shape2D": None}}, "featureClass.shape2D needs regions of one slice; use shape"),
        ({"featureClass": {"shape2D": []}, "setting": {"force2D": True}}, "featureClass.shape2D needs regions of one"),
        ({"imageType": {"LoG": {"sigma": [3, 900]}}}, "imageType LoG: sigma 900 mm gives no features"),
        (
            {"imageType": {"Original": {"normalize": True}}},
            "imageType.Original.normalize is ignored by",
        ),
        ({"imageType": {"Wavelet": {"label": 2}}}, "imageType.Wavelet.label is ignored by pyradiomics"),
        ({"setting": {"binWidth": "5"}}, "setting.binWidth: '5' is text to YAML; write a number"),
        ("setting: {voxelArrayShift: 1, binWidth: 1e1}", "setting.binWidth: '1e1' is text to YAML"),
        ("setting: {binWidth: .inf}", "setting.binWidth is inf; give a finite number"),
        ({"setting": {"resampledPixelSpacing": [1, 1]}}, "setting.resampledPixelSpacing has 2 entries; give 3"),
        ({"setting": {"resegmentRange": [1, 2, 3]}}, "setting.resegmentRange has 3 entries; give the lower"),
        ({"setting": {"resegmentRange": [50], "resegmentMode": "relative"}}, "setting.resegmentRange holds fractions"),
        (
            {"setting": {"binCount": 100000}},
            "setting.binCount is 100000, which needs too much memory; give",
        ),
        ({"setting": {"distances": []}}, "setting.distances is empty; give distances in voxels, such as [1]"),
        ({"setting": {"kernelRadius": 2}}, "Key 'kernelRadius' was not defined"),
        (
            "setting:\n\tbinWidth: 5\n",
            "line 2: cannot be read as YAML (found character '\\t' that cannot start",
        ),
        ("setting: {binWidth: 5, binWidth: 6}", "setting.binWidth occurs twice, in lines 1 and 1"),
        ({"voxelSetting": {"kernelRadius": 2}}, "voxelSetting is for feature maps"),
        ({"settings": {"binWidth": 10}}, "Key 'settings' was not defined"),
        ("setting: [", "cannot be read as YAML"),
        ("", "is empty; give a parameter file of pyradiomics under features.parameters"),
    ],
)
def test_mistakes_are_one_line(tmp_path, content, message):
    path = written(tmp_path, content)
    with pytest.raises(InputError) as error:
        read_parameters(path)
    assert message in str(error.value) and str(error.value).startswith(path) and "\n" not in str(error.value)


def test_region_rejected_by_pyradiomics_is_named(tmp_path):
    parameters = read_parameters(written(tmp_path, {"setting": {"minimumROISize": 900}}))
    image = np.random.default_rng(3).normal(0, 50, (12, 12, 12))
    mask = np.zeros(image.shape, bool)
    mask[3:9, 3:9, 3:9] = True
    with pytest.raises(InputError, match="scan 7: ROI spot: pyradiomics fails with .*parameters.yaml: Size of the ROI"):
        extraction.extract(Volume(image, Grid(image.shape, (2.0, 2.0, 2.0))), {"spot": mask}, "scan 7", parameters)


def test_json_is_read_like_pyradiomics_reads_it(tmp_path):
    """With tabs, which YAML rejects."""
    content = {"featureClass": {"firstorder": ["Mean"]}, "setting": {"binWidth": 5}}
    path = written(tmp_path, json.dumps(content, indent="\t"))
    assert read_parameters(path).features == ("original_firstorder_Mean",)
    assert read_extraction(path).settings == {"binWidth": 5}


@pytest.mark.parametrize(
    "content, line",
    [
        (
            {"setting": {"normalizeScale": 100, "removeOutliers": 3}},
            "normalizeScale (without normalize), remove",
        ),
        ({"setting": {"interpolator": "sitkLinear"}}, "interpolator (without resampledPixelSpacing)"),
        (
            {"setting": {"resampledPixelSpacing": [2, 2, 2], "interpolator": None}},
            "resampledPixelSpacing (without an interpolator)",
        ),
        ({"setting": {"force2Ddimension": 2}}, "force2Ddimension (without force2D)"),
        ({"setting": {"resegmentShape": True}}, "resegmentShape (without resegmentRange)"),
        ({"setting": {"sigma": [2.0], "level": 2}}, "level (without imageType Wavelet), sigma (without imageType LoG)"),
        (
            {"setting": {"label": 2, "correctMask": True}},
            "correctMask (regions are masks on the image's own voxels), label",
        ),
        (
            {"setting": {"weightingNorm": "euclidean"}, "featureClass": {"firstorder": ["Mean"]}},
            "weightingNorm (no feature of the file depends on it)",
        ),
    ],
)
def test_settings_without_effect_are_noted_and_change_nothing(tmp_path, content, line, caplog):
    content = {"featureClass": {"firstorder": ["Mean", "Energy"], "glcm": ["Contrast"]}} | content
    path = written(tmp_path, content)
    with caplog.at_level(logging.WARNING):
        parameters = read_parameters(path)
    (note,) = [record.getMessage() for record in caplog.records]
    assert note.startswith(f"{path}: these settings have no effect: {line}")
    (plain := tmp_path / "plain").mkdir()
    alone = read_parameters(written(plain, {"featureClass": content["featureClass"]}))
    found, same = (extraction.extract(*spot(), "i", one)[list(alone.features)] for one in (parameters, alone))
    pd.testing.assert_frame_equal(found, same)


def spot():
    image = np.random.default_rng(3).normal(0, 50, (12, 12, 12))
    mask = np.zeros(image.shape, bool)
    mask[3:9, 3:9, 3:9] = True
    return Volume(image, Grid(image.shape, (2.0, 2.0, 2.0))), {"spot": mask}


def test_air_outside_of_boxes_does_not_change_resampled_features(tmp_path):
    content = {"featureClass": {"firstorder": ["Minimum", "Mean"]}, "setting": {"resampledPixelSpacing": [1.5] * 3}}
    parameters = read_parameters(written(tmp_path, content))
    volume, masks = spot()
    smooth = ndimage.gaussian_filter(volume.array, 2.0)
    box = (slice(1, 11),) * 3  # 4 mm more than the region
    array = np.full_like(smooth, HU_AIR)
    array[box] = smooth[box]
    expected, found, polluted = (
        extraction.extract(Volume(one, volume.grid), masks, "i", parameters, boxed).iloc[0]
        for one, boxed in ((smooth, False), (array, True), (array, False))
    )
    for name in parameters.features:
        assert found[name] == pytest.approx(expected[name], abs=0.2), name
        assert polluted[name] != pytest.approx(expected[name], abs=2), name


@pytest.mark.parametrize("content", [FILTERED, PREPARED], ids=["filters", "normalization"])
def test_boxes_are_rejected_where_features_need_whole_images(tmp_path, content):
    parameters = read_parameters(written(tmp_path, content))
    with pytest.raises(InputError, match=r"i: filters and normalization \(.*\) need whole images.*or `voxels`"):
        extraction.extract(*spot(), "i", parameters, boxed=True)


def test_settings_with_effect_are_not_noted(tmp_path, caplog):
    stated = {"normalize": True, "normalizeScale": 100, "binWidth": 5, "preCrop": False, "force2D": True}
    with caplog.at_level(logging.WARNING):
        read_parameters(written(tmp_path, {"setting": stated | {"force2Ddimension": 1, "weightingNorm": "euclidean"}}))
    assert not caplog.records


def test_every_setting_of_pyradiomics_is_known():
    """From the schema of the installed version: a new setting needs a decision."""
    schema = yaml.safe_load(Path(getParameterValidationFiles()[0]).read_text())["mapping"]
    known = (
        settings.DEFAULT_VALUES.keys()
        | settings.HARMLESS
        | parameter_checks.FILTER.keys()
        | parameter_checks.FOR_MASK_FILES
    )
    assert schema["setting"]["mapping"].keys() <= known
    assert set(schema) == {"setting", "voxelSetting", "featureClass", "imageType"}


def test_shape_in_2d_equals_that_of_pyradiomics(tmp_path):
    content = {"featureClass": {"shape2D": ["MeshSurface", "Perimeter"], "firstorder": ["Mean"]}}
    parameters = read_parameters(written(tmp_path, content), "largest")
    volume, masks = spot()
    found = extraction.extract(volume, masks, "i", parameters).iloc[0]
    images = [sitk.GetImageFromArray(one[3]) for one in (volume.array, masks["spot"].astype(np.uint8))]
    theirs = RadiomicsFeatureExtractor(content | {"imageType": {"Original": {}}}).execute(*images)
    assert len(parameters.features) == 3
    for name in parameters.features:
        assert found[name] == pytest.approx(float(theirs[name]), rel=1e-9), name
    with pytest.raises(InputError, match="featureClass.shape needs volumes; use shape2D"):
        (tmp_path / "3d").mkdir()
        read_parameters(written(tmp_path / "3d", {"featureClass": {"shape": None}}), "largest")
