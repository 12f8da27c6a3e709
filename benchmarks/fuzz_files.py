"""Count how often a wrong header of a NIfTI, RTSTRUCT or SEG file is rejected, reported or misread (minutes).

Each run changes one to three fields of a header. The outcomes are:

* refused: an InputError of one line
* same: no voxel differs by more than 1 HU, moves by more than one voxel, or changes its region
* reported: the result differs, and a note gives the reason
* stated: the result differs as the header says, and an independent reader gives the same voxels and positions
* silent: the result differs without a note
* traceback: any other exception

The last two are faults: they are printed, and the exit status is 1.
"""

import copy
import logging
import tempfile
import traceback
import warnings
from collections import Counter
from functools import partial
from pathlib import Path

import nibabel
import numpy as np
import pydicom
import SimpleITK as sitk
from pydicom.datadict import dictionary_VR
from pydicom.dataelem import RawDataElement
from pydicom.tag import Tag

from virtual_phantom.base.console import collected_notes
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.settings import RoiEntry
from virtual_phantom.phantom.ct import draw_entry, read_hu

GRID = Grid((12, 30, 34), (3.0, 2.0, 2.0), (5.0, -40.0, 300.0))
LARGEST_HU = 1.0
FAULTS = ("silent", "traceback")


def object_hu():
    """Cylinder with two balls and noise, int16 [z, y, x], and a label map of the balls."""
    z, y, x = np.ix_(*GRID.axes_mm())
    hu = np.where((x / 28) ** 2 + (y / 24) ** 2 + 0 * z < 1, 0.0, -1000.0)
    labels = np.zeros(GRID.shape, np.uint8)
    for label, (x0, y0, z0) in {1: (11, 6, 3), 2: (-12, -7, -3)}.items():
        labels[(x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2 < 81] = label
    hu += 40 * (labels == 1) - 60 * (labels == 2) + np.random.default_rng(0).normal(0, 8, GRID.shape)
    return np.rint(hu).astype(np.int16), labels


def outcome(read, same, independent=None):
    """Outcome of one file, and the text to print for a fault.

    `read` returns the result, `same` whether a result equals the unmodified file's, and `independent` whether another
    reader gives the same result.
    """
    try:
        with collected_notes() as notes:
            result = read()
    except InputError as error:
        text = str(error)
        return ("refused", "") if text and text.isprintable() else ("traceback", text)
    except Exception:
        return "traceback", traceback.format_exc()
    if same(result):
        return "same", ""
    if notes:
        return "reported", ""
    return ("stated", "") if independent and independent(result) else ("silent", "")


# NIfTI

# Fields of a NIfTI-1 header without those of Analyze that no reader uses (data_type, db_name, extents, glmax, ...).
NIFTI_FIELDS = tuple(
    """sizeof_hdr dim_info dim intent_p1 intent_p2 intent_p3 intent_code datatype bitpix slice_start pixdim vox_offset
    scl_slope scl_inter slice_end slice_code xyzt_units cal_max cal_min slice_duration toffset descrip aux_file
    qform_code sform_code quatern_b quatern_c quatern_d qoffset_x qoffset_y qoffset_z srow_x srow_y srow_z
    intent_name magic""".split()
)
INTEGERS = (0, 1, -1, 2, 3, 4, 8, 16, 32, 64, 128, 255, 256, 512, 768, 1024, 1280, 2304, 32767, -32768)
FLOATS = (0.0, -1.0, 0.5, 1.0, 2.0, 352.0, 368.0, 1e-3, 1e3, 1e30, -1e30, np.nan, np.inf, 3.4e38, 1e-40)
TEXTS = (b"", b"n+1", b"ni1", b"n+2", b"\xff" * 4, b"\x00" * 4)


def odd_nifti(header, random):
    """Change one field of a header, or one number of a field with several."""
    field = NIFTI_FIELDS[random.integers(len(NIFTI_FIELDS))]
    value = header[field].reshape(-1)  # a view of the header
    if value.dtype.kind == "S":
        value[0] = TEXTS[random.integers(len(TEXTS))]
        return
    choices = FLOATS if value.dtype.kind == "f" else INTEGERS
    odd = np.array(choices[random.integers(len(choices))])
    near = random.random() < 0.4  # wrong by a little, or by a sign
    for place in random.integers(value.size, size=random.integers(1, 3)):
        old = value[place]
        changed = old * random.choice([-1, 2, 0.1, 1000]) + random.choice([0, 1, -1]) if near else odd
        with np.errstate(all="ignore"):
            value[place] = np.array(changed).astype(value.dtype)


def fuzz_nifti(runs, seed, folder):
    """Fuzz headers of a CT and of its label map in turn."""
    hu, labels = object_hu()
    paths = {"ct": folder / "ct.nii", "labels": folder / "labels.nii"}
    contents = {}
    for name, array in (("ct", hu), ("labels", labels)):
        image = nibabel.Nifti1Image(array.T, GRID.affine)
        image.set_sform(GRID.affine, 1)
        image.set_qform(GRID.affine, 1)
        contents[name] = image.to_bytes()
    random, counts, faults = np.random.default_rng(seed), Counter(), []
    for number in range(runs):
        name = ("ct", "labels")[number % 2]
        header = np.frombuffer(contents[name][:348], nibabel.nifti1.header_dtype).copy()
        for _ in range(random.choice([1, 1, 1, 2, 3])):
            odd_nifti(header, random)
        paths[name].write_bytes(header.tobytes() + contents[name][348:])
        if name == "ct":
            found, text = outcome(lambda: read_hu(paths["ct"]), same_ct(hu), by_simpleitk(paths["ct"]))
        else:
            found, text = outcome(lambda: masks(paths["labels"]), same_masks(labels))
        counts[found] += 1
        if found in FAULTS:
            faults.append((found, name, changes(contents[name], header), text))
    return counts, faults


def changes(content, header):
    before = np.frombuffer(content[:348], nibabel.nifti1.header_dtype)
    return {
        key: (before[key], header[key]) for key in before.dtype.names if before[key].tobytes() != header[key].tobytes()
    }


def same_ct(hu):
    """Whether a volume is the object's: values to 1 HU, every corner to one voxel."""

    def same(volume):
        if volume.array.shape != hu.shape or np.abs(volume.array - hu).max() > LARGEST_HU:
            return False
        ends = np.array([(i, j, k, 1) for i in (0, 33) for j in (0, 29) for k in (0, 11)]).T
        distances = np.abs(((volume.grid.affine - GRID.affine) @ ends)[:3]).max(axis=1)
        return bool((distances <= GRID.spacing[::-1]).all())

    return same


def by_simpleitk(path):
    """Whether SimpleITK reads the same values at the same positions."""

    def agrees(volume):
        try:
            image = sitk.DICOMOrient(sitk.ReadImage(str(path), sitk.sitkFloat64), "LPS")  # left, posterior, superior
        except RuntimeError:
            return False
        if image.GetDimension() != 3:
            return False
        array = sitk.GetArrayFromImage(image)[:, ::-1, ::-1]
        nz, ny, nx = array.shape
        first = image.TransformIndexToPhysicalPoint((nx - 1, ny - 1, 0))
        start = np.array([-first[0], -first[1], first[2]])
        return (
            array.shape == volume.array.shape
            and np.allclose(array, volume.array, rtol=1e-5, atol=LARGEST_HU)
            and np.allclose(image.GetSpacing(), volume.grid.spacing[::-1], rtol=1e-3)
            and bool((np.abs(start - volume.grid.affine[:3, 3]) <= volume.grid.spacing[::-1]).all())
        )

    return agrees


def masks(path, names=(1, 2)):
    """Both regions of a file, as a study reads them: an empty one is refused."""
    opened = {}
    return [draw_entry(RoiEntry("roi", "class", str(path), name), GRID, opened)[0] for name in names]


def same_masks(labels):
    """Whether masks are those of the object, voxel by voxel."""
    return lambda found: all(np.array_equal(mask, labels == label) for label, mask in enumerate(found, 1))


# DICOM SEG and RTSTRUCT

ODD_DICOM = (
    *("", None, "0", "-1", "1", "2", "3", "1e400", "nan", "a", "x" * 70),
    *("1\\2", "1\\2\\3", "0.5", "1\\0\\0\\0\\1\\0"),
)
ODD_BYTES = (b"\x00", b"\xff\xff", b"\x01\x00\x00", b"\x00" * 40)


def elements(dataset, keywords):
    """Every data set within a data set, with each keyword that it has."""
    found = []
    for element in dataset:
        if element.keyword in keywords:
            found.append((dataset, element.keyword))
        if element.VR == "SQ":
            for item in element.value:
                found += elements(item, keywords)
    return found


def odd_dicom(all_there, keywords, random):
    """Change one attribute anywhere: missing, empty, of another type, or inconsistent; returns what was done."""
    keyword = keywords[random.integers(len(keywords))]
    there = [one for one in all_there if one[1] == keyword] or all_there
    section, keyword = there[random.integers(len(there))]
    change = random.choice(["missing", "value", "value", "bytes", "twice", "shorter"])
    tag, kind = Tag(keyword), dictionary_VR(Tag(keyword))[:2]
    if change == "missing":
        del section[tag]
    elif kind == "SQ" and change in ("twice", "shorter"):
        items = list(section[tag].value)
        section[tag].value = items + copy.deepcopy(items[-1:]) if change == "twice" else items[:-1]
    else:
        value = ODD_DICOM[random.integers(len(ODD_DICOM))]
        raw = ODD_BYTES[random.integers(len(ODD_BYTES))] if change == "bytes" or kind in ("US", "OB", "OW") else None
        raw = (value or "").encode() if raw is None else raw
        kind = "LO" if kind == "SQ" else kind
        section[tag] = RawDataElement(tag, kind, len(raw), raw, 0, False, True)
    return keyword, str(change)


RTSTRUCT_KEYWORDS = tuple(
    """StructureSetROISequence ROINumber ROIName ROIContourSequence ReferencedROINumber ContourSequence
    ContourGeometricType NumberOfContourPoints ContourData SOPClassUID Modality SpecificCharacterSet""".split()
)
SEG_KEYWORDS = tuple(
    """SegmentSequence SegmentNumber SegmentLabel SegmentationType NumberOfFrames Rows Columns BitsAllocated BitsStored
    HighBit PixelRepresentation SamplesPerPixel PhotometricInterpretation SharedFunctionalGroupsSequence
    PerFrameFunctionalGroupsSequence PlanePositionSequence PixelSpacing ImagePositionPatient
    PlaneOrientationSequence ImageOrientationPatient PixelMeasuresSequence SegmentIdentificationSequence
    ReferencedSegmentNumber SOPClassUID Modality PixelData SegmentsOverlap DimensionIndexSequence
    FrameOfReferenceUID SliceThickness FrameContentSequence""".split()
)


def fuzz_dicom(write, keywords, runs, seed, folder):
    """Fuzz attributes of the file that write(labels, path) makes."""
    _, labels = object_hu()
    path = folder / "regions.dcm"
    write(labels, path)
    whole = path.read_bytes()
    random, counts, faults = np.random.default_rng(seed), Counter(), []
    for _ in range(runs):
        path.write_bytes(whole)
        dataset = pydicom.dcmread(path)
        there = elements(dataset, keywords)
        try:
            done = [odd_dicom(there, keywords, random) for _ in range(random.choice([1, 1, 1, 2]))]
            dataset.save_as(path)
        except Exception:  # two changes of one place, or nothing that pydicom writes
            counts["not written"] += 1
            continue
        found, text = outcome(lambda: masks(path, ("a", "b")), same_masks(labels), lambda _: valid(whole, path))
        counts[found] += 1
        if found in FAULTS:
            faults.append((found, path.name, done, text))
    return counts, faults


def valid(whole, path):
    """Whether a file states its regions consistently, though others than the original: contours or frames fewer."""
    before, after = pydicom.dcmread(pydicom.filebase.DicomBytesIO(whole)), pydicom.dcmread(path)
    if "SegmentSequence" in before:
        return False
    contour_counts = [len(item.get("ContourSequence") or ()) for item in before.ROIContourSequence]
    now = [len(item.get("ContourSequence") or ()) for item in after.get("ROIContourSequence") or ()]
    return now != contour_counts  # a contour at an end of the region is missing; a gap within would be reported


def rtstruct(labels, path):
    """Outlines of both regions by scikit-image."""
    from skimage.measure import find_contours

    ds = pydicom.Dataset()
    ds.file_meta = pydicom.dataset.FileMetaDataset()
    ds.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    ds.SOPClassUID = ds.file_meta.MediaStorageSOPClassUID = pydicom.uid.RTStructureSetStorage
    ds.SOPInstanceUID = ds.file_meta.MediaStorageSOPInstanceUID = pydicom.uid.generate_uid()
    ds.Modality, ds.SpecificCharacterSet = "RTSTRUCT", "ISO_IR 100"
    ds.StructureSetROISequence, ds.ROIContourSequence = [], []
    for number, name in enumerate("ab", 1):
        roi, item = pydicom.Dataset(), pydicom.Dataset()
        roi.ROINumber, roi.ROIName = number, name
        item.ReferencedROINumber, item.ContourSequence = number, []
        for k, plane in enumerate(labels == number):
            for outline in find_contours(plane.astype(float), 0.5):
                voxels = np.column_stack([outline[:, ::-1], np.full(len(outline), k), np.ones(len(outline))])
                world = (GRID.affine @ voxels.T)[:3].T * [-1, -1, 1]
                contour = pydicom.Dataset()
                contour.ContourGeometricType, contour.NumberOfContourPoints = "CLOSED_PLANAR", len(world)
                contour.ContourData = [f"{value:.3f}" for value in world.ravel()]
                item.ContourSequence.append(contour)
        ds.StructureSetROISequence.append(roi)
        ds.ROIContourSequence.append(item)
    ds.save_as(path, enforce_file_format=True)


def seg(labels, path):
    """Both regions by highdicom."""
    import highdicom
    from pydicom.sr.codedict import codes

    study, series, frame = (pydicom.uid.generate_uid() for _ in range(3))
    slices = []
    z, y, x = (axis + c for axis, c in zip(GRID.axes_mm(), GRID.centre_mm[::-1], strict=True))
    for k in range(len(z)):
        ds = pydicom.Dataset()
        ds.file_meta = pydicom.dataset.FileMetaDataset()
        ds.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
        ds.SOPClassUID, ds.SOPInstanceUID = pydicom.uid.CTImageStorage, pydicom.uid.generate_uid()
        ds.StudyInstanceUID, ds.SeriesInstanceUID, ds.FrameOfReferenceUID = study, series, frame
        ds.PatientID, ds.PatientName, ds.PatientBirthDate, ds.PatientSex = "1", "", "", ""
        ds.StudyID, ds.StudyDate, ds.StudyTime, ds.AccessionNumber, ds.ReferringPhysicianName = "1", "", "", "", ""
        ds.Modality, ds.Rows, ds.Columns, ds.SliceThickness = "CT", len(y), len(x), GRID.spacing[0]
        ds.PixelSpacing, ds.ImageOrientationPatient = list(GRID.spacing[1:]), [1, 0, 0, 0, 1, 0]
        ds.ImagePositionPatient = [-x[-1], -y[-1], z[k]]
        slices.append(ds)
    manual = highdicom.seg.SegmentAlgorithmTypeValues.MANUAL
    highdicom.seg.Segmentation(
        source_images=slices,
        pixel_array=np.stack([(labels == label)[:, ::-1, ::-1] for label in (1, 2)], axis=-1).astype(np.uint8),
        segmentation_type="BINARY",
        segment_descriptions=[
            highdicom.seg.SegmentDescription(n, name, codes.SCT.Tissue, codes.SCT.Liver, manual)
            for n, name in enumerate("ab", 1)
        ],
        series_instance_uid=pydicom.uid.generate_uid(),
        series_number=2,
        sop_instance_uid=pydicom.uid.generate_uid(),
        instance_number=1,
        manufacturer="none",
        manufacturer_model_name="none",
        software_versions="1",
        device_serial_number="1",
    ).save_as(path)


FORMATS = {
    "nifti": fuzz_nifti,
    "rtstruct": partial(fuzz_dicom, rtstruct, RTSTRUCT_KEYWORDS),
    "seg": partial(fuzz_dicom, seg, SEG_KEYWORDS),
}


def add_arguments(parser):
    parser.add_argument("--format", choices=FORMATS, required=True)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)


def run(options):
    warnings.simplefilter("ignore")
    logging.getLogger("pydicom").setLevel(logging.CRITICAL)
    logging.getLogger("nibabel").setLevel(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        counts, faults = FORMATS[options.format](options.runs, options.seed, Path(folder))
    for found, count in counts.most_common():
        print(f"{found}: {count}")
    for fault in faults:
        print(*fault, sep="  ")
    return int(any(counts[fault] for fault in FAULTS))
