"""Parameter file of chosen features, read by pyradiomics."""

import numpy as np
import pytest
import SimpleITK
import yaml
from radiomics.featureextractor import RadiomicsFeatureExtractor

from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.features.selected import selected_parameters
from virtual_phantom.features.settings import read_extraction

WHOLE = {"section": "whole", "stored_offset_hu": 0}
CHOSEN = ["original_firstorder_Mean", "original_glcm_Idn", "original_firstorder_10Percentile"]


@pytest.fixture
def written(tmp_path):
    def write(features, parameters=WHOLE, path=None):
        file = tmp_path / "robust.yaml"
        file.write_text(selected_parameters(features, read_extraction(path), parameters))
        return file

    return write


def extracted(file):
    rng = np.random.default_rng(0)
    image = SimpleITK.GetImageFromArray(rng.normal(0, 60, (8, 8, 8)))
    mask = SimpleITK.GetImageFromArray(np.pad(np.ones((6, 6, 6), np.uint8), 1))
    return RadiomicsFeatureExtractor(str(file)).execute(image, mask)


def test_pyradiomics_extracts_the_chosen_features_only(written):
    assert sorted(name for name in extracted(written(CHOSEN)) if name.startswith("original")) == sorted(CHOSEN)


def test_study_can_be_repeated_with_the_file(written):
    assert set(read_parameters(str(written(CHOSEN))).features) == set(CHOSEN)


def test_settings_and_filters_of_the_study_are_kept(written, tmp_path):
    own = tmp_path / "own.yaml"
    own.write_text("imageType: {Original: {}, Wavelet: {}}\nfeatureClass: {firstorder: }\nsetting: {binWidth: 10}\n")
    features = ["original_firstorder_Mean", "wavelet-LLH_firstorder_Mean", "wavelet-LLH_firstorder_Entropy"]
    content = yaml.safe_load(written(features, path=str(own)).read_text())
    assert content["setting"] == {"binWidth": 10} and set(content["imageType"]) == {"Original", "Wavelet"}
    assert content["featureClass"] == {"firstorder": ["Mean", "Entropy"]}


def test_what_the_file_cannot_hold_is_a_comment(written):
    text = written(CHOSEN, {"section": "largest", "stored_offset_hu": 1024}).read_text()
    assert "# Extract from the largest axial section" in text and "# Add 1024 to the image in HU" in text


def test_no_feature_is_not_read_as_all_features(written):
    with pytest.raises(Exception):  # noqa: B017 - pyradiomics raises what its YAML checker raises
        RadiomicsFeatureExtractor(str(written([])))
