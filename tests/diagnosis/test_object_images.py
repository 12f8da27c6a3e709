"""Images of a known object: slices as repeats, reconstructed by another program from an analytic sinogram."""

from functools import cache

import numpy as np
import pytest
import yaml
from scipy import ndimage
from skimage.measure import block_reduce
from skimage.transform import iradon

import virtual_phantom as vp
from virtual_phantom.api.diagnosis import SECTION
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.candidate_effects import check_kinds
from virtual_phantom.diagnosis.images.other_scan import alternate_slices, with_other_scan
from virtual_phantom.diagnosis.images.scan import with_scan
from virtual_phantom.diagnosis.images.setting import correlated_variance
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.diagnosis.setup.located import locate
from virtual_phantom.io.schema import defaults_of, fill_defaults, schema_of
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.beam.materials import Segmentation, attenuation_per_mm, energy_of
from virtual_phantom.recordings.document import read_document
from virtual_phantom.recordings.reading import load_recording

WATER_PER_MM = defaults_of()["mu_water_per_mm"]
ENERGY_KEV = energy_of("water", WATER_PER_MM)
# x, y, diameter in mm, and material. Later discs replace earlier ones.
DISCS = [(0, 0, 100, "water"), (28, 6, 22, "pmma"), (-18, 24, 16, "polyethylene"), (-10, -28, 18, "soft_tissue")]
SIDE, VOXEL_MM, FINE, VIEWS, SLICES = 64, 2.0, 3, 240, 10
MOVED = (3.2, -1.7)  # x, y, mm


def line_integrals(t_mm, angles_rad):
    """Parallel projections, shape (t, angles), of the discs, moved, per mm of attenuation."""
    total = np.zeros((len(t_mm), len(angles_rad)))
    for number, (x, y, diameter, material) in enumerate(DISCS):
        mu = attenuation_per_mm(material, [ENERGY_KEV])[0] - (WATER_PER_MM if number else 0)
        center = (x + MOVED[0]) * np.cos(angles_rad) + (y + MOVED[1]) * np.sin(angles_rad)
        total += mu * 2 * np.sqrt(np.maximum((diameter / 2) ** 2 - (t_mm[:, None] - center) ** 2, 0))
    return total


def reconstructed(lines, pixel_mm, filter_name, interpolation="linear"):
    """Filtered back-projection by scikit-image, HU, rows along +y."""
    degrees = np.arange(VIEWS) * 180 / VIEWS
    image = iradon(lines, degrees, filter_name=filter_name, interpolation=interpolation)[::-1] / pixel_mm
    return 1000 * (image / WATER_PER_MM - 1)


@cache
def images(filter_name="ramp", noise=0.004, seed=1):
    """Noisy slices, HU, shape (z, y, x), of voxels that average the image."""
    random, angles = np.random.default_rng(seed), np.arange(VIEWS) * np.pi / VIEWS
    pixel = VOXEL_MM / FINE
    t = (np.arange(SIDE * FINE) - SIDE * FINE // 2) * pixel

    clean = reconstructed(line_integrals(t, angles), pixel, filter_name, "cubic")
    clean = block_reduce(clean, (FINE, FINE), np.mean)
    noisy = [
        clean + 1000 + reconstructed(noise * random.standard_normal((SIDE, VIEWS)), VOXEL_MM, filter_name)
        for _ in range(SLICES)
    ]
    return np.array(noisy)


@pytest.fixture
def recorded(tmp_path):
    """Return a function that writes slices as a recording, and the object as a file of shapes."""
    shapes = [
        {"kind": "cylinder", "material": material, "centre_mm": [x, y, 0], "diameter_mm": diameter}
        for x, y, diameter, material in DISCS
    ]
    (tmp_path / "discs.yaml").write_text(yaml.safe_dump({"description": "Discs.", "shapes": shapes}))

    def write(slices, folder=tmp_path, z_mm=0.0):
        folder.mkdir(exist_ok=True)
        grid = Grid(slices.shape, (2.5, VOXEL_MM, VOXEL_MM), (0.0, 0.0, z_mm))
        write_nifti(Volume(np.rint(slices).astype(np.int16), grid), folder / "images.nii.gz")
        content = {"name": "discs", "kind": "images", "repeats": ["images.nii.gz"]}
        (folder / "recording.yaml").write_text(yaml.safe_dump(content))
        return folder

    return write


def request_of(folder, **settings):
    schema = SECTION | {"$defs": schema_of()["$defs"]}
    section = {"object": {"kind": str(folder / "discs.yaml"), "parameters": {}}} | settings
    fill_defaults(section, schema)
    return DiagnosisRequest(
        folder, from_mapping(RecordingSettings, section), WATER_PER_MM, Segmentation(**defaults_of("materials"))
    )


def test_object_is_located_and_the_other_end_is_recognized(recorded):
    recording = load_recording(recorded(images()[..., ::-1]))
    found = locate(recording, request_of(recording.document.folder))
    # scikit-image turns about the pixel right of the middle: half a fine pixel.
    half = VOXEL_MM / FINE / 2
    assert found.location["x_mm"] == pytest.approx(MOVED[0] + half, abs=0.1)
    assert found.location["y_mm"] == pytest.approx(MOVED[1] - half, abs=0.1)
    assert abs(found.location["turn_deg"]) < 0.5
    assert found.mirrored


def test_other_object_is_one_clear_error(recorded):
    folder = recorded(images())
    with pytest.raises(InputError, match="the object does not fit the images: correlation"):
        locate(load_recording(folder), request_of(folder, disc={"diameter_mm": 30, "material": "water"}, object=None))


def resampled(hu, pixel_mm=1.43):
    """Cubic interpolation to another matrix, and linear interpolation back."""
    count = 2 * int(np.ceil(SIDE * VOXEL_MM / pixel_mm / 2)) + 2
    there = (np.arange(count) - (count - 1) / 2) * pixel_mm / VOXEL_MM + (SIDE - 1) / 2
    back = (np.arange(SIDE) - (SIDE - 1) / 2) * VOXEL_MM / pixel_mm + (count - 1) / 2
    for positions, order in ((there, 3), (back, 1)):
        at = np.meshgrid(positions, positions, indexing="ij")
        hu = np.stack([ndimage.map_coordinates(one, at, order=order, mode="nearest") for one in hu])
    return hu


@pytest.mark.parametrize(
    ("change", "filter_name", "expected"),
    [
        (lambda hu: hu, "ramp", []),
        (lambda hu: 1.03 * hu + 8, "ramp", ["hu_calibration"]),
        (lambda hu: hu, "hann", ["reconstruction_kernel"]),
        (resampled, "ramp", ["resampling"]),
    ],
    ids=["nothing", "hu", "kernel", "matrix"],
)
def test_effect_in_images_of_another_program_is_named(recorded, change, filter_name, expected):
    folder = recorded(change(images(filter_name)))
    recording, location = load_recording(folder), {"x_mm": 3.5, "y_mm": -2.0, "turn_deg": 0.0}
    request = with_scan(request_of(folder).located(location), recording)
    _, prepared = prepare_recording(request, recording)
    assert prepared.data.n == prepared.held_out.n == SLICES // 2
    accuracy = defaults_of("diagnosis", "model_accuracy")
    tried = ["hu_calibration", "reconstruction_kernel", *expected[:1]]
    content = find_missing_physics("discs", prepared, list(dict.fromkeys(tried)), accuracy).content
    assert [effect["name"] for effect in content["effects"]] == expected
    assert content["verdict"] == ("mismatch explained" if expected else "match")
    # The kernel of the noise has the cut-off frequency of the voxels, that of the object three times as much.
    assert any("noise spectrum" in one for one in content["caveats"]) == (filter_name == "hann")
    if expected == ["resampling"]:  # one of many local minima
        assert content["effects"][0]["parameters"]["pixel_mm"]["value"] == pytest.approx(1.43, abs=0.01)
    if expected == ["hu_calibration"]:
        for name, truth in (("scale", 1.03), ("offset_hu", 8.0)):
            low, high = content["effects"][0]["parameters"][name]["ci95"]
            assert low < truth < high


def test_correlation_of_slices_is_counted():
    white = np.random.default_rng(1).standard_normal((1, 60, 20, 20))
    valid = np.ones((20, 20), bool)
    assert correlated_variance(white, valid) == pytest.approx(1, abs=0.15)
    # Means of two neighbors: correlation of 1/2, so a mean of n has 2 times the variance of independent ones.
    assert correlated_variance((white[:, 1:] + white[:, :-1]) / 2, valid) == pytest.approx(2, rel=0.15)
    with pytest.raises(InputError, match="3 slices, of which 3 have independent noise"):
        correlated_variance(white[:, :3], valid)


LOW, HIGH = 0.03, 0.01  # noise of line integrals


@pytest.mark.parametrize(
    ("change", "noise", "moved_px", "expected"),
    [
        # Smoothed noise of the model must not look like a better fit.
        (lambda hu: hu, LOW, 0, []),
        (lambda hu: hu, HIGH, 2, []),
        (lambda hu: 1.03 * hu + 8, HIGH, 0, ["hu_calibration"]),
        (lambda hu: ndimage.gaussian_filter(hu, (0, 0.6, 0.6)), HIGH, 0, ["reconstruction_kernel"]),
    ],
    ids=["as noisy", "moved", "hu", "kernel"],
)
def test_another_scan_is_the_object(recorded, tmp_path, change, noise, moved_px, expected):
    scan = recorded(np.roll(images("ramp", noise, 2), moved_px, axis=2), tmp_path / "high")
    clean, noisy = images("ramp", 0.0), images("ramp", LOW)
    recording = load_recording(recorded(change(clean) + noisy - clean))
    stated = {"object": {"scan": str(scan)}, "location": {"x_mm": 3.0}}  # a wrong location
    request = with_other_scan(request_of(tmp_path, **stated), recording)
    request = with_scan(request.located(locate(recording, request).location), recording)
    assert request.settings.location["x_mm"] == pytest.approx(-VOXEL_MM * moved_px, abs=0.1)
    _, prepared = prepare_recording(request, recording)
    tried = ["hu_calibration", expected[0] if expected else "contrast_dependent_resolution"]
    content = find_missing_physics(
        "discs", prepared, list(dict.fromkeys(tried)), defaults_of("diagnosis", "model_accuracy")
    ).content
    assert [effect["name"] for effect in content["effects"]] == expected, content["sentence"]
    assert content["verdict"] == ("mismatch explained" if expected else "match")
    parameters = {key: value for effect in content["effects"] for key, value in effect["parameters"].items()}
    for name, truth in {"hu_calibration": {"scale": 1.03, "offset_hu": 8.0}}.get("".join(expected), {}).items():
        low, high = parameters[name]["ci95"]
        assert low < truth < high
    if "sigma_mm" in parameters:
        assert parameters["sigma_mm"]["value"] == pytest.approx(0.6 * VOXEL_MM, rel=0.25)


def test_slices_of_the_model_are_not_compared():
    for count, step, slices in ((10, 1, ([1, 3, 5, 7], [0, 2, 4, 6, 8])), (12, 2, ([2, 6], [0, 4, 8]))):
        assert tuple(list(range(count))[part] for part in alternate_slices(count, step)) == slices


def test_other_scans_that_cannot_be_compared_are_refused(recorded, tmp_path):
    folder, scan = recorded(images("ramp", LOW)), tmp_path / "high"
    for slices, z_mm, message in (
        (
            images("ramp", HIGH, 2),
            60.0,
            "high: shows the slices at z = 48.75 to 71.25 mm, the recording those at -11.2",
        ),
        (images("ramp", HIGH, 2), 15.0, "high: shows 4 slices of the recording; a comparison of scans needs 7"),
        (images("ramp", LOW), 0.0, "high: has the images of the recording"),
    ):
        recorded(slices, scan, z_mm)
        with pytest.raises(InputError, match=message):
            vp.diagnose(folder, scan=scan)
    recorded(images("ramp", HIGH, 2), scan, 5.0)
    with pytest.raises(InputError, match="give slices from 2 to 9 alone"):
        vp.diagnose(folder, scan=scan, slices=[0, 9])
    with pytest.raises(InputError, match="is the diagnosed recording"):
        vp.diagnose(folder, scan=folder)
    document = read_document(folder)
    document.content["kind"] = "projections"
    with pytest.raises(InputError, match="object.scan: is for recordings of images"):
        check_kinds({"low": request_of(folder, object={"scan": str(scan)}).settings}, {"low": document})


def test_disc_is_compared_in_images(recorded):
    axis = (np.arange(SIDE * 4) - (SIDE * 4 - 1) / 2) * VOXEL_MM / 4
    share = block_reduce(np.hypot(axis, axis[:, None]) < 50, (4, 4), np.mean)
    noise = np.random.default_rng(3).normal(0, 10, (SLICES, SIDE, SIDE))
    found = vp.diagnose(recorded(1000 * (share - 1) + noise), disc=(100, "water"), effects=["hu_calibration"]).content
    assert "contrast" in found["agreement"]["metrics"] and found["effects"] == []
