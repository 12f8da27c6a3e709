"""Image quality of synthetic images with known blur, noise, cupping and column errors."""

from pathlib import Path

import nibabel
import numpy as np
import pytest
import yaml
from scipy import ndimage
from skimage.transform import iradon
from workflow_runs import TINY, snakemake

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.config.read_config import read_configs
from virtual_phantom.diagnosis.settings import ShapesObject
from virtual_phantom.image_quality.location import Layout, Location, layout, locate, nominal_hu
from virtual_phantom.image_quality.measure import _against_dose, measure_module
from virtual_phantom.image_quality.measures import hu_regression, inserts, noise, slice_profile
from virtual_phantom.image_quality.settings import ModuleSettings
from virtual_phantom.image_quality.uniformity import explain, uniformity
from virtual_phantom.io.documents import IMAGE_QUALITY, read_document
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.study.checks.preflight import problems

REAL = Path(__file__).resolve().parents[2] / "../shared/real/catphan504_cbct"
SPACING = (2.0, 0.6, 0.6)
SIDE, FINE = 192, 5
SD_MM = 0.7  # of the Gaussian blur
HALF_OF_GAUSSIAN = np.sqrt(np.log(2) / 2) / np.pi  # frequency at which the MTF of a Gaussian of SD 1 is one half
ROLL, SHIFT = 17.0, (3.1, -2.4)
OBJECT = {
    "description": "Three inserts and a wire.",
    "materials": {"teflon": {"compound": "C2F4", "density_g_per_cm3": 2.16}},
    "shapes": [
        {"name": "body", "kind": "cylinder", "material": "water", "diameter_mm": 100},
        {"name": "hole", "kind": "cylinder", "material": "air", "centre_mm": [28, 0, 0], "diameter_mm": 14},
        {"name": "teflon", "kind": "cylinder", "material": "teflon", "centre_mm": [0, 28, 0], "diameter_mm": 14},
        {"name": "acrylic", "kind": "cylinder", "material": "pmma", "centre_mm": [-28, 0, 0], "diameter_mm": 14},
        {"name": "wire", "kind": "cylinder", "material": "copper", "centre_mm": [0, -25, 0], "diameter_mm": 0.2},
    ],
}


def axes(fine=1):
    step = SPACING[1] / fine
    line = (np.arange(SIDE * fine) - (SIDE * fine - 1) / 2) * step
    return line[None], line[:, None]


@pytest.fixture(scope="module")
def object_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("object") / "three.yaml"
    path.write_text(yaml.safe_dump(OBJECT))
    return path


@pytest.fixture(scope="module")
def plane():
    """Blurred image of OBJECT, mirrored, rotated and shifted, on a line of slope 1.02 and intercept 5 HU."""
    x, y = axes(FINE)
    shown = np.full((SIDE * FINE, SIDE * FINE), -1000.0)
    turn = np.exp(1j * np.radians(ROLL))
    for shape in OBJECT["shapes"][:4]:
        px, py, _ = shape.get("centre_mm", (0, 0, 0))
        center = complex(-px, py) * turn + complex(*SHIFT)
        material = {"teflon": read_teflon()}.get(shape["material"], shape["material"])
        inside = np.hypot(x - center.real, y - center.imag) < shape["diameter_mm"] / 2
        shown[inside] = 1.02 * nominal_hu(material, 60.0) + 5
    blurred = ndimage.gaussian_filter(shown, SD_MM / SPACING[1] * FINE)
    plane = blurred.reshape(SIDE, FINE, SIDE, FINE).mean(axis=(1, 3))
    wire = -25j * turn + complex(*SHIFT)
    x, y = axes()
    plane += 3000 * np.exp(-((x - wire.real) ** 2 + (y - wire.imag) ** 2) / (2 * SD_MM**2))
    return plane


def read_teflon():
    from virtual_phantom.physics.beam.materials import Mixture

    return Mixture("teflon", 2.16, "C2F4")


def pixel_mtf(frequency):
    """Mean MTF over directions of a square pixel, to first order."""
    return np.sinc(frequency * SPACING[1] / np.sqrt(2)) ** 2


def test_object_is_located_with_its_resolution_and_hu(plane, object_file):
    known = layout(read_object(str(object_file)))
    images = plane[None]
    found = locate(images, SPACING, known)
    assert found.mirrored and found.centers[0] == pytest.approx(SHIFT, abs=0.03)
    assert found.radius == pytest.approx(50, abs=0.05)
    table, curves = inserts(images, SPACING, known, found)
    table = table.set_index("insert")
    # The mirrored angle of the rotation by ROLL
    hole = complex(-28, 0) * np.exp(1j * np.radians(ROLL))
    assert [(one.x, one.y) for one in found.inserts][0] == pytest.approx((hole.real, hole.imag), abs=0.05)
    assert found.roll_deg == pytest.approx(ROLL, abs=0.1)
    for name in ("hole", "teflon", "acrylic"):
        gaussian = HALF_OF_GAUSSIAN / SD_MM
        blurred = np.sqrt(-np.log(0.5 / pixel_mtf(gaussian)) / 2) / np.pi / SD_MM
        assert table.loc[name, "f50_per_mm"] == pytest.approx(blurred, rel=0.02)
    assert table.loc["wire", "f50_per_mm"] == pytest.approx(HALF_OF_GAUSSIAN / SD_MM, rel=0.02)
    assert np.isnan(table.loc["wire", "hu"]) and set(curves["insert"]) == set(table.index)
    line = hu_regression(table.reset_index(), found)
    assert line["energy_fitted"] and line["energy_kev"] == pytest.approx(60, abs=1) and line["rms_hu"] < 0.3
    assert line["slope"] == pytest.approx(1.02, abs=1e-3) and line["intercept_hu"] == pytest.approx(5, abs=0.5)


def test_slices_with_the_inserts_are_found(plane, object_file):
    empty = np.where(plane > -500, 0.0, -1000.0)
    volume = np.stack([empty, empty, plane, plane, plane, plane, empty]).astype(np.float32)
    settings = ModuleSettings(ShapesObject(str(object_file)))
    content, tables, _ = measure_module([volume], Grid(volume.shape, SPACING), settings)
    assert content["slices"] == 2 and content["z_mm"] == [0.0, 2.0]  # without the slices at both ends
    assert set(tables) >= {"inserts", "ttf"}
    with pytest.raises(InputError, match="inserts are in no slice"):
        measure_module([volume[:2]], Grid((2, SIDE, SIDE), SPACING), settings)
    with pytest.raises(InputError, match="z_mm has no slice; slices are at -6.0 to 6.0 mm"):
        measure_module([volume], Grid(volume.shape, SPACING), ModuleSettings(settings.object, (20, 30)))


def test_noise_spectra_of_filtered_noise_have_their_closed_forms():
    """White noise of SD 12 HU, averaged over two slices and blurred in the plane, over a quadratic trend."""
    rng = np.random.default_rng(7)
    white = rng.normal(0, 12, (13, SIDE, SIDE))
    trend = 1e-3 * (axes()[0] ** 2 - axes()[1] ** 2)
    area = np.ones((SIDE, SIDE), bool)
    content, spectra, places = noise((white + trend)[None], area, SPACING)
    assert content["sd_hu"] == pytest.approx(12, rel=0.01) and content["sd_error"] < 0.05
    assert content["correlation_of_slices"] == pytest.approx(0, abs=0.01)
    level = 12**2 * SPACING[1] ** 2
    one = spectra[(spectra["kind"] == "in plane") & (spectra["frequency_per_mm"] > 0.1)]
    assert one["power"].to_numpy() == pytest.approx(np.full(len(one), level), rel=0.08)
    assert places["sd_hu"].to_numpy() == pytest.approx(np.full(len(places), 12), rel=0.03)

    structure = 200 * (axes()[0] > 0)  # repeats share it
    repeated, _, _ = noise(white[:12].reshape(3, 4, SIDE, SIDE) + structure, area, SPACING)
    assert repeated["sd_hu"] == pytest.approx(12, rel=0.01)
    assert repeated["correlation_of_slices"] == pytest.approx(0, abs=0.01)

    sd = 1.5  # pixels
    blurred = ndimage.gaussian_filter((white[1:] + white[:-1]) / 2, (0, sd, sd), mode="wrap")
    content, spectra, _ = noise(blurred[None], area, SPACING)
    one = spectra[(spectra["kind"] == "in plane") & spectra["frequency_per_mm"].between(0.1, 0.3)]
    transfer = np.exp(-4 * (np.pi * one["frequency_per_mm"] * sd * SPACING[1]) ** 2)
    assert one["power"].to_numpy() == pytest.approx(level / 2 * transfer, rel=0.1)
    assert content["correlation_of_slices"] == pytest.approx(0.5, abs=0.03)
    # Variance: integral of the spectrum of a Gaussian filter
    assert content["sd_hu"] ** 2 == pytest.approx(12**2 / 2 / (4 * np.pi * sd**2), rel=0.06)
    along = spectra[spectra["kind"] == "along z"]
    expected = content["sd_hu"] ** 2 * SPACING[0] * 2 * np.cos(np.pi * along["frequency_per_mm"] * SPACING[0]) ** 2
    assert along["power"].to_numpy()[:3] == pytest.approx(expected[:3], rel=0.12)


def test_slice_profiles_of_a_ramp_and_a_bead_are_the_known_one(tmp_path):
    fwhm, angle = 3.0, np.radians(23)
    sd = fwhm / np.sqrt(8 * np.log(2))
    ramp = {"name": "ramp", "kind": "cylinder", "material": "aluminium", "centre_mm": [0, 20, 0], "diameter_mm": 0.3}
    ramp |= {"length_mm": 60, "axis": [np.cos(angle).item(), 0, np.sin(angle).item()]}
    bead = {"name": "bead", "kind": "ball", "material": "aluminium", "centre_mm": [0, -20, 0], "diameter_mm": 0.3}
    x, y = axes()
    z = np.arange(-8, 9) * 1.0
    along = np.exp(-((x * np.tan(angle) - z[:, None, None]) ** 2) / (2 * sd**2))
    across = np.exp(-((y - 20) ** 2) / (2 * SD_MM**2))
    point = np.exp(-(x**2 + (y + 20) ** 2) / (2 * SD_MM**2)) * np.exp(-(z[:, None, None] ** 2) / (2 * sd**2))
    for shape, images in ((ramp, 500 * along * across), (bead, 500 * point)):
        path = tmp_path / f"{shape['name']}.yaml"
        path.write_text(yaml.safe_dump(OBJECT | {"shapes": [OBJECT["shapes"][0], shape]}))
        found = Location(np.zeros((len(z), 2)), 50.0)
        measured, curve = slice_profile(images, (1.0, *SPACING[1:]), read_object(str(path)), found)
        assert measured == pytest.approx(fwhm, rel=0.03)
        assert curve["profile"].max() == 1
    assert slice_profile(images, SPACING, read_object("water_cylinder", {"diameter_mm": 100}), found)[0] is None


KNOWN = Layout("water", 50.0, 55.0, ())
CENTERED = Location(np.tile([0.6, -0.8], (6, 1)), 55.0)


def uniform(added=0.0, seed=3):
    """Six slices of a noisy disc."""
    x, y = axes()
    disc = np.where(np.hypot(x - 0.6, y + 0.8) < 55, 0.0, -1000.0)
    return disc + added + np.random.default_rng(seed).normal(0, 4, (6, SIDE, SIDE))


def test_cupping_has_its_closed_form_and_rings_are_absent():
    x, y = axes()
    depth = np.clip(1 - np.hypot(x - 0.6, y + 0.8) ** 2 / 55**2, 0, 1)
    content, radial, _ = uniformity(uniform(30 * np.sqrt(depth)), SPACING, KNOWN, CENTERED)
    edge = content["cupping_to_mm"]
    assert edge == pytest.approx(42, abs=0.5)
    assert content["cupping_hu"] == pytest.approx(30 * (np.sqrt(1 - (edge / 55) ** 2) - 1), abs=0.5)
    assert content["cupping_share"] > 0.95
    assert content["regions"]["center"] == pytest.approx(30 * np.sqrt(1 - 33.3 / 55**2), abs=0.6)
    said = content["explanations"]
    assert "over-corrected beam hardening or scatter" in said[0]
    assert said[1:] == ["Rings: none beyond noise.", "Crescent: none above 3 HU (RMS over the angle)."]


def test_error_of_detector_columns_in_half_a_turn_makes_a_crescent_and_rings():
    """The images of the errors are those of scikit-image's filtered back-projection over 180 degrees."""
    angles = np.arange(40, 220, 0.5)
    columns = np.arange(SIDE) - SIDE // 2
    odd = np.exp(-((np.abs(columns) - 60) ** 2) / 8) * np.sign(columns)
    even = np.exp(-((np.abs(columns) - 25) ** 2) / 4)
    images = []
    for profile in (odd, even):
        image = iradon(np.repeat(profile[:, None], len(angles), axis=1), angles, circle=True, output_size=SIDE)
        images.append(image / np.abs(image).max())
    content, _, angular = uniformity(uniform(60 * images[0] + 20 * images[1]), SPACING, KNOWN, CENTERED)
    fit = content["half_turn"]
    assert fit["share"] > 0.9 and fit["odd_share"] > 0.95
    assert fit["center_mm"] == pytest.approx([0, 0], abs=0.5)
    assert content["crescent_r_mm"] == pytest.approx(60 * SPACING[1], abs=2)
    rings = content["rings"]
    assert rings["image_center"] > max(2 * rings["displaced"], rings["object_center"])
    assert "errors of detector elements" in content["explanations"][1]
    assert "bowtie filter or tube" in content["explanations"][-1]
    assert set(angular) == {"r_mm", "angle_deg", "hu", "half_turn_hu"}
    # An object that causes the same crescent is not explained.
    moved = content | {"half_turn": fit | {"center_mm": content["object_center_mm"]}}
    assert explain(moved)[-1] == "The crescent is unexplained."


def test_noise_is_measured_in_uniform_areas_of_an_unknown_object_and_against_dose():
    x, y = axes()
    doses = {1.0: 30.0, 4.0: 15.0, 16.0: 10.0}
    recordings = []
    for index, (dose, sd) in enumerate(doses.items()):
        body = np.where(np.hypot(x, y) < 50, 20.0, -1000.0) + 300 * (np.hypot(x - 20, y) < 8)
        volume = body + np.random.default_rng(index).normal(0, sd, (1, SIDE, SIDE))
        content, _, _ = measure_module([volume.astype(np.float32)], Grid(volume.shape, SPACING), ModuleSettings())
        assert content["noise"]["sd_hu"] == pytest.approx(sd, rel=0.03) and content["location"] is None
        recordings.append({"dose_mgy": dose, "mas": None, "modules": {"m": content}})
    series = _against_dose("m", recordings)
    assert series["quantity"] == "dose_mgy" and series["doses"] == list(doses)
    assert series["exponents"] == pytest.approx([1.0, np.log(2.25) / np.log(4)], abs=0.05)
    assert _against_dose("m", recordings[:1]) is None
    without_dose = [one | {"mas": 10 * one["dose_mgy"]} for one in recordings]
    without_dose[0]["dose_mgy"] = 0.0
    assert _against_dose("m", without_dose) == series | {"quantity": "mas", "doses": [10.0, 40.0, 160.0]}


def test_image_without_noise_is_rejected():
    flat = np.zeros((2, SIDE, SIDE), np.float32)
    with pytest.raises(InputError, match="soft tissue has no noise in the image; use an image with noise, or state"):
        measure_module([flat], Grid(flat.shape, SPACING), ModuleSettings())


def test_target_writes_document_page_tables_and_figures(plane, object_file, tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    volume = np.repeat(plane[None], 4, axis=0) + np.random.default_rng(1).normal(0, 5, (4, SIDE, SIDE))
    nibabel.save(nibabel.Nifti1Image(volume.T.astype(np.float32), np.diag([0.6, 0.6, 2, 1])), folder / "a.nii.gz")
    (folder / "recording.yaml").write_text(yaml.safe_dump({"name": "scan", "kind": "images", "repeats": ["a.nii.gz"]}))
    entry = {"recordings": ["scan"], "modules": {"inserts": {"object": {"kind": str(object_file)}}}}
    overlay = tmp_path / "my.yaml"
    content = {"results_dir": f"{tmp_path}/r", "recordings": {"scan": str(folder)}, "image_quality": {"three": entry}}
    overlay.write_text(yaml.safe_dump(content))
    process = snakemake("image_quality", "--configfile", TINY, overlay)
    assert process.returncode == 0, process.stderr[-3000:]
    assert "scan, inserts: 2 slices at z 2.0 to 4.0 mm, noise" in process.stdout + process.stderr
    made = tmp_path / "r" / "image_quality" / "three"
    document = read_document(made / "image_quality.json", IMAGE_QUALITY)
    assert [one["insert"] for one in document["recordings"]["scan"]["modules"]["inserts"]["inserts"]][-1] == "wire"
    assert "Image quality of three" in (made / "report.html").read_text()
    assert (made / "tables" / "ttf.csv").exists() and (made / "figures" / "scan_inserts_inserts.png").exists()
    wrong = content | {"image_quality": {"three": entry | {"recordings": ["scam"]}}}
    overlay.write_text(yaml.safe_dump(wrong))
    (line,) = problems(read_configs([Path(TINY).with_name("paper_groups.yaml"), TINY, overlay])[1])
    assert "image_quality.three.recordings" in line and "did you mean 'scan'" in line
    (folder / "recording.yaml").write_text(
        yaml.safe_dump({"name": "scan", "kind": "features", "repeats": ["a.nii.gz"]})
    )
    entry["modules"]["inserts"]["object"]["kind"] = "catphan504_ctp505"
    overlay.write_text(yaml.safe_dump(content))
    lines = problems(read_configs([Path(TINY).with_name("paper_groups.yaml"), TINY, overlay])[1])
    assert [line.partition(":")[0] for line in lines] == [
        "image_quality.three.recordings",
        "image_quality.three.modules.inserts.object",
    ]


@pytest.mark.real
@pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout")
def test_hu_of_the_catphan_are_those_of_pylinac():
    """Medians that pylinac 3.49.0 reports for its CTP404 slice, z = -1.3 mm."""
    from virtual_phantom.phantom.ct import read_hu

    volume = read_hu(REAL)
    settings = ModuleSettings(ShapesObject("catphan504_ctp404"), (-2.0, 0.0))
    content, _, _ = measure_module([volume.array], volume.grid, settings)
    hu = {one["insert"]: one["hu"] for one in content["inserts"]}
    pylinac = {
        "air_top": -998,
        "pmp": -200,
        "ldpe": -102,
        "polystyrene": -45,
        "acrylic": 115,
        "delrin": 340,
        "teflon": 997,
    }
    assert {name: hu[name] for name in pylinac} == pytest.approx(pylinac, abs=3)
    assert content["location"]["mirrored"] and content["location"]["roll_deg"] == pytest.approx(-0.3, abs=0.1)
