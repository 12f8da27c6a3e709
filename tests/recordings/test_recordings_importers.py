"""Importers: outputs load and agree with their source; broken sources leave nothing behind."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from phantom_files import CT_GRID, ct_slices, object_hu, write_seg, write_series
from recording_folders import features_folder, projections_folder, write_yaml
from scipy.io import savemat

from virtual_phantom.base.errors import InputError
from virtual_phantom.config.config import complete
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.recordings.importers import command
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree
from virtual_phantom.recordings.importers.feature_tables import import_features
from virtual_phantom.recordings.importers.htc2022 import import_htc2022
from virtual_phantom.recordings.importers.next_steps import next_steps
from virtual_phantom.recordings.reading import load_recording

ROOT = Path(__file__).resolve().parents[2]
STUDIES = {
    name: yaml.safe_load((ROOT / name).read_text()) for name in ("config/config.yaml", "config/paper_groups.yaml")
}

PARAMETERS = {
    "distanceSourceOrigin": 410.66,
    "distanceSourceDetector": 553.74,
    "distanceUnit": "mm",
    "angles": np.arange(0, 360.5, 30.0),
    "numDetectorsPost": 112,
    "pixelSizePost": 1.0,
    "voltage": "45",
    "target": "Mo",
    "xRayFilter": "Al",
    "xRayFilterThickness": "0.5",
}


def mat_file(path, sinogram=None, **parameters):
    """A small challenge file; parameters set to None are omitted."""
    sinogram = np.random.default_rng(0).random((13, 112)) if sinogram is None else sinogram
    fields = {key: value for key, value in (PARAMETERS | parameters).items() if value is not None}
    savemat(path, {"CtDataFull": {"type": "2d", "sinogram": sinogram, "parameters": fields}})
    return sinogram


def import_refused(folder, run, message):
    with pytest.raises(InputError) as error:
        run()
    assert message in str(error.value), str(error.value)
    assert "\n" not in str(error.value)
    assert not folder.exists() and not list(folder.parent.glob(".partial*"))


def test_sinogram_becomes_a_fan_beam(tmp_path):
    sinogram = mat_file(tmp_path / "s.mat")
    recording = import_htc2022(tmp_path / "s.mat", tmp_path / "disc", phantom="disc")
    np.testing.assert_array_equal(recording.repeats[0].data[:, 0], sinogram[:, ::-1].astype(np.float32))
    geometry = recording.geometry
    assert (geometry.views, geometry.views_per_rotation, geometry.rows) == (13, 12, 1)
    np.testing.assert_allclose(np.rad2deg(geometry.angles_rad), PARAMETERS["angles"] + 180, atol=1e-9)
    assert recording.nominal == {"tube_kvp": 45, "anode": "Mo", "filtration": "0.5 mm Al"}
    assert (recording.name, recording.phantom, recording.log) == ("disc", "disc", True)


def test_sinogram_of_a_scan_that_starts_after_half_a_turn(tmp_path):
    mat_file(tmp_path / "s.mat", angles=200 + np.arange(13.0))
    recording = import_htc2022(tmp_path / "s.mat", tmp_path / "disc")
    assert np.rad2deg(recording.geometry.angles_rad[:2]) == pytest.approx([20, 21])  # 0 here is 180 in the files
    assert any("the views cover 13 degrees" in note for note in recording.notes)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"distanceUnit": "cm"}, "distanceUnit is cm; convert all distances to mm"),
        ({"angles": np.arange(12.0)}, "sinogram has shape (13, 112), but there are 12 angles"),
        ({"angles": np.r_[np.arange(12.0), 20]}, "not evenly spaced"),
        ({"sinogram": "x"}, "the field sinogram does not contain a matrix of numbers; restore the file"),
        ({"angles": "y"}, "the field angles does not contain finite numbers; restore"),
        ({"pixelSizePost": [1.0, 2.0]}, "the field pixelSizePost does not contain a finite number; restore"),
        ({"numDetectorsPost": np.nan}, "the field numDetectorsPost does not contain a finite number; restore"),
        ({"distanceSourceOrigin": None}, "has no field distanceSourceOrigin"),
        ({"distanceSourceOrigin": 41.066}, "scan.source_to_isocentre_mm: 41.066 is less than the minimum of 100"),
        ({"sinogram": np.full((13, 112), np.nan)}, "disc/projections.h5: 1456 line integrals are NaN"),
    ],
)
def test_impossible_sinograms_are_rejected(tmp_path, changes, message):
    mat_file(tmp_path / "s.mat", **changes)
    import_refused(tmp_path / "disc", lambda: import_htc2022(tmp_path / "s.mat", tmp_path / "disc"), message)


def test_segmentation_becomes_the_mask_of_the_object(tmp_path):
    mat_file(tmp_path / "s.mat")
    inside = np.zeros((64, 64), np.uint8)
    inside[4:12, 40:60] = 1  # above the middle and to the right of it
    savemat(tmp_path / "seg.mat", {"reconFullFbpSeg": inside})
    import_htc2022(tmp_path / "s.mat", tmp_path / "disc", segmentation=tmp_path / "seg.mat")
    mask = read_nifti(tmp_path / "disc" / "object.nii.gz")
    pixel = 1.0 * 410.66 / 553.74
    assert mask.grid.shape == (1, 64, 64) and mask.grid.spacing[1:] == pytest.approx((pixel, pixel))
    assert mask.array.sum() == pytest.approx(inside.sum(), rel=0.03)  # corners are rounded
    _, y, x = mask.grid.axes_mm()
    centre = (mask.array[0] * x).sum() / mask.array.sum(), (mask.array[0] * y[:, None]).sum() / mask.array.sum()
    assert centre == pytest.approx(((49.5 - 31.5) * pixel, (31.5 - 7.5) * pixel), abs=0.01)
    savemat(tmp_path / "text.mat", {"reconFullFbpSeg": "text"})
    for source, message in (
        ("none.mat", "no such file; use a segmentation"),
        ("s.mat", "has no segmentation"),
        ("text.mat", "has no segmentation"),
    ):
        run = lambda source=source: import_htc2022(tmp_path / "s.mat", tmp_path / "b", segmentation=tmp_path / source)  # noqa: E731
        import_refused(tmp_path / "b", run, message)


def test_other_and_truncated_mat_files_are_rejected(tmp_path):
    savemat(tmp_path / "seg.mat", {"reconFullFbpSeg": np.ones((4, 4))})
    mat_file(tmp_path / "s.mat")
    whole = (tmp_path / "s.mat").read_bytes()
    (tmp_path / "half.mat").write_bytes(whole[: len(whole) // 2])
    for name, message in (
        ("seg", "has no CtDataFull or CtDataLimited but reconFullFbpSeg"),
        ("half", "cannot be read as MATLAB v5"),
        ("none", "no such file"),
    ):
        run = lambda name=name: import_htc2022(tmp_path / f"{name}.mat", tmp_path / "disc")  # noqa: E731
        import_refused(tmp_path / "disc", run, message)


def test_existing_folder_is_never_changed(tmp_path):
    mat_file(tmp_path / "s.mat")
    (tmp_path / "disc").mkdir()
    (tmp_path / "disc" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="already exists"):
        import_htc2022(tmp_path / "s.mat", tmp_path / "disc")
    assert [path.name for path in (tmp_path / "disc").iterdir()] == ["mine.txt"]
    with pytest.raises(InputError, match="letters, digits and underscores"):
        import_htc2022(tmp_path / "s.mat", tmp_path / "a disc")


def test_table_of_another_layout_is_rejected(tmp_path):
    (tmp_path / "t.csv").write_text("roi,original_firstorder_Mean\na,1\n")
    run = lambda: import_features(tmp_path / "t.csv", tmp_path / "table")  # noqa: E731
    import_refused(tmp_path / "table", run, "has neither a column scan_id")
    (tmp_path / "t.csv").write_text("recon_code,roi6\n1,a\n")
    import_refused(tmp_path / "table", run, "column(s) of the published table, the first 'dose_mGy'")


def dicom_tree(root, kernels=("Br38f", "Br38f", "Br59d")):
    """Series in the layout of archives, with a SEG among them."""
    for number, kernel in enumerate(kernels):
        slices = ct_slices()
        for ds in slices:
            ds.ConvolutionKernel, ds.KVP, ds.PatientName = kernel, 120, "Doe^Jane"
        folder = root / "patient" / f"study{number}" / "series"
        folder.mkdir(parents=True)
        write_series(slices, folder)
    (root / "patient" / "seg").mkdir()
    write_seg(ct_slices(), root / "patient" / "seg" / "seg.dcm")
    return root


def test_dicom_tree_gives_one_repeat_per_series_and_no_patient_data(tmp_path):
    recording = import_dicom_tree(dicom_tree(tmp_path / "tree"), tmp_path / "clinic", kernel="Br38f")
    assert len(recording.repeats) == 2 and recording.grid.matches(CT_GRID)
    for image in recording.repeats:
        np.testing.assert_array_equal(image.array, object_hu())
    content = yaml.safe_load((tmp_path / "clinic" / "recording.yaml").read_text())
    assert content["nominal"] == {"tube_kvp": 120, "kernel": "Br38f", "slice_thickness_mm": 3}
    assert len(content["origin"]["sha256"]) == 28
    assert all(b"Doe" not in path.read_bytes() for path in (tmp_path / "clinic").iterdir())


def test_series_that_are_no_repeats_are_rejected(tmp_path):
    tree = dicom_tree(tmp_path / "tree")
    folder = tmp_path / "clinic"
    import_refused(folder, lambda: import_dicom_tree(tree, folder), "study0/series has Br38f")
    import_refused(folder, lambda: import_dicom_tree(tree, folder, kernel="B3"), "choose from Br38f, Br59d")
    slices = ct_slices()[:-1]
    for ds in slices:
        ds.ConvolutionKernel, ds.KVP = "Br38f", 120
    (tmp_path / "tree" / "short").mkdir()
    write_series(slices, tmp_path / "tree" / "short")
    import_refused(folder, lambda: import_dicom_tree(tree, folder, kernel="Br38f"), "is on another grid")
    import_refused(folder, lambda: import_dicom_tree(tree / "patient" / "seg", folder), "has no CT slices in DICOM")


def test_dicom_tree_on_the_command_line(tmp_path, capsys):
    tree = dicom_tree(tmp_path / "tree")
    assert command.main(["dicom", str(tree), f"{tmp_path}/scanner_a", "--kernel", "Br38f"]) == 0
    assert "scanner_a: images, 2 repeats" in capsys.readouterr().out


def test_importer_on_the_command_line(tmp_path, capsys):
    mat_file(tmp_path / "s.mat")
    assert command.main(["htc2022", f"{tmp_path}/s.mat", f"{tmp_path}/disc", "--phantom", "disc"]) == 0
    assert "disc: projections, 1 repeat\n" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disc", "s.mat"]  # no other output
    assert command.main(["htc2022", f"{tmp_path}/none.mat", f"{tmp_path}/other"]) == 1
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1 and errors.startswith(f"Error: {tmp_path}/none.mat: no such file")


def next_step(recording):
    """Configuration that an importer suggests, with an acrylic disc in the place of the capitals."""
    printed = next_steps(recording)
    first, overlay, last = re.fullmatch(r"(Next: .+):\n\n(.+)\n\n(Then run.+)", printed, re.DOTALL).groups()
    assert f"save this as {recording.name}.yaml" in first and f"--configfile {recording.name}.yaml" in last
    settings = yaml.safe_load(overlay.replace("DIAMETER", "70").replace("MATERIAL", "acrylic"))
    base = STUDIES[settings.get("base", "config/config.yaml")]
    return printed, settings, complete(base | {**settings, "analyses": base["analyses"] | settings.get("analyses", {})})


def test_next_step_of_a_sinogram_is_its_diagnosis(tmp_path):
    angles = np.arange(0, 360.5, 0.5)
    mat_file(tmp_path / "s.mat", np.zeros((721, 112)), angles=angles)
    printed, settings, whole = next_step(import_htc2022(tmp_path / "s.mat", tmp_path / "disc"))
    assert (
        "replace the words in capitals by the properties of the scanned object" in printed
        and "Then run: snakemake diagnosis" in printed
    )
    # Equal to the shipped configuration of the same disc.
    (mine,) = settings["diagnosis"]["recordings"].values()
    shipped = yaml.safe_load((ROOT / "config" / "htc2022.yaml").read_text())["diagnosis"]["recordings"]["solid_disc"]
    assert {key: mine[key] for key in ("alignment", "view_step", "effects")} == {
        key: shipped[key] for key in ("alignment", "view_step", "effects")
    }
    assert whole["diagnosis"]["recordings"]["disc"]["disc"] == {"diameter_mm": 70, "material": "pmma"}
    assert whole["recordings"]["disc"] == f"{tmp_path}/disc"

    inside = np.zeros((64, 64), np.uint8)
    inside[20:40, 20:40] = 1
    savemat(tmp_path / "seg.mat", {"reconFullFbpSeg": inside})
    masked = import_htc2022(tmp_path / "s.mat", tmp_path / "masked", segmentation=tmp_path / "seg.mat")
    printed, _, whole = next_step(masked)
    assert "DIAMETER" not in printed
    one = whole["diagnosis"]["recordings"]["masked"]
    assert one["object"] == {"mask": f"{tmp_path}/masked/object.nii.gz", "material": "pmma"} and "disc" not in one


def test_remaining_placeholders_are_reported(tmp_path):
    mat_file(tmp_path / "s.mat")
    _, settings, _ = next_step(import_htc2022(tmp_path / "s.mat", tmp_path / "disc"))
    settings["diagnosis"]["recordings"]["disc"]["disc"]["diameter_mm"] = "DIAMETER"
    with pytest.raises(
        InputError, match="diagnosis.recordings.disc.disc.diameter_mm: 'DIAMETER' is not of type 'number'"
    ):
        complete(STUDIES["config/config.yaml"] | settings)


def test_next_step_of_images_is_to_find_the_phantom(tmp_path):
    tree = dicom_tree(tmp_path / "tree", ("Br38f",))
    printed, settings, _ = next_step(import_dicom_tree(tree, tmp_path / "my: scans" / "clinic"))
    assert settings == {"base": "config/paper_groups.yaml", "recordings": {"clinic": f"{tmp_path}/my: scans/clinic"}}
    assert "if the scanned object is the study's phantom: snakemake alignment" in printed


def test_next_step_of_the_study_s_own_scans_has_the_object(tmp_path):
    folder = projections_folder(tmp_path / "scans")[0]
    content = yaml.safe_load((folder / "recording.yaml").read_text()) | {"origin": {"importer": "study"}}
    printed, settings, _ = next_step(load_recording(write_yaml(folder, content)))
    assert settings["diagnosis"] == {"recordings": {"bench": {}}} and "capitals" not in printed


def test_next_step_of_a_table_is_a_comparison(tmp_path):
    folder, content = features_folder(tmp_path / "table")
    _, settings, whole = next_step(load_recording(write_yaml(folder, content | {"origin": {"importer": "features"}})))
    expected = {"recording": "table", "where": {"dose_mgy": 10}, "protocol": "group_2", "noise": "mgy10"}
    assert settings["analyses"]["comparison"] == {"table": expected}
    assert whole["analyses"]["comparison"]["table"]["where"] == {"dose_mgy": 10}
