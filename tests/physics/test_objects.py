"""Objects of shapes from files: values of manuals, parameters, and voxels with the volume of the shapes."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import ShapedRoi
from virtual_phantom.physics.beam.materials import Mixture, attenuation_per_mm
from virtual_phantom.physics.scenes.object_files import object_names, object_path
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.shapes import NOTHING, DiscScene, ShapesScene, box, cone, cylinder, ellipsoid
from virtual_phantom.physics.scenes.voxelized import shape_shares, voxelize
from virtual_phantom.study.checks.preflight import problems

MU_WATER = 0.0193
GIVEN = {  # parameters without default
    "ball": {"diameter_mm": 6, "material": "tungsten"},
    "step_wedge": {"step_mm": 2, "tread_mm": 8, "width_mm": 20},
}
# HU in the Catphan 503 manual and the ACR's instructions, over scanners and tube voltages.
CATPHAN = {
    "pmp": (-220, -172),
    "ldpe": (-121, -87),
    "polystyrene": (-65, -29),
    "acrylic": (92, 137),
    "delrin": (344, 387),
    "teflon": (941, 1060),
    "air_top": (-1046, -986),
}
ACR = {"polyethylene": (-107, -84), "bone": (850, 970), "acrylic": (110, 135), "air": (-1005, -970), "water": (-7, 7)}
READ_HU = 5  # uncertainty of the energy: 70 keV represents all tube voltages


@pytest.mark.parametrize("name", object_names())
def test_shipped_object_states_its_source_and_can_be_scanned(name):
    content = yaml.safe_load(object_path(name).read_text())
    assert content["sources"] or content["not_known"]
    shaped = read_object(name, GIVEN.get(name))
    geometry = circular(
        views=3,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=900.0,
        columns=40,
        rows=3,
        column_pitch_mm=10.0,
        row_pitch_mm=1.0,
    )
    paths = ShapesScene(shaped.shapes).path_lengths(geometry)
    assert np.isfinite(paths).all() and paths.min() >= 0
    assert {roi.shape for roi in shaped.rois} <= set(shaped.names)


def test_parameters_accept_common_names_of_library_materials():
    (ball,) = read_object("ball", {"diameter_mm": 6, "material": "Acrylic"}).shapes
    assert ball.material == "pmma"
    # Materials of an object have priority: the ACR phantom's has its own density.
    shaped = read_object("acr464_module1")
    assert shaped.shapes[shaped.names.index("acrylic")].material.density_g_per_cm3 == 1.18


@pytest.mark.parametrize("name, ranges", [("catphan504_ctp404", CATPHAN), ("acr464_module1", ACR)])
def test_materials_have_the_hu_of_the_manuals(name, ranges):
    shaped = read_object(name)
    water = attenuation_per_mm("water", [70.0])[0]
    for shape, (low, high) in ranges.items():
        material = shaped.shapes[shaped.names.index(shape)].material
        hu = 1000 * (attenuation_per_mm(material, [70.0])[0] / water - 1)
        assert low - READ_HU <= hu <= high + READ_HU, shape


def test_mixture_equals_the_library_material():
    """Water by its formula and by its elements (CRC Handbook: 11.19 and 88.81 % by mass)."""
    energies = [30.0, 60.0, 100.0]
    water = attenuation_per_mm("water", energies)
    for mixture in (
        Mixture("one", 1.0, "H2O"),
        Mixture("two", 1.0, "Water, Liquid"),
        Mixture("three", 1.0, None, (("H", 0.1119), ("O", 0.8881))),
    ):
        np.testing.assert_allclose(attenuation_per_mm(mixture, energies), water, rtol=2e-4)
    np.testing.assert_allclose(attenuation_per_mm(Mixture("thin", 0.5, "H2O"), energies), water / 2, rtol=2e-4)


def written(folder, **content):
    path = Path(folder) / "mine.yaml"
    path.write_text(yaml.safe_dump({"description": "mine", **content}))
    return str(path)


def test_user_object_file(tmp_path):
    """A tube of PMMA with 'wax' in it, with sizes calculated from a parameter and a position given by an angle."""
    mine = written(
        tmp_path,
        parameters={"wide_mm": {"description": "mm", "default": 40}, "what": {"description": "", "default": "wax"}},
        materials={"wax": {"compound": "C25H52", "density_g_per_cm3": "0.9"}},
        shapes=[
            {
                "name": "wall",
                "kind": "tube",
                "material": "pmma",
                "inside": "what",
                "outer_diameter_mm": "2 * (wide_mm - 5)",
                "inner_diameter_mm": "wide_mm + wide_mm / 2",
            },
            {"kind": "ball", "material": "water", "diameter_mm": 4, "distance_mm": 10, "angle_deg": 90, "z_mm": -2},
        ],
    )
    shaped = read_object(mine, {"wide_mm": 30})
    assert [str(shape.material) for shape in shaped.shapes] == ["pmma", "wax", "water"]
    assert shaped.names == ("wall", None, None)
    assert shaped.shapes[0].around[2] == pytest.approx(25, abs=0.01)
    assert shaped.shapes[1].around[2] == pytest.approx(22.5, abs=0.01)
    np.testing.assert_allclose(shaped.shapes[2].around[:2], (0, 10), atol=1e-9)
    assert read_object(mine, {"what": NOTHING}).shapes[1].material == NOTHING


def test_file_on_the_page_is_an_object(tmp_path):
    page = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "objects.md").read_text(encoding="utf-8")
    (block,) = [one for one in re.findall(r"```yaml\n(.*?)```", page, re.DOTALL) if one.startswith("description:")]
    (tmp_path / "bottle.yaml").write_text(block)
    shaped = read_object(str(tmp_path / "bottle.yaml"), {"wide_mm": 40})
    assert [shape.around[2] for shape in shaped.shapes[:2]] == pytest.approx([21, 20], abs=0.01)
    listed = page.split("## Included objects")[1].split("## ")[0]
    assert set(object_names()) == set(re.findall(r"`(\w+)`", listed))


def test_shipped_cylinder_equals_its_discs():
    """Water in a wall of acrylic, against chords of two discs."""
    shaped = read_object("water_cylinder", {"diameter_mm": 60, "wall_mm": 4, "length_mm": 400})
    geometry = circular(
        views=5,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=900.0,
        columns=64,
        rows=5,
        column_pitch_mm=2.5,
        row_pitch_mm=4.0,
    )
    wall, water = ShapesScene(shaped.shapes).path_lengths(geometry)
    outer, inner = (DiscScene(d, "water").path_lengths(geometry)[0] for d in (68.0, 60.0))
    np.testing.assert_allclose(water, inner, atol=1e-5 * inner.max())
    np.testing.assert_allclose(wall, outer - inner, atol=1e-5 * outer.max())


@pytest.mark.parametrize(
    "change, message",
    [
        ({"shapes": [{"kind": "prism", "material": "pmma"}]}, "use one of cylinder, tube, ball"),
        ({"shapes": [{"kind": "ball", "material": "pmma", "diameter": 4}]}, "did you mean 'diameter_mm'"),
        ({"shapes": [{"kind": "ball", "material": "pma", "diameter_mm": 4}]}, "did you mean 'pmma'"),
        ({"shapes": [{"kind": "ball", "material": "pmma", "diameter_mm": -4}]}, "must be positive"),
        ({"shapes": [{"kind": "ball", "material": "pmma", "diameter_mm": "two"}]}, "'two' is not a number"),
        (
            {"shapes": [{"kind": "ball", "material": "pmma", "diameter_mm": "abs(-4)"}]},
            "is not a number",
        ),
        ({"shapes": [{"kind": "ball", "material": "pmma", "diameter_mm": "9 ** 9"}]}, "is not a number"),
        ({"materials": {"wax": {"compound": "Wxy", "density_g_per_cm3": 1}}}, "no chemical formula"),
        ({"materials": {"wax": {"density_g_per_cm3": 1}}}, "either a compound or mass_fractions"),
        ({"materials": {"wax": {"mass_fractions": {"H": 0.5}, "density_g_per_cm3": 1}}}, "add up to 0.5"),
        ({"rois": [{"name": "a", "tissue_class": "a", "shape": "bal"}]}, "did you mean 'ball'"),
    ],
)
def test_error_in_a_file_is_one_line(tmp_path, change, message):
    content = {"shapes": [{"name": "ball", "kind": "ball", "material": "pmma", "diameter_mm": 4}], **change}
    with pytest.raises(InputError, match="mine.yaml: ") as error:
        read_object(written(tmp_path, **content))
    assert message in str(error.value)


@pytest.mark.parametrize(
    "kind, parameters, message",
    [
        ("catphan504", None, "there is no object 'catphan504'; did you mean 'catphan504_ctp4"),
        ("mine.yaml", None, "mine.yaml: no such file"),
        ("ball", None, "needs the parameters diameter_mm"),
        ("pmma_disc", {"diameter": 5}, "did you mean 'diameter_mm'"),
    ],
)
def test_missing_object_is_one_line(kind, parameters, message):
    with pytest.raises(InputError, match=message):
        read_object(kind, parameters)


ROI = {"name": "bone", "tissue_class": "bone", "shape": "bon"}
MEANT = "did you mean 'bone'?"
GRID = Grid((40, 44, 48), (1.5, 1.2, 1.1))


@pytest.mark.parametrize(
    "shape, volume",
    [
        (ellipsoid("water", (1.3, -2.1, 0.4), (11, 14, 9), 30.0), 4 / 3 * math.pi * 11 * 14 * 9),
        (cylinder("water", (2, 1, -3), 9.0, 21.0, (1, 2, 3)), math.pi * 81 * 21),
        (cylinder("water", (2, 1, 0), 9.0), math.pi * 81 * 60),
        (box("water", (-3, 2, 1), (17, 12, 23), 20.0), 17 * 12 * 23),
        (cone("water", (0, 0, -10), 14.0, 5.0, 22.0), math.pi * 22 / 3 * (14**2 + 14 * 5 + 5**2)),
    ],
)
def test_voxels_have_the_volume_of_the_shape(shape, volume):
    (share,) = shape_shares([shape], GRID)
    assert share.min() >= 0 and share.max() == 1
    assert share.sum() * np.prod(GRID.spacing) == pytest.approx(volume, rel=4e-3)


def test_later_shapes_replace_earlier_ones():
    shares = shape_shares([ellipsoid("water", (0, 0, 0), (20, 20, 20)), cylinder(NOTHING, (0, 0, 0), 6.0)], GRID)
    together = shape_shares([ellipsoid("water", (0, 0, 0), (20, 20, 20))], GRID)[0]
    np.testing.assert_allclose(np.minimum(shares.sum(axis=0), 1)[together > 0], shares.sum(axis=0)[together > 0])
    # Volume of a ball with a drilled hole: 4/3 pi (R^2 - r^2)^1.5, a function of its height only.
    left = 4 / 3 * math.pi * (20**2 - 6**2) ** 1.5
    assert shares[0].sum() * np.prod(GRID.spacing) == pytest.approx(left, rel=2e-3)


def test_phantom_of_shapes_has_its_hu_and_regions():
    grid = Grid((6, 60, 60), (4.0, 3.6, 3.6))
    shaped = read_object("acr464_module1")
    phantom = voxelize(shaped, grid, 2, MU_WATER)
    by_name = {roi.name: roi.mask for roi in phantom.rois}
    assert by_name.keys() == {"polyethylene", "bone", "acrylic", "water"}
    assert phantom.image.array[by_name["bone"]].mean() == pytest.approx(955, abs=READ_HU)
    assert phantom.image.array[:, 0, 0] == pytest.approx(-1000)
    z, y, x = np.argwhere(by_name["bone"]).mean(axis=0)
    place = np.array([x, y]) * 3.6 - 59 / 2 * 3.6
    np.testing.assert_allclose(place, 63 * np.sqrt([0.5, 0.5]), atol=1)  # 45 degrees from +x to +y
    assert by_name["bone"].any(axis=(1, 2)).all()  # in every slice: the grid's end is no edge
    away = np.hypot(*(np.argwhere(by_name["bone"])[:, :0:-1] * 3.6 - 59 / 2 * 3.6 - 63 * np.sqrt(0.5)).T)
    assert away.max() < 12.5 - 3 + 1.8  # by 3 mm, within half a voxel
    (part,) = voxelize(shaped, grid, 1, MU_WATER, [ShapedRoi("all", "all", "body")]).rois
    assert part.mask.sum() > by_name["bone"].sum()


def test_check_reports_unscanned_parts_of_a_phantom_of_shapes():
    """A module of 200 mm, scanned by a fan that covers 70 mm of the axis."""
    config = yaml.safe_load((Path(__file__).resolve().parents[2] / "config" / "paper_groups.yaml").read_text())
    pca = {name: {**one, "fit_on": "simulated"} for name, one in config["analyses"]["pca"].items()}
    config |= {
        "phantom": {"source": "object", "object": {"kind": "acr464_module1"}},
        "measured": {"overlay": False},
        "grid": {"shape": [4, 70, 70], "spacing_mm": [4.0, 3.0, 3.0]},
        "analyses": config["analyses"] | {"pca": pca},
    }
    assert problems(config, scans=True) == []
    narrow = config | {"scan": config["scan"] | {"columns": 90}}
    assert any("the phantom reaches 100 mm from the isocenter" in line for line in problems(narrow, scans=True))
    misspelled = config | {"phantom": {"source": "object", "object": {"kind": "acr464_module1", "rois": [ROI]}}}
    assert problems(misspelled) == ["phantom.object: rois: bone names the shape 'bon', which does not exist; " + MEANT]


def test_object_larger_than_the_grid_is_rejected():
    with pytest.raises(InputError, match="reaches 100.0 mm from the isocenter along x, but the grid only 50.0 mm"):
        voxelize(read_object("acr464_module1"), Grid((4, 50, 50), (2.0, 2.0, 2.0)), 1, MU_WATER)
