"""The folder `resources`, and `downloads`, its former name."""

import pytest

from virtual_phantom.base.console import collected_notes
from virtual_phantom.config.config import inspect_config
from virtual_phantom.io.published import resources_folder

CT = {"image": "{}/abdomen_ct/dicom", "labels": "{}/abdomen_ct/labels.nii.gz", "rois": [{"file": "{}/own/spleen.nrrd"}]}
RENAME = "downloads: this folder is named resources now; rename it"


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A function that makes folders."""
    monkeypatch.chdir(tmp_path)

    def make(*paths):
        for path in paths:
            (tmp_path / path).mkdir(parents=True)

    return make


def read(folder):
    """Paths of the CT as they are read, and the notes."""
    ct = {"image": CT["image"].format(folder), "labels": CT["labels"].format(folder)}
    ct["rois"] = [{"name": "spleen", "tissue_class": "spleen", "file": CT["rois"][0]["file"].format(folder)}]
    with collected_notes() as notes:
        found = inspect_config({"phantom": {"source": "ct", "ct": ct}})[1]["phantom"]["ct"]
    return [found["image"], found["labels"], found["rois"][0]["file"]], [str(note) for note in dict.fromkeys(notes)]


def paths(folder):
    return [CT["image"].format(folder), CT["labels"].format(folder), CT["rois"][0]["file"].format(folder)]


def test_resources_is_the_default_folder(files):
    assert resources_folder() == "resources"
    assert read("resources") == (paths("resources"), [])
    files("downloads/of_another_program")
    assert read("resources") == (paths("resources"), [])


def test_downloads_is_used_and_the_note_names_the_new_folder(files):
    files("downloads/abdomen_ct", "resources")
    found, notes = read("resources")
    assert found == paths("downloads") and len(notes) == 1 and notes[0].startswith(RENAME)
    assert read("downloads") == (found, notes)


def test_configuration_with_downloads_finds_resources(files):
    files("resources/abdomen_ct")
    found, notes = read("downloads")
    assert found == paths("resources") and len(notes) == 3
    assert notes[0] == ("config: phantom.ct.image is deprecated below downloads; write resources/abdomen_ct/dicom")


def test_existing_path_is_used_unchanged(files):
    files("resources/abdomen_ct", *paths("downloads"))
    assert read("downloads") == (paths("downloads"), [])
