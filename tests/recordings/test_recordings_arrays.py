"""Import of projections that other packages wrote: TIFF, PNG, NumPy, MATLAB, HDF5 and Nikon files."""

from pathlib import Path

import h5py
import imageio.v3 as imageio
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.io import savemat
from scipy.sparse import csr_matrix

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.candidate_effects import candidate_conditions, candidates
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.recordings.importers.arrays import read_frames
from virtual_phantom.recordings.importers.command import main
from virtual_phantom.recordings.importers.projections import arranged, import_projections, read_angles
from virtual_phantom.recordings.importers.xtekct import import_xtekct
from virtual_phantom.recordings.summary import summarize_recording

VIEWS, ROWS, COLUMNS = 12, 3, 40
WHITE, DARK = 40_000.0, 100.0
PARALLEL = {"beam": "parallel", "pixel": [0.65], "unit": "um", "angles": "0,15"}
FAN = {"source_to_axis": 500, "source_to_detector": 1000, "pixel": [8.0], "angles": "0,30"}


def line_integrals(views=VIEWS):
    column = np.arange(COLUMNS) - (COLUMNS - 1) / 2
    return np.exp(-((column - np.arange(views)[:, None, None] / 4) ** 2) / 40) * np.ones((views, ROWS, 1))


def counts():
    return np.rint(DARK + (WHITE - DARK) * np.exp(-line_integrals())).astype(np.uint16)


FLATS, DARKS = np.full((2, ROWS, COLUMNS), WHITE, np.float32), np.full((ROWS, COLUMNS), DARK, np.float32)


def tiff(folder):
    tifffile.imwrite(folder / "ct.tif", counts())
    tifffile.imwrite(folder / "flat.tiff", FLATS)
    tifffile.imwrite(folder / "dark.tif", DARKS)
    return folder / "ct.tif", {"flat": folder / "flat.tiff", "dark": folder / "dark.tif"}


def png_folder(folder):
    (folder / "views").mkdir()
    for number, image in enumerate(counts(), start=1):  # view_10 follows view_9
        imageio.imwrite(folder / "views" / f"view_{number}.png", image)
    return folder / "views", {"flat": WHITE, "dark": DARK}


def numpy_file(folder):
    np.save(folder / "ct.npy", counts().transpose(2, 0, 1))
    np.save(folder / "flat.npy", FLATS)
    return folder / "ct.npy", {"axes": "cvr", "flat": folder / "flat.npy", "dark": DARK}


def data_exchange(folder):
    with h5py.File(folder / "ct.h5", "w") as file:
        file["exchange/data"], file["exchange/data_white"] = counts(), FLATS
        file["exchange/data_dark"] = DARKS[None]
        file["exchange/theta"] = np.radians(15.0 * np.arange(VIEWS))
        file["exchange/theta"].attrs["units"] = "radians"
    return folder / "ct.h5", {"angles": None}


def nexus(folder):
    keys = [2, *[0] * VIEWS, 1, 1]
    with h5py.File(folder / "ct.nxs", "w") as file:
        detector = file.create_group("entry1/tomo_entry/instrument/detector")
        detector["data"] = np.concatenate([DARKS[None], counts(), FLATS]).astype(np.uint16)
        detector["image_key"] = keys
        file["entry1/tomo_entry/data/data"] = detector["data"]  # the same array under a second name, as NXtomo has it
        angles = np.zeros(len(keys))
        angles[1 : VIEWS + 1] = 15.0 * np.arange(VIEWS)
        file["entry1/tomo_entry/sample/rotation_angle"] = angles
    return folder / "ct.nxs", {"angles": None}


def matlab_73(folder):
    with h5py.File(folder / "ct.mat", "w") as file:
        file["scan"] = counts().T  # MATLAB's first axis is the last of HDF5
        file["note"] = np.zeros((1, 5))
    return folder / "ct.mat", {"flat": WHITE, "dark": DARK}


@pytest.mark.parametrize("write", [tiff, png_folder, numpy_file, data_exchange, nexus, matlab_73])
def test_counts_of_other_writers_give_the_same_line_integrals(write, tmp_path):
    source, options = write(tmp_path)
    given_options = {key: value and str(value) for key, value in (PARALLEL | options).items() if key not in ("pixel",)}
    recording = import_projections(source, tmp_path / "scan", **given_options, pixel=[0.65])
    np.testing.assert_allclose(recording.repeats[0].line_integrals(1e-4), line_integrals(), atol=1e-4)
    geometry = recording.geometry
    np.testing.assert_allclose(np.degrees(geometry.angles_rad), 15 * np.arange(VIEWS), atol=1e-9)
    assert geometry.parallel and geometry.column_pitch_mm == pytest.approx(0.00065)


def test_matlab_sinogram_in_detector_elements(tmp_path):
    savemat(tmp_path / "s.mat", {"data": line_integrals()[:, 0].T + 0.3, "angles": np.arange(VIEWS)[None]})
    options = FAN | {"pixel": [1.0], "source_to_axis": 3492, "source_to_detector": 3492, "unit": "element"}
    recording = import_projections(tmp_path / "s.mat", tmp_path / "fan", axes="cv", log=True, air_columns=2, **options)
    np.testing.assert_allclose(recording.repeats[0].data[:, 0], line_integrals()[:, 0], atol=0.01)
    geometry = recording.geometry
    assert geometry.source_to_isocentre_mm == 3492 and geometry.column_pitch_mm / geometry.magnification == 1
    assert "lengths are in detector elements" in recording.notes[0]
    assert "elements" in summarize_recording(recording)["text"]
    tried = candidates(RecordingSettings(None, None, {}), **candidate_conditions(recording.document.content))
    assert {"optical_crosstalk", "detector_offset", "gain_pattern"} <= set(tried)
    assert not {"spectrum", "focal_spot", "veiling_glare", "source_distance"} & set(tried)
    stated = candidate_conditions(recording.document.content | {"nominal": {"photons": 1e5}})
    assert set(candidates(RecordingSettings(None, None, {}), **stated)) == {*tried, "photon_flux"}


@settings(max_examples=30, deadline=None)
@given(order=st.permutations("vrc"), reversed_axes=st.sets(st.sampled_from("vrc")))
def test_axes_are_put_into_order(order, reversed_axes):
    array = np.arange(24).reshape(2, 3, 4)
    stored = array.transpose(["vrc".index(letter) for letter in order])
    stored = stored[tuple(slice(None, None, -1 if letter in reversed_axes else None) for letter in order)]
    axes = "".join(letter.upper() if letter in reversed_axes else letter for letter in order)
    np.testing.assert_array_equal(arranged(stored, axes, "file"), array)


def test_pixels_are_averaged_and_clipped_values_are_reported(tmp_path, caplog):
    data = np.full((VIEWS, 4, COLUMNS), 255, np.uint8)
    data[:, :, 10:14] = np.arange(4) * 20 + 100
    np.save(tmp_path / "ct.npy", data)
    for factor, text in (
        (1, "values have 8 bits"),
        (2, "90 % of the values are 255, the largest one: they were clipped"),
    ):
        recording = import_projections(
            tmp_path / "ct.npy", tmp_path / f"bin{factor}", flat="255", bin=factor, **FAN | {"pixel": [8.0 / factor]}
        )
        assert any(text in line for line in (*recording.notes, recording.nominal.get("notes", "")))
        assert recording.geometry.columns == COLUMNS // factor and recording.geometry.rows == 4 // factor
    assert recording.geometry.column_pitch_mm == 8
    np.testing.assert_array_equal(recording.repeats[0].data[0, 0, 4:8], [255, 110, 150, 255])
    assert "no dark field" in caplog.text


def test_angles_from_a_list(tmp_path):
    np.save(tmp_path / "ct.npy", line_integrals())
    golden = (111.25 * np.arange(VIEWS)) % 360
    np.savetxt(tmp_path / "golden.txt", golden)
    uneven = np.cumsum([0, 1, 2, *[3] * (VIEWS - 3)]) - 170.0
    np.savetxt(tmp_path / "uneven.csv", np.column_stack([np.arange(VIEWS), uneven]), delimiter=",", header="view,angle")
    for name, angles, listed in (("golden.txt", golden, False), ("uneven.csv", uneven, True)):
        options = PARALLEL | {"angles": str(tmp_path / name)}
        recording = import_projections(tmp_path / "ct.npy", tmp_path / name[:6], log=True, **options)
        difference = np.degrees(recording.geometry.angles_rad) - angles
        np.testing.assert_allclose((difference + 180) % 360 - 180, 0, atol=1e-4)
        assert ("angles_deg" in recording.scan) == listed


@pytest.mark.parametrize("axes", ["vRc", "vrC", "cRv", "vCR"])
@pytest.mark.parametrize("inside", [False, True])
def test_fields_have_the_axes_of_the_projections(axes, inside, tmp_path):
    letters, flat = axes.lower(), 500.0 + np.arange(COLUMNS**2).reshape(COLUMNS, COLUMNS)
    stored = flat * np.exp(-np.ones((VIEWS, 1, 1)))
    reverse = tuple(slice(None, None, -1 if letter.isupper() else None) for letter in axes)
    data = stored.transpose(["vrc".index(letter) for letter in letters])[reverse]
    field = flat.transpose(["rc".index(letter) for letter in letters if letter != "v"])
    field = field[tuple(part for part, letter in zip(reverse, letters, strict=True) if letter != "v")]
    with h5py.File(tmp_path / "ct.h5", "w") as file:
        file["exchange/data"] = data
        if inside:
            file["exchange/data_white"] = field[None]
    np.save(tmp_path / "flat.npy", field)
    given = {} if inside else {"flat": str(tmp_path / "flat.npy")}
    recording = import_projections(tmp_path / "ct.h5", tmp_path / "scan", axes=axes, **given, **FAN)
    np.testing.assert_array_equal(recording.repeats[0].white, flat)
    np.testing.assert_allclose(recording.repeats[0].line_integrals(1e-4), 1, atol=1e-5)


def test_angles_and_fields_of_other_writers(tmp_path):
    np.save(tmp_path / "ct.npy", counts()[:, 0])
    angles, flat = 30.0 * np.arange(VIEWS), np.full(COLUMNS, WHITE)
    savemat(tmp_path / "angles.mat", {"theta": angles})
    savemat(tmp_path / "flat.mat", {"flat": flat[:, None]})
    np.savetxt(tmp_path / "angles", angles)
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["exchange/data"], file["exchange/data_white"] = counts()[:, :1], flat[None, None]
        file["exchange/theta"] = np.radians(angles)
        file["exchange/theta"].attrs["units"] = "radians"
    with h5py.File(tmp_path / "fields.h5", "w") as file:
        file["exchange/data_white"], file["exchange/data_dark"] = flat[None, None], 0 * flat[None, None]
    for listed, field in (("angles.mat", "flat.mat"), ("angles", "scan.h5"), ("scan.h5", "fields.h5")):
        options = FAN | {"angles": str(tmp_path / listed), "flat": str(tmp_path / field)}
        recording = import_projections(tmp_path / "ct.npy", tmp_path / f"{listed[:4]}{field[:4]}", **options)
        np.testing.assert_allclose(np.degrees(recording.geometry.angles_rad), angles, atol=1e-9)
        assert (recording.repeats[0].white == WHITE).all()
    options |= {"dark": str(tmp_path / "scan.h5")}
    with pytest.raises(InputError, match=r"scan\.h5: has no dark field; give a file with dark frames"):
        import_projections(tmp_path / "ct.npy", tmp_path / "other", **options)
    with pytest.raises(InputError, match=r"fields\.h5: has no projections"):
        import_projections(tmp_path / "fields.h5", tmp_path / "other", **FAN)


XTEKCT = """[XTekCT]
SrcToObject=20.5
SrcToDetector=900
DetectorPixelsX=40
DetectorPixelSizeX=0.2
DetectorPixelsY=3
DetectorPixelSizeY=0.2
Units=mm
WhiteLevel=40000
InitialAngle=10.0
AngularStep=30.0
[Xrays]
XraykV=70
XrayuA=300
TargetMaterial=Tungsten
[DICOM]
DICOMTags=<?xml version="1.0"?><Tag>100%</Tag>
"""


def test_nikon_scan(tmp_path):
    (tmp_path / "scan.xtekct").write_text(XTEKCT)
    (tmp_path / "images").mkdir()
    rising = (counts() - np.arange(ROWS, dtype=np.uint16)[:, None]).astype(np.uint16)  # the top row comes first
    for number, image in enumerate(rising):
        tifffile.imwrite(tmp_path / "images" / f"scan_{number:04d}.tif", image)
    recording = import_xtekct(tmp_path / "scan.xtekct", tmp_path / "balls", images=str(tmp_path / "images"))
    np.testing.assert_array_equal(recording.repeats[0].data, rising[:, ::-1])
    assert recording.repeats[0].white.max() == 40_000
    assert np.degrees(recording.geometry.angles_rad[:2]) == pytest.approx([10, 40])
    assert recording.nominal["tube_kvp"] == 70 and recording.nominal["tube_current_ma"] == 0.3
    angles = "".join(f"{view + 1}:\t{-30 * view:.3f}\n" for view in range(VIEWS))
    (tmp_path / "scan.ang").write_text(f"Proj\tAngle(deg)\n{angles}")
    listed = import_xtekct(tmp_path / "scan.xtekct", tmp_path / "listed", images=str(tmp_path / "images"))
    assert np.degrees(listed.geometry.angles_rad[:2]) == pytest.approx([0, 30])  # the direction of AngularStep
    (tmp_path / "scan.ang").write_text("Proj\tAngle(deg)\n1:\t000.000\n2:\t-030.000\n")
    with pytest.raises(InputError, match="has 2 angles for 12 views"):
        import_xtekct(tmp_path / "scan.xtekct", tmp_path / "other", images=str(tmp_path / "images"))


@pytest.mark.parametrize(
    "stated, changed, message",
    [
        ("DetectorPixelsX=40", "DetectorPixelsX=inf", "DetectorPixelsX is inf; give a finite number"),
        ("DetectorPixelSizeX=0.2", "DetectorPixelSizeX=0", "DetectorPixelSizeX is 0; give a number above 0"),
        ("SrcToObject=20.5", "SrcToObject=0\nObjectOffsetX=1", "SrcToObject is 0; give a number above 0"),
        ("WhiteLevel=40000", "WhiteLevel=0", "WhiteLevel is 0; give a number above 0"),
        ("AngularStep=30.0", "AngularStep=", "AngularStep is ''; give a number"),
        ("AngularStep=30.0", "AngularStep=0", "all views have the angle 10"),
        ("XraykV=70", "XraykV=70 kV", "XraykV is '70 kV'; give a number"),
        ("SrcToObject=20.5", "SrcToObject=20,5", "SrcToObject is '20,5'; give a number with a decimal point"),
        ("[XTekCT]", "", "(MissingSectionHeaderError); give the .xtekct file of the scan"),
        ("XrayuA=300", "XrayuA=", None),
        ("[XTekCT]", "\ufeff[XTekCT]", None),
    ],
)
def test_numbers_of_nikon_files_are_checked(tmp_path, stated, changed, message):
    assert stated in XTEKCT
    (tmp_path / "scan.xtekct").write_text(XTEKCT.replace(stated, changed, 1), encoding="utf-8")
    for number, image in enumerate(counts()):
        tifffile.imwrite(tmp_path / f"scan_{number:04d}.tif", image)
    if message is None:
        assert import_xtekct(tmp_path / "scan.xtekct", tmp_path / "balls").geometry.views == VIEWS
        return
    with pytest.raises(InputError) as error:
        import_xtekct(tmp_path / "scan.xtekct", tmp_path / "balls")
    assert message in str(error.value)


def test_nikon_scan_with_a_flat_field_beside_its_images(tmp_path):
    (tmp_path / "scan.xtekct").write_text(XTEKCT.replace("WhiteLevel=40000\n", ""))
    (tmp_path / "scan.ang").write_text("Proj\tAngle(deg)\n")
    for number, image in enumerate(counts()):
        tifffile.imwrite(tmp_path / f"scan_{number:04d}.tif", image)
    bright = FLATS[0] + np.arange(ROWS, dtype=np.float32)[:, None]
    tifffile.imwrite(tmp_path / "flat.tif", bright)
    flat = str(tmp_path / "flat.tif")
    with pytest.raises(InputError, match=r"scan\.ang: has 0 angles for 12 views"):
        import_xtekct(tmp_path / "scan.xtekct", tmp_path / "balls", flat=flat)
    (tmp_path / "scan.ang").unlink()
    recording = import_xtekct(tmp_path / "scan.xtekct", tmp_path / "balls", flat=flat)
    assert recording.geometry.views == VIEWS
    np.testing.assert_array_equal(recording.repeats[0].white, bright[::-1])  # the top row comes first


@pytest.mark.parametrize("stated", ["CentreOfRotationTop=1.2\nCentreOfRotationBottom=0.8", "ObjectOffsetX=0.03"])
def test_nikon_offsets_place_the_axis_of_rotation(tmp_path, stated):
    """CIL 21: detector at (-DetectorOffsetX, ., DetectorOffsetY), axis at -ObjectOffsetX, columns along -x."""
    text = XTEKCT.replace("[Xrays]", f"DetectorOffsetX=-0.6\nDetectorOffsetY=0.4\n{stated}\n[Xrays]")
    assert text != XTEKCT
    (tmp_path / "scan.xtekct").write_text(text)
    for number, image in enumerate(counts()):
        tifffile.imwrite(tmp_path / f"scan_{number:04d}.tif", image)
    geometry = import_xtekct(tmp_path / "scan.xtekct", tmp_path / "balls").geometry
    binned = import_xtekct(tmp_path / "scan.xtekct", tmp_path / "binned", bin=3).geometry  # drops the last column
    assert binned.column_positions_mm() == pytest.approx(geometry.column_positions_mm()[1:-1:3])
    assert binned.row_positions_mm() == pytest.approx(geometry.row_positions_mm()[1::3])
    enlarged = geometry.magnification
    axis_mm, detector_mm = -enlarged * (0.03 if "Object" in stated else 1 / enlarged), 0.6  # x on the detector's plane
    expected = (detector_mm - axis_mm) / geometry.column_pitch_mm + (COLUMNS - 1) / 2
    assert -geometry.column_positions_mm()[0] / geometry.column_pitch_mm == pytest.approx(expected)
    assert geometry.row_positions_mm().mean() == pytest.approx(0.4)


MISTAKES = {
    "counts need a flat field; give --flat, --air-columns, or --log": {},
    "--axes vc does not fit the shape (12, 3, 40)": {"axes": "vc", "log": True},
    "--axes vvc does not fit the shape": {"axes": "vvc", "log": True},
    "the flat field has shape (3, 41), but a projection has 3 rows and 40 columns": {"flat": "wide.npy"},
    "states no view angles; give --angles START,STEP, a file, or unknown": {"log": True, "angles": None},
    "is neither a file nor START,STEP": {"log": True, "angles": "all"},
    "has 3 angles for 12 views": {"log": True, "angles": "three.txt"},
    "an angle is not finite": {"log": True, "angles": "0,nan"},
    "all views have the angle 30": {"log": True, "angles": "30,360"},
    "radians.txt: the angles span 5.76, about 2 pi, so they are in radians": {"log": True, "angles": "radians.txt"},
    "commas.csv: has several numbers in a line; give one angle per line": {"log": True, "angles": "commas.csv"},
    "exposures.csv: has several numbers in a line": {"log": True, "angles": "exposures.csv"},
    "is neither a file nor START,STEP;": {"log": True, "angles": ",".join(map(str, range(999)))},
    "--flat has no effect with line integrals; remove one of them": {"log": True, "flat": "1"},
    "--dark has no effect with line integrals": {"log": True, "dark": "0"},
    "--flat has no effect with --air-columns": {"flat": "1", "air_columns": 2},
    "--source-to-axis has no effect with --beam parallel": {"log": True, "source_to_axis": 500},
    "--pixel: has 3 numbers; give the width, or the width and height": {"log": True, "pixel": [1, 1, 1]},
    "--bin 0: use 1 to 40, the number of detector columns": {"log": True, "bin": 0},
    "--bin 41: use 1 to 40": {"log": True, "bin": 41},
    "--bin 4: use 1 to 3, the number of detector rows": {"log": True, "bin": 4},
    "words.npy: holds values of type <U1; give an array of numbers": {"flat": "words.npy"},
    "two.npz: has 2 arrays (a and b); name one with --dataset (write fields and angles": {"flat": "two.npz"},
    "words.npy: holds values of type <U1;": {"log": True, "angles": "words.npy"},
    "none.npz: has no array of numbers; it has none; give": {"log": True, "angles": "none.npz"},
    "utf16.txt: is not text in UTF-8 (perhaps in UTF-16)": {"log": True, "angles": "utf16.txt"},
    "the largest count is 1 above the dark field, the white field 40000": {"flat": "40000"},
    "is empty; give a file or folder": {"flat": ""},
    "a divergent beam needs --source-to-axis and --source-to-detector": {"log": True, "beam": "divergent"},
    "--air-columns 20 does not fit 40 columns": {"log": True, "air_columns": 20},
    "scan.source_to_isocentre_mm: 50 is less than the minimum of 100": {
        **{"log": True, "beam": "divergent", "source_to_axis": 50, "source_to_detector": 900, "pixel": [0.2]},
        "unit": "mm",
    },
}


@pytest.mark.parametrize("message", MISTAKES)
def test_mistakes_are_one_line_and_leave_nothing(message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("ct.npy", line_integrals())
    np.save("wide.npy", np.ones((ROWS, COLUMNS + 1)))
    np.save("words.npy", np.full((ROWS, COLUMNS), "a"))
    np.savez("two.npz", a=np.ones((ROWS, COLUMNS)), b=np.ones((ROWS, COLUMNS)))
    np.savez("none.npz")
    np.savetxt("utf16.txt", 15 * np.arange(VIEWS), encoding="utf-16")
    np.savetxt("three.txt", [1, 2, 3])
    np.savetxt("radians.txt", np.radians(30 * np.arange(VIEWS)))
    Path("commas.csv").write_text("".join(f"{15 * view // 2},{15 * view % 2 * 5}\n" for view in range(VIEWS)))
    Path("exposures.csv").write_text("angle,ms\n" + "".join(f"{30 * view},100\n" for view in range(VIEWS)))
    with pytest.raises(InputError) as error:
        import_projections("ct.npy", tmp_path / "scan", **PARALLEL | MISTAKES[message])
    assert message in str(error.value) and "\n" not in str(error.value)
    assert not (tmp_path / "scan").exists()


def test_unreadable_and_ambiguous_files(tmp_path):
    savemat(tmp_path / "two.mat", {"a": np.ones((4, 5)), "b": np.ones((4, 5))})
    (tmp_path / "broken.tif").write_bytes(b"II*\0 broken")
    (tmp_path / "scan.raw").write_bytes(b"0")
    (tmp_path / "mixed").mkdir()
    for name, shape in (("a.png", (4, 5)), ("b.png", (4, 6))):
        imageio.imwrite(tmp_path / "mixed" / name, np.zeros(shape, np.uint8))
    for name, message in {
        "two.mat": "has 2 arrays (a and b); name one with --dataset",
        "broken.tif": "cannot be read as image",
        "scan.raw": "has an unknown format",
        "mixed": "keep only the projections in this folder",
        "none.npy": "no such file",
    }.items():
        with pytest.raises(InputError, match=".*") as error:
            read_frames(tmp_path / name)
        assert message in str(error.value), name
    assert read_frames(tmp_path / "two.mat", "b").data.shape == (4, 5)
    np.save(tmp_path / "one.npy", np.ones((4, 5)))
    for name in ("one.npy", "mixed"):
        with pytest.raises(InputError, match=f"{name}: has no named arrays, so --dataset b has no effect; remove it"):
            read_frames(tmp_path / name, "b")


def test_pages_that_were_written_one_by_one_are_all_read(tmp_path):
    with tifffile.TiffWriter(tmp_path / "pages.tif") as file:
        for image in counts():
            file.write(image)
    np.testing.assert_array_equal(read_frames(tmp_path / "pages.tif").data, counts())
    tifffile.imwrite(tmp_path / "pages.tif", counts()[0].astype(np.float32), append=True)
    with pytest.raises(InputError, match="has pages of different types or shapes"):
        read_frames(tmp_path / "pages.tif")


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "P"])
def test_color_images_are_rejected(tmp_path, mode):
    Image.fromarray(np.zeros((3, 4), np.uint8)).convert(mode).save(tmp_path / "image.png")
    with pytest.raises(InputError, match="image.png: is a color image; use gray images"):
        read_frames(tmp_path / "image.png")


@pytest.mark.parametrize("extra", ["flat.tif", "view_3 (1).tif", "other_3.tif"])
def test_folder_with_other_images_is_rejected(tmp_path, extra):
    for number, image in enumerate(counts()):
        tifffile.imwrite(tmp_path / f"view_{number}.tif", image)
    (tmp_path / "._view_0.tif").write_bytes(b"resource fork of another system")
    tifffile.imwrite(tmp_path / extra, FLATS[0].astype(np.uint16))
    with pytest.raises(InputError, match="keep only the projections in this folder") as error:
        read_frames(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / extra}: its name differs from view_# (#: a number)")
    np.testing.assert_array_equal(read_frames(tmp_path, others=[tmp_path / extra]).data, counts())


@pytest.mark.parametrize(
    "names, message",
    [
        (["0.5", "0.25", "0.75"], "such as view_0.5.tif and view_0.75.tif, so that their order is not clear; number"),
        (["1", "2", "02"], "view_2.tif: has the same number as view_02.tif; keep only one image of each view"),
        (["1", "2", "2.png"], "view_2.tif: has the same number as view_2.png; keep only one image of each view"),
        (["0.50", "0.75", "1.00"], None),
        (["1.2.9", "1.2.10", "1.2.11"], None),
        (["1.8", "1.9", "1.10"], None),
    ],
)
def test_images_whose_order_is_not_clear_are_rejected(names, message, tmp_path):
    for value, name in enumerate(names):
        path = tmp_path / f"view_{name if name.endswith('png') else f'{name}.tif'}"
        imageio.imwrite(path, np.full((3, 4), value, np.uint8))
    if message is None:
        assert read_frames(tmp_path).data[:, 0, 0].tolist() == [0, 1, 2]
        return
    with pytest.raises(InputError) as error:
        read_frames(tmp_path)
    assert message in str(error.value)


def test_gap_in_the_numbers_of_images_is_reported(tmp_path, caplog):
    for number, image in enumerate(counts()):
        tifffile.imwrite(tmp_path / f"view_{number}.tif", image)
    read_frames(tmp_path)
    assert not caplog.text
    (tmp_path / "view_5.tif").unlink()
    read_frames(tmp_path)
    assert "view_4.tif: the next image is view_6.tif; if a view is missing" in caplog.text


def test_fields_of_data_exchange_are_never_taken_as_projections(tmp_path):
    with h5py.File(tmp_path / "ct.h5", "w") as file:
        file["exchange/data"], file["exchange/data_white"] = counts(), np.repeat(FLATS, VIEWS, axis=0)
        file["exchange/data_dark"] = np.zeros((0, ROWS, COLUMNS))
    frames = read_frames(tmp_path / "ct.h5")
    np.testing.assert_array_equal(frames.data, counts())
    assert len(frames.flat) == 2 * VIEWS and frames.dark is None
    with pytest.raises(InputError, match="has no dataset exchange; it has exchange/data"):
        read_frames(tmp_path / "ct.h5", "exchange")


def test_scan_without_projections_and_sparse_arrays_are_rejected(tmp_path):
    with h5py.File(tmp_path / "flats.nxs", "w") as file:
        file["data"], file["image_key"], file["rotation_angle"] = FLATS, [1, 1], [0.0, 0.0]
    savemat(tmp_path / "sparse.mat", {"a": csr_matrix(np.eye(4))})
    with pytest.raises(InputError, match="has no projections"):
        import_projections(tmp_path / "flats.nxs", tmp_path / "scan", **PARALLEL)
    with pytest.raises(InputError, match="holds values of type csc_matrix; give an array of numbers"):
        import_projections(tmp_path / "sparse.mat", tmp_path / "scan", dataset="a", **PARALLEL)


@pytest.mark.parametrize(
    "text",
    ["0\n15\n30\n", "# angles 3\n0\n15\n30\n", "\ufeff0\n15\n30\n", "0 15 30\n", "view;angle\n7;0\n8;15\n9;30\n"],
)
def test_lists_of_angles(tmp_path, text):
    (tmp_path / "angles.txt").write_text(text, encoding="utf-8")
    assert read_angles(tmp_path / "angles.txt").tolist() == [0, 15, 30]


def test_folder_that_cannot_be_made_is_one_line(tmp_path):
    np.save(tmp_path / "ct.npy", line_integrals())
    with pytest.raises(InputError, match="scan: cannot be written .* use another folder"):
        import_projections(tmp_path / "ct.npy", tmp_path / "ct.npy" / "scan", log=True, **PARALLEL)


def test_command_prints_the_configuration_of_an_unknown_object(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.save("ct.npy", counts())
    options = "--flat 40000 --dark 100 --angles unknown --beam parallel --unit element"
    assert main(["projections", "ct.npy", "frames", *options.split()]) == 0
    printed = capsys.readouterr().out
    assert "unknown angles" in printed and "object: {unknown: true}" in printed
    assert "the view angles are not known" in printed


def test_command_takes_a_negative_start_angle(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.save("ct.npy", line_integrals())
    assert main(["projections", "ct.npy", "lines", "--log", "--beam", "parallel", "--angles", "-90,15"]) == 0
    assert "start_angle_deg -90" in capsys.readouterr().out
