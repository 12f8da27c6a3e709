"""A results folder whose name has every character with a meaning in shells or formats."""

from workflow_runs import ROOT, tiny

from virtual_phantom.io.files import check_unchanged, checksum_path

NAME = "a b;touch hacked;$(touch hacked)`touch hacked` & | > 'q' \"é\"#%"


def test_results_folder_is_never_interpreted_as_a_command(tmp_path):
    folder = tmp_path / NAME
    process = tiny(folder, folder / "phantom" / "image.nii.gz", overlay={"results_dir": str(folder)}, cores=1)
    assert process.returncode == 0, process.stderr[-3000:]
    made = {path.name for path in (folder / "phantom").iterdir()}
    assert {"image.nii.gz", "fine.nii.gz", "rois.csv", "rois"} <= made
    for path in folder.rglob("*.gz"):
        assert checksum_path(path).exists()
        check_unchanged(path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([NAME, "overlay.yaml"])
    assert not (ROOT / "hacked").exists()
