"""Parameter files of pyradiomics: values are those of its own command, mistakes are told in one line."""

import subprocess

import numpy as np
import pandas as pd
import pytest
import SimpleITK as sitk
import yaml
from pyradiomics_batch import LABELS, PYRADIOMICS, SHAPE, SPACING_MM, label_map, scans

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.features import extraction, tables
from virtual_phantom.features.names import FEATURES, family, features_of
from virtual_phantom.features.parameters import DEFAULT, read_parameters
from virtual_phantom.features.settings import differences, distinct, of_parameters, of_table
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


def test_without_a_file_nothing_has_changed():
    """The hash of the default study, as tables made before there were parameter files have it."""
    assert read_parameters(None) is DEFAULT and DEFAULT.features == FEATURES
    assert extraction.settings_hash() == "23e4155cfad53c0a"


@pytest.mark.parametrize("content", [FILTERED, PREPARED], ids=["filters", "resampled and normalised"])
def test_values_are_those_of_pyradiomics_own_command(tmp_path, content):
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
    ours = extraction.extract(Volume(array, Grid(SHAPE, SPACING_MM[::-1])), masks, parameters=parameters)
    assert features_of(ours) == features_of(theirs) == list(parameters.features)
    pd.testing.assert_frame_equal(ours[features_of(ours)], theirs[features_of(ours)], rtol=1e-6, atol=1e-9)
    assert not differences(of_parameters(path), *distinct(of_table(theirs, "t.csv")))
    assert {family(name) for name in parameters.features} >= {"first order"}


def test_a_table_of_own_features_is_read_back_whole(tmp_path):
    parameters = read_parameters(written(tmp_path, FILTERED))
    image = np.random.default_rng(3).normal(0, 50, (12, 12, 12))
    mask = np.zeros(image.shape, bool)
    mask[3:9, 3:9, 3:9] = True
    found = extraction.extract(Volume(image, Grid(image.shape, (2.0, 2.0, 2.0))), {"spot": mask}, "i", parameters)
    acquisition = dict.fromkeys(tables.ACQUISITION, 1)
    table = tables.complete(found, {"spot": "tumour"}, acquisition)
    table.to_csv(tmp_path / "features.csv", index=False)
    back = tables.read(tmp_path / "features.csv")
    assert features_of(back) == list(parameters.features) and back["settings_hash"].iloc[0] == parameters.hash()
    (sub := tmp_path / "other").mkdir()
    other = read_parameters(written(sub, FILTERED | {"setting": {"binWidth": 11}}))
    assert other.features == parameters.features and other.hash() != parameters.hash()


def test_settings_of_a_filter_concern_its_features_alone(tmp_path):
    ours = of_parameters(written(tmp_path, FILTERED))
    other = FILTERED | {"imageType": {"Original": {}, "Wavelet": {"wavelet": "db1"}, "LoG": {"binWidth": 7}}}
    found = {str(one): one for one in differences(ours, of_parameters(written(tmp_path, other)))}
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
        ({"featureClass": {"shape2D": None}}, "asks for no feature"),
        ({"voxelSetting": {"kernelRadius": 2}}, "voxelSetting is of feature maps"),
        ({"settings": {"binWidth": 10}}, "Key 'settings' was not defined"),
        ("setting: [", "cannot be read as YAML"),
        ("", "holds none of imageType, featureClass, setting"),
    ],
)
def test_mistakes_are_one_line(tmp_path, content, message):
    path = written(tmp_path, content)
    with pytest.raises(InputError) as error:
        read_parameters(path)
    assert message in str(error.value) and str(error.value).startswith(path) and "\n" not in str(error.value)


def test_a_region_that_pyradiomics_refuses_is_named(tmp_path):
    parameters = read_parameters(written(tmp_path, {"setting": {"minimumROISize": 900}}))
    image = np.random.default_rng(3).normal(0, 50, (12, 12, 12))
    mask = np.zeros(image.shape, bool)
    mask[3:9, 3:9, 3:9] = True
    with pytest.raises(
        InputError, match="scan 7: ROI spot: pyradiomics, as .*parameters.yaml sets it: Size of the ROI"
    ):
        extraction.extract(Volume(image, Grid(image.shape, (2.0, 2.0, 2.0))), {"spot": mask}, "scan 7", parameters)
