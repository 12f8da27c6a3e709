"""DICOM-CT-PD: written files are read back, and positions agree with equations from the format's paper."""

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataelem import RawDataElement
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.tag import Tag
from pydicom.uid import JPEGLosslessSV1
from test_recordings_importers import import_refused

from virtual_phantom.base.geometry import helical
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.cli import main as study_command
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.io import dicom_ct_pd as pd
from virtual_phantom.io.exchange import write_line_integrals
from virtual_phantom.recordings.importers import command
from virtual_phantom.recordings.importers.dicom_ct_pd import import_dicom_ct_pd

SPOTS = ((-0.66, 3.0, -0.6), (0.66, 3.0, -0.6), (-0.66, -3.0, 0.6), (0.66, -3.0, 0.6))
# A scanner of 736 columns with fewer and wider ones.
GEOMETRY = helical(
    views=40,
    turns=1.25,
    volume_height_mm=30.0,
    source_to_isocentre_mm=595.0,
    source_to_detector_mm=1085.6,
    columns=92,
    rows=8,
    column_pitch_mm=9.6,
    row_pitch_mm=4.3788,
    column_offset_px=0.125,
    row_offset_px=-0.5,
    start_angle_rad=0.7,
    surface="cylindrical",
    spots_mm=SPOTS,
    view_interval_ms=500 / 32,
)
SHADOW = np.exp(-(((np.arange(92) - 45) / 15) ** 2)).astype(np.float32)
LINES = 3 * SHADOW * np.random.default_rng(1).uniform(0.9, 1.1, GEOMETRY.shape).astype(np.float32)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ct_pd") / "scan"
    write_line_integrals(folder.parent / "clean.h5", LINES, GEOMETRY)
    assert study_command.main(["export", "dicom-ct-pd", str(folder.parent / "clean.h5"), str(folder)]) == 0
    assert len(list(folder.iterdir())) == 40
    return folder


@pytest.fixture
def scan(written, tmp_path):
    """A copy that may be spoilt."""
    return Path(shutil.copytree(written, tmp_path / "scan"))


def change(folder, *files, **elements):
    """Set elements by tag or keyword in these files, or in all."""
    for path in [folder / f"view{number:06d}.dcm" for number in files] or sorted(folder.glob("*.dcm")):
        dataset = pydicom.dcmread(path)
        for name, value in elements.items():
            tag = getattr(pd, name, name)
            dataset[tag].value = value(dataset[tag].value) if callable(value) else value
        dataset.save_as(path)


def test_written_scan_is_read_back(scan, tmp_path):
    recording = import_dicom_ct_pd(scan, tmp_path / "clinic")
    geometry = recording.geometry
    assert geometry.shape == GEOMETRY.shape and geometry.surface == "cylindrical"
    for name in ("source_mm", "detector_mm", "column_direction"):
        found, expected = getattr(geometry, name), getattr(GEOMETRY, name)
        np.testing.assert_allclose(found, expected, atol=2e-4)  # single precision
    np.testing.assert_allclose(geometry.column_positions_mm(), GEOMETRY.column_positions_mm(), atol=1e-4)
    np.testing.assert_allclose(geometry.row_positions_mm(), GEOMETRY.row_positions_mm(), atol=1e-4)
    assert geometry.view_interval_ms == pytest.approx(GEOMETRY.view_interval_ms)
    step = np.ptp(LINES) / 65535
    np.testing.assert_allclose(recording.repeats[0].data, LINES, atol=0.51 * step)
    assert recording.document.content["corrected"] == []
    command = "sha256sum * | cut -d' ' -f1 | sort | sha256sum"
    found = subprocess.run(["bash", "-c", command], cwd=scan, capture_output=True, text=True, check=True).stdout
    origin = recording.document.content["origin"]
    assert origin["sha256"] == [found.split()[0]] and origin["files"] == GEOMETRY.views


def test_element_positions_agree_with_the_paper(scan):
    """Chen et al. (2015): source and elements of one file in cylindrical coordinates, x = -r sin a, y = r cos a."""
    one = pydicom.dcmread(scan / "view000007.dcm")
    value = {name: one[getattr(pd, name)].value for name in ("FOCAL_ANGLE", "FOCAL_Z", "FOCAL_RADIUS", "DISTANCE")}
    angle = value["FOCAL_ANGLE"] + one[pd.SPOT_ANGLE].value
    radius = value["FOCAL_RADIUS"] + one[pd.SPOT_RADIUS].value
    source = [-radius * math.sin(angle), radius * math.cos(angle), value["FOCAL_Z"] + one[pd.SPOT_Z].value]
    column, row = 91, 2  # counted from 1
    x, y = one[pd.CENTRAL].value
    fan = (column - x) * one[pd.WIDTH].value / value["DISTANCE"]
    a, r, d = value["FOCAL_ANGLE"], value["FOCAL_RADIUS"], value["DISTANCE"]
    element = [
        -r * math.sin(a) + d * math.sin(a + fan),
        r * math.cos(a) - d * math.cos(a + fan),
        value["FOCAL_Z"] + (y - row) * one[pd.HEIGHT].value,
    ]
    found = GEOMETRY.ray(6, GEOMETRY.rows - row, column - 1)
    np.testing.assert_allclose(found, [source, element], atol=2e-4)
    pixels = np.frombuffer(one.PixelData, "<u2").reshape(92, 8)
    line = pixels[column - 1, row - 1] * one.RescaleSlope + one.RescaleIntercept
    assert line == pytest.approx(LINES[6, 8 - row, 90], abs=float(np.ptp(LINES)) / 65535)


def test_bytes_of_unknown_representation_and_column_major_pixels_are_read(scan, tmp_path):
    """As in files in implicit VR, and of pixels stored row after row."""
    for path in sorted(scan.glob("*.dcm")):
        dataset = pydicom.dcmread(path)
        for element in list(dataset):
            if element.tag.is_private and not element.tag.is_private_creator:
                raw = pydicom.dataelem.DataElement_from_raw(element) if element.is_raw else element
                raw = _bytes(raw)
                dataset[raw[0]] = RawDataElement(raw[0], "UN", len(raw[1]), raw[1], 0, False, True)
        pixels = np.frombuffer(dataset.PixelData, "<u2").reshape(92, 8)
        dataset.PixelData, dataset.Rows, dataset.Columns = np.ascontiguousarray(pixels.T).tobytes(), 8, 92
        dataset.save_as(path)
    assert pydicom.dcmread(path)[pd.WIDTH].VR == "UN"
    recording = import_dicom_ct_pd(scan, tmp_path / "clinic")
    np.testing.assert_allclose(recording.geometry.source_mm, GEOMETRY.source_mm, atol=2e-4)
    np.testing.assert_allclose(recording.repeats[0].data, LINES, atol=1e-4)


def _bytes(element):
    values = element.value if element.VM > 1 else [element.value]
    if element.VR == "CS":
        text = element.value.encode()
        return element.tag, text + b" " * (len(text) % 2)
    return element.tag, np.array(list(values), {"FL": "<f4", "US": "<u2"}[element.VR]).tobytes()


def test_several_frames_of_a_file_are_views(scan, tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    views = [pydicom.dcmread(path) for path in sorted(scan.glob("*.dcm"))]
    spot_elements = (pd.FOCAL_ANGLE, pd.FOCAL_Z, pd.SPOT_ANGLE, pd.SPOT_Z, pd.SPOT_RADIUS)
    for part in range(2):
        some, whole = views[20 * part : 20 * part + 20], pydicom.dcmread(scan / "view000001.dcm")
        items = []
        for view in some:
            item, rescale, place = Dataset(), Dataset(), Dataset()
            for tag in spot_elements:
                place[tag] = view[tag]
            rescale.RescaleSlope, rescale.RescaleIntercept = view.RescaleSlope, view.RescaleIntercept
            item.PixelValueTransformationSequence = Sequence([rescale])
            item.add_new((0x7031, 0x0010), "LO", pd.CREATORS[0x7031])
            item.add_new((0x7031, 0x1099), "SQ", Sequence([place]))
            items.append(item)
        for tag in (*spot_elements, Tag("RescaleSlope"), Tag("RescaleIntercept")):
            del whole[tag]
        whole.PerFrameFunctionalGroupsSequence, whole.NumberOfFrames = Sequence(items), len(items)
        whole.InstanceNumber = part + 1
        whole.PixelData = b"".join(view.PixelData for view in some)
        whole.save_as(folder / f"part{part}.dcm")
    recording = import_dicom_ct_pd(folder, tmp_path / "clinic")
    np.testing.assert_allclose(recording.geometry.source_mm, GEOMETRY.source_mm, atol=2e-4)
    np.testing.assert_allclose(recording.repeats[0].data, LINES, atol=1e-4)


def test_corrections_photons_and_labels_are_read_and_patient_data_are_not(scan, tmp_path, capsys):
    for path in scan.glob("*.dcm"):
        dataset = pydicom.dcmread(path)
        dataset.PatientName, dataset.InstitutionName, dataset.KVP, dataset.XRayTubeCurrent = (
            "Planted^One",
            "Planted",
            120,
            200,
        )
        for name in ("beam_hardening", "scatter", "dark"):
            dataset[pd.CORRECTIONS[name]].value = "YES"
        dataset.add_new(pd.PHOTONS, "FL", list(np.linspace(1e5, 3e5, 92)))
        dataset.save_as(path)
    folder = tmp_path / "clinic"
    assert command.main(["dicom-ct-pd", str(scan), str(folder), "--phantom", "water"]) == 0
    content = (folder / "recording.yaml").read_text()
    assert (
        "Planted" not in content + capsys.readouterr().out
        and b"Planted" not in (folder / "projections.h5").read_bytes()
    )
    from virtual_phantom.recordings.reading import load_recording

    recording = load_recording(folder)
    assert recording.document.content["corrected"] == ["beam_hardening", "dark", "scatter"]
    assert recording.nominal["photons"] == pytest.approx(2e5) and recording.nominal["tube_kvp"] == 120
    tried = candidates(from_mapping(RecordingSettings, {}), corrected=recording.document.content["corrected"])
    assert not {"spectrum", "scatter", "dark_signal"} & set(tried) and "gain_pattern" in tried


@pytest.mark.parametrize(
    "spoil, message",
    [
        (
            lambda f: change(f, 5, SeriesInstanceUID="1.2.3"),
            "belongs to another scan than view000001.dcm, because its series",
        ),
        (
            lambda f: change(f, 5, FOCAL_RADIUS=541.0),
            "another scan than view000001.dcm, because its distance of the focal center",
        ),
        (lambda f: (f / "view000020.dcm").unlink(), "view 20 is missing, between view000019.dcm and view000021.dcm"),
        (lambda f: change(f, 5, InstanceNumber=6), "view 6 is also in view000005.dcm"),
        (lambda f: change(f, 1, 2, SPOT_Z=lambda z: -z), "mm from its position in mode FFSXYZ"),
        (lambda f: change(f, SPOT_MODE="FFSNONE"), "mode is FFSNONE (7033,100E), but its shifts vary by 1.32 mm"),
        (lambda f: change(f, Rows=736), "has 736 x 8 pixels (0028,0010 and 0011), but 8 detector rows and 92"),
        (lambda f: change(f, ROWS=92, COLUMNS=8), "92 detector rows and 8 columns (7029,1010 and 1011) look swapped"),
        (lambda f: swap(f), "(7033,100B) and (7033,100C) look swapped; import with --swapped-shifts"),
        (lambda f: change(f, SHAPE="FLAT"), "but a flat detector (7029,100B) would see"),
        (lambda f: change(f, SHAPE="SPHERICAL"), "the detector (7029,100B) is SPHERICAL"),
        (lambda f: change(f, LOGARITHM="NO"), "the values are not line integrals"),
        (lambda f: change(f, RescaleIntercept=0.3), "the object is larger than the field of view"),
        (lambda f: change(f, TRAJECTORY="AXIAL"), "mm off along z (7031,1002)"),
        (lambda f: change(f, VIEWS_PER_TURN=64), "64 views per rotation (7033,1013) would be 5.625"),
        (lambda f: [path.unlink() for path in f.glob("*.dcm")], "has no DICOM file"),
        (lambda f: change(f, VIEWS_PER_TURN=0), "views per rotation (7033,1013) is 0, not a number above 0; export"),
        (lambda f: change(f, DISTANCE=0.0), "to the detector (7031,1031) is 0, not a number above 0"),
        (lambda f: change(f, WIDTH=[1.0, 2.0]), "width of an element (7029,1002) is 1, 2, not a number above 0"),
        (lambda f: change(f, CENTRAL=[46.0]), "central element (7031,1033) is 46, not 2 finite numbers"),
        (lambda f: change(f, FOCAL_ANGLE=math.nan), "element (7031,1001) is nan, not a finite number"),
        (lambda f: change(f, RescaleSlope=0), "element (0028,1053) is 0, not a number above 0"),
        (lambda f: change(f, InstanceNumber=None), "has no valid InstanceNumber (0020,0013), the number of the view"),
        (lambda f: compress(f), "its pixels are stored as JPEG Lossless, Non-Hierarchical, First-Order Prediction"),
    ],
)
def test_contradictions_are_one_line(spoil, message, scan, tmp_path):
    spoil(scan)
    import_refused(tmp_path / "clinic", lambda: import_dicom_ct_pd(scan, tmp_path / "clinic"), message)


def compress(folder):
    for path in folder.glob("*.dcm"):
        one = pydicom.dcmread(path)
        one.file_meta.TransferSyntaxUID = JPEGLosslessSV1
        one.PixelData = encapsulate([b"\xff\xd8"])
        one["PixelData"].is_undefined_length = True
        one.save_as(path)


def swap(folder):
    for path in folder.glob("*.dcm"):
        one = pydicom.dcmread(path)
        one[pd.SPOT_ANGLE].value, one[pd.SPOT_Z].value = one[pd.SPOT_Z].value, one[pd.SPOT_ANGLE].value
        one.save_as(path)


def test_swapped_shifts_are_corrected_on_request(scan, tmp_path):
    swap(scan)
    recording = import_dicom_ct_pd(scan, tmp_path / "clinic", swapped_shifts=True)
    np.testing.assert_allclose(recording.geometry.source_mm, GEOMETRY.source_mm, atol=2e-4)


def test_independent_reader_finds_the_same(written):
    """pyxu-ldct-reader 1.0.0, if it is installed; its angles of elements are about the isocenter."""
    reader = pytest.importorskip("pyxu_ldct_reader.reader", reason="pyxu-ldct-reader is not installed")
    if not hasattr(pydicom, "read_file"):
        pydicom.read_file = pydicom.dcmread  # called by the reader, and removed in pydicom 3
    values, ways, starts = reader.load_projections(str(written))
    assert values.shape == (40, 92, 8)
    np.testing.assert_allclose(values.transpose(0, 2, 1)[:, ::-1], LINES, atol=1e-4)
    x, y, z = np.moveaxis(starts[:, 0, 0], -1, 0)
    np.testing.assert_allclose(np.stack([y, x, -z], axis=1), GEOMETRY.source_mm, atol=1e-3)
    # The central column is in both on the central ray, also along z.
    middle = round(float((92 + 1) / 2 - GEOMETRY.column_offset_px)) - 1
    x, y, z = np.moveaxis(ways[:, middle], -1, 0)
    expected = np.array(
        [[np.subtract(*GEOMETRY.ray(view, 7 - row, middle)[::-1]) for row in range(8)] for view in range(40)]
    )
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.stack([y, x, -z], axis=-1), expected, atol=2e-3)
