"""Real measurements of unknown objects: import, summary and verdict."""

from pathlib import Path

import pytest

from virtual_phantom.diagnosis.setup.unknown_object import unknown_object_diagnosis
from virtual_phantom.recordings.importers.dicom_tree import import_dicom_tree
from virtual_phantom.recordings.importers.next_steps import next_steps
from virtual_phantom.recordings.importers.projections import import_projections
from virtual_phantom.recordings.importers.xtekct import import_xtekct
from virtual_phantom.recordings.summary import readable, summarize_recording, summary_table

REAL = Path(__file__).resolve().parents[2] / "../shared/real"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout"),
]


def verdict(recording):
    """First line of the verdict, and the findings by subject; the recording is also listed."""
    assert recording.name in readable(summary_table({recording.name: summarize_recording(recording)}))
    content = unknown_object_diagnosis(recording).content
    return content["verdict_lines"], {check["subject"]: check for check in content["data_checks"]}


def test_metal_bars_without_scale_and_voltage(tmp_path):
    options = {"axes": "cv", "log": True, "angles": "0,1", "unit": "element"}
    distances = {"source_to_axis": 3492, "source_to_detector": 3492}
    source = REAL / "cast_pore_motor" / "sinogram.mat"
    (first, *_, last), checks = verdict(import_projections(source, tmp_path / "bars", **options, **distances))
    for reason in ("object is not known", "lengths are in detector elements", "tube voltage is not stated"):
        assert reason in first
    assert "pixel size" in last and "tube voltage" in last
    assert checks["air"]["values"]["level"] == pytest.approx(0.295, abs=0.002)  # stated with the data
    assert checks["defective pixels"]["text"] == "1 defective column (594)"  # zero in 209 of 360 views
    assert checks["linearity"]["wrong"] and "beam hardening, scatter or both" in checks["linearity"]["text"]
    assert checks["geometry"]["values"]["distance"] == pytest.approx(1, abs=0.02)


def test_clipped_radiographs_of_balls(tmp_path):
    folder = REAL / "nikon_balls"
    recording = import_xtekct(folder / "balls.xtekct", tmp_path / "balls", images=str(folder / "images"), bin=8)
    (first, *_, last), checks = verdict(recording)
    # Shadows of the balls intersect in 614 mm^3 in this direction, and in 273 mm^3 in that of the .ang file.
    assert recording.scan["direction"] == 1
    assert recording.geometry.magnification == pytest.approx(867.5093 / 149.2543)
    assert "values were clipped" in first and "Next: give the counts as the detector read them" in last
    assert "8 bits" in checks["stored values"]["text"]
    assert checks["repeated views"]["wrong"] and "views 0 and 16" in checks["repeated views"]["text"]
    assert "noise" not in checks


def test_frames_without_angles(tmp_path):
    folder = REAL / "detector_frames"
    fields = {name: str(folder / f"{name}.tif") for name in ("flat", "dark")}
    options = {"angles": "unknown", "beam": "parallel", "unit": "element"}
    (first, *_, last), checks = verdict(import_projections(folder / "CT.tif", tmp_path / "frames", **fields, **options))
    assert "view angles are not known" in first and "Next: state the view angles" in last
    assert checks["dark signal"]["values"]["dark"] == pytest.approx(244, abs=1)
    assert {"gain", "noise"} <= set(checks) and not {"geometry", "linearity", "repeated views"} & set(checks)


def test_single_slice_of_a_chest_phantom(tmp_path):
    (tmp_path / "series").mkdir()
    (tmp_path / "series" / "slice.dcm").symlink_to((REAL / "lungman_ct" / "CT000382.dcm").resolve())
    recording = import_dicom_tree(tmp_path / "series", tmp_path / "lung", one_slice=True)
    assert recording.grid.shape == (1, 512, 512) and recording.nominal["tube_current_ma"] == 229
    assert "object: {unknown: true}" in next_steps(recording)
    (first, *_), checks = verdict(recording)
    assert "object is not known" in first
    assert 25 < checks["noise"]["values"]["repeat_0"] < 45  # SD of uniform blocks, HU
