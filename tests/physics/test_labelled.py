"""Label maps as objects: path lengths against closed forms and masks, and rejected maps."""

from dataclasses import replace

import nibabel
import numpy as np
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.scanned_object import labelled_scene, mask_scene
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.labeled import label_materials, read_label_map
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.scene import DISC_ENERGY_KEV, Pose

GEOMETRY = circular(
    views=9,
    source_to_isocentre_mm=300.0,
    source_to_detector_mm=450.0,
    columns=48,
    rows=12,
    column_pitch_mm=1.5,
    row_pitch_mm=3.0,
)
ONE_ROW = replace(GEOMETRY, rows=1)
RADIUS_MM, HEIGHT_MM = 20.0, 24.6
BOX_CENTRE_MM, BOX_MM = (6.3, -4.2, 1.1), (10.7, 7.3, 9.1)
ACRYLIC = {"compound": "C5H8O2", "density_g_per_cm3": 1.19}


def labels_of(voxel_mm, slices=True):
    """A cylinder (1) with a box in it (2) on whole voxels, by the position of their centers."""
    across, high = round(48 / voxel_mm), round(28 / voxel_mm) if slices else 1
    grid = Grid((high, across, across), (voxel_mm, voxel_mm, voxel_mm))
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    labels = np.where((np.hypot(x, y) < RADIUS_MM) & (np.abs(z) < HEIGHT_MM / 2), 1, 0)
    off = [np.abs(at - middle) - side / 2 for at, middle, side in zip((x, y, z), BOX_CENTRE_MM, BOX_MM, strict=True)]
    inside = np.max(off if slices else off[:2], axis=0) < 0
    return Volume(np.where(inside, 2, labels).astype(np.uint8), grid)


def written(volume, path):
    write_nifti(volume, path)
    return path


def rays(geometry):
    """Sources and pixels in mm, and the vectors between them."""
    placed = geometry.by_vectors()
    middle = (np.array([geometry.columns, geometry.rows]) - 1) / 2
    columns = (np.arange(geometry.columns) - middle[0]) * geometry.column_pitch_mm
    rows = (np.arange(geometry.rows) - middle[1]) * geometry.row_pitch_mm
    pixels = (
        placed.detector_mm[:, None, None]
        + columns[:, None] * placed.column_direction[:, None, None]
        + rows[:, None, None] * placed.row_direction[:, None, None]
    )
    source = placed.source_mm[:, None, None]
    return source, pixels - source


def in_cylinder(source, way, radius_mm, height_mm=np.inf):
    """Entry and exit of each ray, as fractions of its length, for an upright cylinder about the z axis."""
    square = (way[..., :2] ** 2).sum(-1)
    along = (source[..., :2] * way[..., :2]).sum(-1)
    root = along**2 - square * ((source[..., :2] ** 2).sum(-1) - radius_mm**2)
    half = np.sqrt(np.maximum(root, 0))
    ends = in_slab(source[..., 2], way[..., 2], 0.0, height_mm)
    return both(((-along - half) / square, (-along + half) / square), ends)


def in_slab(source, way, middle_mm, thickness_mm):
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = [(middle_mm + side * thickness_mm / 2 - source) / way for side in (-1, 1)]
    return np.minimum(*ends), np.maximum(*ends)


def both(one, other):
    return np.maximum(one[0], other[0]), np.minimum(one[1], other[1])


def length(source, way, inside):
    return np.maximum(inside[1] - inside[0], 0) * np.linalg.norm(way, axis=-1)


def chords(geometry, slices=True):
    """Path lengths in the cylinder without the box, and in the box, mm."""
    source, way = rays(geometry)
    box = (-np.inf, np.inf)
    for axis, (middle, side) in enumerate(zip(BOX_CENTRE_MM, BOX_MM, strict=True)):
        if slices or axis < 2:
            box = both(box, in_slab(source[..., axis], way[..., axis], middle, side))
    box = length(source, way, box)
    whole = length(source, way, in_cylinder(source, way, RADIUS_MM, HEIGHT_MM if slices else np.inf))
    return whole - box, box


def error(found, exact):
    return float(np.sqrt(((found - exact) ** 2).mean()))


@pytest.mark.parametrize(("slices", "geometry"), [(True, GEOMETRY), (False, GEOMETRY), (False, ONE_ROW)])
def test_path_lengths_converge_to_the_chords_with_smaller_voxels(slices, geometry, tmp_path):
    errors = {}
    exact = dict(zip(("pmma", "aluminium"), chords(geometry, slices), strict=True))
    for voxel_mm in (1.0, 0.25):
        path = written(labels_of(voxel_mm, slices), tmp_path / f"{voxel_mm}.nii.gz")
        scene = labelled_scene(read_label_map(path, {"1": "pmma", "2": "aluminium"}), DISC_ENERGY_KEV)
        found = scene.path_lengths(geometry)
        assert scene.materials == ("aluminium", "pmma") and found.shape == (2, *geometry.shape)
        errors[voxel_mm] = [error(one, exact[name]) for name, one in zip(scene.materials, found, strict=True)]
    # Root mean squares, mm: 0.35 to 0.71 at 1 mm, 0.09 to 0.16 at 0.25 mm.
    for coarse, fine in zip(errors[1.0], errors[0.25], strict=True):
        assert fine < 0.5 * coarse and coarse < 0.8 and fine < 0.2


@pytest.mark.parametrize("slices", [True, False])
def test_map_of_one_label_equals_the_mask(slices, tmp_path):
    volume = labels_of(1.0, slices)
    share = replace(volume, array=(volume.array > 0).astype(np.float32))
    mask = mask_scene(written(share, tmp_path / "mask.nii.gz"), "pmma")
    one = read_label_map(written(replace(share, array=3 * share.array), tmp_path / "labels.nii.gz"), {"3": "pmma"})
    scene = labelled_scene(one, DISC_ENERGY_KEV)
    pose = Pose(x_mm=1.0, y_mm=-0.5, turn_deg=7.0, size=1.01)
    np.testing.assert_array_equal(scene.path_lengths(GEOMETRY, pose), mask.path_lengths(GEOMETRY, pose))
    assert scene.radius_mm == mask.radius_mm and scene.is_binary and mask.is_binary
    spectrum = {"spectrum": {"kvp": 90.0, "filtration_mm": 3.0, "sensor_mm": 0.6}}
    for physics in ({}, spectrum):
        lines = [Chain(PosedScene(each), GEOMETRY).state(physics).line_integrals() for each in (scene, mask)]
        np.testing.assert_array_equal(*lines)


def test_label_numbers_have_no_meaning(tmp_path):
    volume = labels_of(1.0)
    three = volume.array + np.where((volume.array == 1) & (volume.grid.axes_mm()[2] < -5), 2, 0)
    names = {1: "pmma", 2: "aluminium", 3: "water"}
    expected = read_label_map(
        written(replace(volume, array=three.astype(np.int16)), tmp_path / "a.nii.gz"),
        {str(label): name for label, name in names.items()},
    )
    other = {0: 0, 1: 300, 2: 7, 3: 1}
    turned = np.vectorize(other.get)(three).astype(np.int16)
    found = read_label_map(
        written(replace(volume, array=turned), tmp_path / "b.nii.gz"),
        {str(other[label]): name for label, name in names.items()},
    )
    assert found.materials == expected.materials
    np.testing.assert_array_equal(found.shares, expected.shares)


def test_labels_of_one_definition_are_one_material(tmp_path):
    """In any notation: names, definitions, elements in another order."""
    path = written(labels_of(1.0), tmp_path / "labels.nii.gz")
    whole = written(replace(labels_of(1.0), array=(labels_of(1.0).array > 0).astype(np.uint8)), tmp_path / "1.nii.gz")
    water = {"mass_fractions": {"H": 0.112, "O": 0.888}, "density_g_per_cm3": 1}
    turned = {"mass_fractions": {"O": 0.888, "H": 0.112}, "density_g_per_cm3": 1.0, "note": "the same"}
    for one, other in (("pmma", "pmma"), ("PMMA", "Acrylic"), (ACRYLIC, dict(ACRYLIC)), (water, turned)):
        found, expected = read_label_map(path, {"1": one, "2": other}), read_label_map(whole, {"1": one})
        assert found.materials == expected.materials and len(found.materials) == 1
        np.testing.assert_array_equal(found.shares, expected.shares)
    assert len(read_label_map(path, {"1": ACRYLIC, "2": ACRYLIC | {"density_g_per_cm3": 1.18}}).materials) == 2


def test_defined_material_has_its_published_attenuation():
    """Polymethyl methacrylate, NIST XCOM (J. H. Hubbell, S. M. Seltzer, NISTIR 5632): 0.1924 cm2/g at 60 keV."""
    (material,) = label_materials({"1": ACRYLIC}).values()
    assert attenuation_per_mm(material, [60.0])[0] == pytest.approx(0.1924 * 1.19 / 10, rel=0.01)
    assert str(material) == "C5H8O2 (1.19 g/cm3)"


def test_labels_without_material_are_skipped(tmp_path):
    """Label 0 unless it is named, and labels of nothing; a material without voxels needs no lane."""
    path = written(labels_of(1.0), tmp_path / "labels.nii.gz")
    array = labels_of(1.0).array
    found = read_label_map(path, {"1": "pmma", "2": "nothing", "9": "copper"})
    assert found.materials == ("pmma",)
    np.testing.assert_array_equal(found.shares[0], array == 1)
    found = read_label_map(path, {"0": "water", "1": "pmma", "2": "nothing"})
    assert found.materials == ("pmma", "water")
    np.testing.assert_array_equal(found.shares, [array == 1, array == 0])


def test_labels_stored_as_floats_are_labels(tmp_path):
    volume = labels_of(1.0)
    whole = read_label_map(written(volume, tmp_path / "a.nii.gz"), {"1": "pmma", "2": "water"})
    floats = replace(volume, array=volume.array.astype(np.float32))
    found = read_label_map(written(floats, tmp_path / "b.nii.gz"), {"1": "pmma", "2": "water"})
    np.testing.assert_array_equal(found.shares, whole.shares)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda array: array * 0.5,
            "labels.nii.gz: holds 0.5, which is no label; give whole numbers, or shares of",
        ),
        (
            lambda array: np.where(array == 1, np.nan, array),
            "labels.nii.gz: holds NaN or infinite values; give a",
        ),
        (lambda array: array.astype(np.int16) - 1, "labels.nii.gz: holds the label -1; give whole numbers from 0 on"),
        (lambda array: 0 * array, "labels.nii.gz: holds no label of a material; name one under materials"),
        (lambda array: np.stack([array, array]), "labels.nii.gz: has 4 dimensions; give a 3D image"),
        (lambda array: 3 * array, "labels.nii.gz: its labels 3, 6 have no material; name one for each under materials"),
        (lambda array: array + np.uint8(1), "labels.nii.gz: its label 3 has no material; name one for each"),
        (
            lambda array: np.arange(array.size, dtype=np.int32).reshape(array.shape),
            "labels.nii.gz: its labels 3, 4, 5, 6, 7, 8, 9, 10, 11, 12 ... (64509 labels) have no material",
        ),
    ],
)
def test_invalid_maps_are_rejected_in_one_line(change, message, tmp_path):
    array = change(labels_of(1.0).array)
    kind = array.dtype if array.dtype.kind in "iu" else np.float32
    image = nibabel.Nifti1Image(array.T.astype(kind), np.eye(4))
    nibabel.save(image, tmp_path / "labels.nii.gz")
    with pytest.raises(InputError) as error:
        read_label_map(tmp_path / "labels.nii.gz", {"1": "pmma", "2": "water"})
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("pma", "materials.2: material 'pma' is unknown; did you mean 'pmma'?"),
        ({"density_g_per_cm3": 1.0}, "give it either a compound or mass_fractions"),
        (ACRYLIC | {"mass_fractions": {"H": 1.0}}, "give it either a compound or mass_fractions"),
        (ACRYLIC | {"compound": "Acrylglas"}, "'Acrylglas' is no chemical formula, element or compound"),
        ({"mass_fractions": {"H": 0.5}, "density_g_per_cm3": 1.0}, "mass_fractions add up to 0.5; make the sum 1"),
    ],
)
def test_invalid_materials_are_rejected_in_one_line(entry, message):
    with pytest.raises(InputError, match=r"^materials\.2: ") as error:
        label_materials({"1": "pmma", "2": entry})
    assert message in str(error.value) and "\n" not in str(error.value)


def test_missing_map_is_reported(tmp_path):
    with pytest.raises(InputError, match="none.nii.gz: no such file; give the path of a NIfTI image"):
        read_label_map(tmp_path / "none.nii.gz", {"1": "pmma"})
