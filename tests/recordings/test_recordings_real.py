"""Real measurements through the public functions: importer, recording folder, loader, summary."""

import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from recording_folders import write_yaml
from scipy.io import loadmat

from virtual_phantom.base.geometry import Grid, OrbitGeometry
from virtual_phantom.features.hu_offset import convert_to_hu
from virtual_phantom.projectors import projector
from virtual_phantom.reconstruction import fbp
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree
from virtual_phantom.recordings.importers.feature_tables import import_features
from virtual_phantom.recordings.importers.htc2022 import import_htc2022
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.summary import summarize_recording

REAL = Path(__file__).resolve().parents[2] / "../shared/real"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout"),
]


def first_turn(recording):
    """Line integrals of the 720 views of one turn, every second of them, as for FDK, and their geometry."""
    whole = recording.geometry
    selected = slice(0, 720, 2)
    geometry = OrbitGeometry(
        source_to_isocentre_mm=whole.source_to_isocentre_mm,
        source_to_detector_mm=whole.source_to_detector_mm,
        columns=whole.columns,
        rows=whole.rows,
        column_pitch_mm=whole.column_pitch_mm,
        row_pitch_mm=whole.row_pitch_mm,
        angles_rad=whole.angles_rad[selected],
        source_z_mm=whole.source_z_mm[selected],
        views_per_rotation=360,
    )
    return recording.repeats[0].data[selected], geometry


def reconstruction(recording, size):
    """FDK of the fan beam on the 75.9 mm square of the data set's own images, [y, x], 1/mm, and the pixel size, mm."""
    data, geometry = first_turn(recording)
    pixel = 512 * 0.2 * 410.66 / 553.74 / size
    grid = Grid((1, size, size), (0.1, pixel, pixel))
    return fbp.fbp(projector("cpu", geometry, grid), data[None], normalise="none")[0, 0], pixel


def solid(image):
    """Above half of the acrylic's attenuation."""
    return image > 0.5 * np.median(image[image > 0.5 * image.max()])


def test_solid_disc_is_round_and_70_mm_wide(tmp_path):
    recording = import_htc2022(REAL / "htc2022" / "htc2022_solid_disc_full.mat", tmp_path / "disc")
    image, pixel = reconstruction(recording, 256)
    disc = solid(image)
    y, x = np.nonzero(disc)
    diameter = 2 * math.sqrt(disc.sum() / math.pi) * pixel
    assert diameter == pytest.approx(70, abs=0.5)
    radius = np.hypot(x - x.mean(), y - y.mean()).max() * pixel
    assert 2 * radius == pytest.approx(diameter, rel=0.02)  # round: no point is farther out than half the diameter
    assert np.median(image[disc]) == pytest.approx(0.0324, rel=0.05)  # 1/mm


def test_shadow_is_widest_where_the_disc_is_closest_to_the_source(tmp_path):
    """Determines the side of the source.

    The disc is 0.4 mm off the axis: the position of its shadow tells when it is close, and its width too.
    """
    recording = import_htc2022(REAL / "htc2022" / "htc2022_solid_disc_full.mat", tmp_path / "disc")
    shadow = recording.repeats[0].data[:720, 0] > 0.6
    geometry = recording.geometry
    angles = np.arctan(geometry.column_positions_mm() / geometry.source_to_detector_mm)
    first, last = angles[shadow.argmax(1)], angles[shadow.shape[1] - 1 - shadow[:, ::-1].argmax(1)]
    across, width = np.sin((first + last) / 2), (last - first) / 2
    turn = geometry.angles_rad[:720]
    x, y = np.linalg.lstsq(np.stack([np.cos(turn), np.sin(turn)], 1), across * geometry.source_to_isocentre_mm)[0]
    depth = geometry.source_to_isocentre_mm + x * np.sin(turn) - y * np.cos(turn)
    change, _ = np.linalg.lstsq(np.stack([1 / depth - (1 / depth).mean(), np.ones(720)], 1), width)[0]
    assert change == pytest.approx(35, rel=0.3)  # -35 for the opposite side


def test_holes_agree_with_the_published_segmentation(tmp_path):
    """Determines start angle and direction: if mirrored or rotated by 90 degrees, a fifth of the pixels disagree."""
    recording = import_htc2022(REAL / "htc2022" / "htc2022_ta_full.mat", tmp_path / "ta")
    data = recording.repeats[0].data
    assert data.shape == (721, 1, 560)
    # the last view repeats the first one: no other view is closer, except a neighbor by chance of noise
    assert ((data[:720] - data[720]) ** 2).sum((1, 2)).argmin() in (719, 0, 1)
    image, _ = reconstruction(recording, 512)
    shown = solid(image)[::-1]  # row 0 at the top, +y
    published = loadmat(REAL / "htc2022" / "htc2022_ta_full_recon_fbp_seg.mat")["reconFullFbpSeg"] > 0
    assert (shown == published).mean() > 0.98
    for other in (shown[:, ::-1], shown[::-1], np.rot90(shown), np.rot90(shown, 2)):
        assert (other == published).mean() < 0.85


@pytest.mark.parametrize("name", ["ta", "tb", "solid_disc"])
def test_every_sinogram_loads(tmp_path, name):
    found = summarize_recording(import_htc2022(REAL / "htc2022" / f"htc2022_{name}_full.mat", tmp_path / name))
    assert found["content"]["values"] == "line integrals" and found["known"]["nominal"]["tube_kvp"] == 45
    again, times = found["notes"]  # the data set states an exposure and no view interval
    assert again == "1 view beyond the first rotation, along the same directions"
    assert "1200 ms (scan.exposure_ms)" in times


def test_tandem_study_keeps_its_values(tmp_path):
    source = REAL / "ct_phantom4radiomics" / "features_2d.csv"
    recording = import_features(source, tmp_path / "study", phantom="synthetic")
    raw = pd.read_csv(source)
    assert (len(recording.repeats), recording.repeats["image"].nunique()) == (1394, 238)
    assert recording.dimensions == 2 and recording.stored_offset_hu == 1024 and len(recording.features) == 85
    pd.testing.assert_frame_equal(recording.repeats[list(recording.features)], raw[list(recording.features)])
    assert recording.images_per_condition().tolist() == [29, 29, 30, 30, 30, 30, 30, 30]
    in_hu = convert_to_hu(recording.repeats).groupby("roi")["original_firstorder_Mean"].mean()
    noted = {"normal_1": 98, "normal_2": 86, "cyst_1": 5, "cyst_2": 14, "hemangioma": 43, "metastasis": 45}
    assert in_hu.to_dict() == pytest.approx(noted, abs=1)


def test_dose_series_keeps_its_values(tmp_path):
    source = REAL / "edge_dose_series" / "features_3d.csv"
    recording = import_features(source, tmp_path / "dose")
    raw = pd.read_csv(source)
    assert len(recording.features) == 86 and len(recording.repeats) == 360
    pd.testing.assert_frame_equal(recording.repeats[list(recording.features)], raw[list(recording.features)])
    counts = recording.images_per_condition()
    assert len(counts) == 6 and (counts == 10).all()
    cyst = recording.repeats.query("roi == 'cyst_1'").groupby(["reconstruction", "dose_mgy"])
    variance = cyst["original_firstorder_Variance"].mean()
    assert variance["fbp"].tolist() == pytest.approx([1253, 740, 365], abs=1)


def test_clinical_ct_as_series_and_as_imported_tree(tmp_path):
    source = REAL / "abdomen_ct"
    shutil.copytree(source / "dicom", tmp_path / "hand" / "ct")
    shutil.copy(source / "labels.nii.gz", tmp_path / "hand")
    rois = [
        {"name": "liver", "tissue_class": "liver", "label": 5},
        {"name": "aorta", "tissue_class": "vessel", "label": 52},
    ]
    write_yaml(
        tmp_path / "hand",
        {"name": "abdomen", "kind": "images", "repeats": ["ct"], "labels": "labels.nii.gz", "rois": rois},
    )
    by_hand, imported = load_recording(tmp_path / "hand"), import_dicom_tree(source, tmp_path / "imported")
    assert by_hand.grid.shape == (20, 512, 512) and by_hand.grid.matches(imported.grid, 0.02)
    image = by_hand.repeats[0].array
    np.testing.assert_array_equal(image, imported.repeats[0].array)
    liver = next(roi.mask for roi in by_hand.rois() if roi.name == "liver")
    assert image[liver].mean() == pytest.approx(89, abs=2)
    facts = by_hand.provenance.dicom
    assert (facts["tube_kvp"], facts["kernel"], facts["slice_thickness_mm"]) == (120, "Br38f/3", 3)
    assert facts["model"] == "Biograph40_mCT 4R" and facts["spacing_mm"] == [0.9765625, 0.9765625]
    assert imported.nominal["kernel"] == facts["kernel"]
    # institution, dates, weight and protocol name are in the headers
    text = str(summarize_recording(by_hand)) + (tmp_path / "imported" / "recording.yaml").read_text()
    for private in ("Petersgraben", "20221208", "FDG_TK_KM", "1.3.12.2.1107"):
        assert private not in text
