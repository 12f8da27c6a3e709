"""Errors of the stated object: templates in closed form, fits within their priors, and alternatives to effects."""

from dataclasses import replace
from functools import cache

import jsonschema
import numpy as np
import pytest
from drawn_objects import CYLINDERS, ENERGY_KEV, MATERIALS, drawn
from drawn_objects import GEOMETRY as FAN
from simulated_scans import disc_bench, scans_of

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.pose import IN_PLACE
from virtual_phantom.base.units import hu_to_attenuation
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.planning.information import information_gain, normal_equations
from virtual_phantom.diagnosis.planning.measurement import FurtherScan
from virtual_phantom.diagnosis.planning.ranking import conditions_of
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.projections.object_errors import StatedObject
from virtual_phantom.diagnosis.projections.voxel_surfaces import (
    LabelSurfaces,
    VoxelSurfaces,
    growth_of,
    growth_of_parts,
    labelled_parts,
)
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.scanned_object import labelled_scene
from virtual_phantom.diagnosis.settings import Disc, ObjectUncertainty, RecordingSettings
from virtual_phantom.io import documents
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import Mixture, Segmentation, attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes import shapes
from virtual_phantom.physics.scenes.labeled import read_label_map
from virtual_phantom.physics.scenes.sampling import average_rays, supersampled
from virtual_phantom.physics.scenes.scene import MARGIN, VoxelScene
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, cylinder

PHOTONS, MU_WATER = 1e5, 0.02
GEOMETRY = circular(
    views=24,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=41,
    rows=2,
    column_pitch_mm=10.0,
    row_pitch_mm=10.0,
    view_interval_ms=10.0,
)
TEFLON = Mixture("teflon", 2.16, "C2F4")


def shapes_scene(teflon=TEFLON):
    """Cylinder of water with a rod of PTFE."""
    return ShapesScene([cylinder("water", (0, 0, 0), 90), cylinder(teflon, (50, 0, 0), 20)])


def ready(uncertainty, denser=1.0, physics=None, seed=1):
    """Scan whose PTFE is denser than stated, prepared with this uncertainty (None: exact)."""
    scanned = shapes_scene(Mixture("teflon", denser * TEFLON.density_g_per_cm3, "C2F4"))
    state = Chain(scanned, GEOMETRY, PHOTONS, samples=3).state(physics or {})
    taken = scans_of(state, 4, np.random.default_rng(seed))
    model, floor = model_and_floor(shapes_scene(), GEOMETRY, 2, photons=PHOTONS)
    uncertain = None if uncertainty is None else StatedObject(shapes_scene(), uncertainty, MU_WATER)
    options = {"floor_chain": floor, "nominal_photons": PHOTONS, "uncertain": uncertain}
    return prepared.prepare(taken, None, model, **options)


@cache
def content(exact, denser=1.0, scatter=0.0):
    physics = {"scatter": {"amount": scatter, "width_mm": 60.0}} if scatter else None
    data = ready(None if exact else ObjectUncertainty(), denser, physics)
    accuracy = defaults_of("diagnosis", "model_accuracy")
    found = find_missing_physics("bench", data, ("scatter", "dark_signal"), accuracy).content
    jsonschema.validate(found, documents.schema_of_kind("diagnosis"))
    return found


def test_the_change_by_a_density_is_the_line_integral_of_its_material():
    narrow = replace(GEOMETRY, column_pitch_mm=1.0)
    errors = StatedObject(shapes_scene(), ObjectUncertainty(), MU_WATER).errors(narrow, 1)
    assert errors.names == ("density_of_water", "density_of_teflon", "surface_of_water", "surface_of_teflon")
    through = errors.changes[:, 6, :, 20].mean(axis=1)  # a view along x, through both centers
    water, teflon = (attenuation_per_mm(material, [60.0])[0] for material in ("water", TEFLON))
    assert through[:2] == pytest.approx([water * 140, teflon * 40], rel=1e-3)
    assert through[2:] == pytest.approx([2 * water, 2 * (teflon - water)], rel=1e-2)
    scene = ShapesScene([cylinder("water", (0, 0, 0), 90), cylinder("nothing", (50, 0, 0), 20)])
    errors = StatedObject(scene, ObjectUncertainty(), MU_WATER).errors(narrow, 1)
    assert errors.names == ("density_of_water", "surface_of_water", "surface_of_nothing")
    assert errors.changes[1:, 6, :, 20].mean(axis=1) == pytest.approx([2 * water, -2 * water], rel=1e-2)


@pytest.mark.parametrize("labels", [False, True])
def test_surfaces_of_shapes_and_of_voxels_grow_alike(labels):
    """A rod keeps its size if the water around it grows."""
    grid = Grid((4, 200, 200), (4.0, 1.0, 1.0))
    _, y, x = grid.axes_mm()
    body, rod = (
        np.broadcast_to(np.clip(radius + 0.5 - np.hypot(x - at, y[:, None]), 0, 1), grid.shape)
        for radius, at in ((90, 0), (20, 50))
    )
    body, rod = (np.round(share) if labels else share for share in (body, rod))
    scene = VoxelScene(np.stack([body * (1 - rod), rod]).astype(np.float32), grid, ("water", TEFLON), 60.0)
    found = [StatedObject(one, ObjectUncertainty(), MU_WATER).errors(GEOMETRY, 3) for one in (shapes_scene(), scene)]
    of_shapes, of_voxels = (errors.changes[2:].sum(axis=(1, 3)) for errors in found)
    assert of_voxels == pytest.approx(of_shapes, rel=0.05)


@pytest.mark.parametrize(
    ("shape", "grown"),
    [
        (shapes.ellipsoid("water", (5, 0, 0), (30, 30, 30)), shapes.ellipsoid("water", (5, 0, 0), (31, 31, 31))),
        (shapes.cylinder("water", (5, 0, 0), 30, 20), shapes.cylinder("water", (5, 0, 0), 31, 22)),
        (shapes.box("water", (5, 0, 0), (30, 40, 20), 20), shapes.box("water", (5, 0, 0), (32, 42, 22), 20)),
        (
            shapes.cone("water", (5, 0, -8), 30, 6, 18, (0, 0.6, 0.8)),
            shapes.cone(
                "water",
                np.add((5, 0, -8), np.multiply(-1, (0, 0.6, 0.8))),
                30 + 5 / 3 + 4 / 3,
                6 + 5 / 3 - 4 / 3,
                20,
                (0, 0.6, 0.8),
            ),
        ),
    ],
)
def test_a_grown_shape_has_its_surface_displaced(shape, grown):
    lengths = [ShapesScene([one]).path_lengths(GEOMETRY) for one in (shape.grown(1.0), grown)]
    assert lengths[1].max() > 20
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-3)


@pytest.mark.parametrize("samples", [1, 3])
def test_the_changes_by_hu_of_all_values_add_up_to_a_change_of_all_hu(samples):
    grid = Grid((2, 40, 40), (5.0, 5.0, 5.0))
    hu = np.random.default_rng(3).uniform(-690, 1900, grid.shape).astype(np.float32)
    scene = VoxelScene.of(Volume(hu, grid), Segmentation("water", None), MU_WATER)
    errors = StatedObject(scene, ObjectUncertainty(), MU_WATER, Volume(hu, grid)).errors(GEOMETRY, samples)
    denser = VoxelScene.of(Volume(hu + 10, grid), Segmentation("water", None), MU_WATER)
    lines = [Chain(one, GEOMETRY, samples=samples).state({}).line_integrals() for one in (scene, denser)]
    of_hu = np.array([name.startswith("hu_near_") for name in errors.names])
    assert 10 * errors.changes[of_hu].sum(axis=0) == pytest.approx(lines[1] - lines[0], abs=1e-4)
    assert hu_to_attenuation(np.array([10.0]), MU_WATER) - MU_WATER == pytest.approx(10 * MU_WATER / 1000)
    sds = {number.name: number.sd for number in errors.numbers}
    assert sds["hu_near_50"] == 5
    assert sds["hu_near_1000"] == pytest.approx(np.hypot(5, 20))


def test_surfaces_of_a_phantom_in_hu_grow_by_part():
    grid = Grid((4, 100, 100), (4.0, 2.0, 2.0))
    _, y, x = grid.axes_mm()
    body, hole, rod = (
        np.broadcast_to(np.clip((radius - np.hypot(x - at, y[:, None])) / 2 + 0.5, 0, 1), grid.shape)
        for radius, at in ((90, 0), (20, -40), (20, 50))
    )
    hu = (1000 * (body - hole + 0.8 * rod - 1)).astype(np.float32)
    scene = VoxelScene.of(Volume(hu, grid), Segmentation("water", None), MU_WATER)
    errors = StatedObject(scene, ObjectUncertainty(), MU_WATER, Volume(hu, grid)).errors(GEOMETRY, 3)
    found = {number.name: (number.sd, change) for number, change in zip(errors.numbers, errors.changes, strict=True)}
    through = {name: change[6, :, 20].mean() for name, (_, change) in found.items() if name.startswith("surface_of_")}
    expected = {"body": 2, "air inside 1": -2, "dense part 1": 1.6}  # along x, through both walls
    assert through == pytest.approx({f"surface_of_{key}": MU_WATER * n for key, n in expected.items()}, rel=0.02)
    assert found["surface_of_body"][0] == pytest.approx(np.hypot(0.2, 0.25 * 2))


def test_a_material_that_the_object_does_not_have_is_rejected():
    uncertainty = ObjectUncertainty(materials={"tefon": 0.02})
    with pytest.raises(InputError, match="object_uncertainty.materials: the object has no material 'tefon'"):
        StatedObject(shapes_scene(), uncertainty, MU_WATER).errors(GEOMETRY, 1)
    disc = ShapesScene([cylinder("water", (0, 0, 0), 90)])
    with pytest.raises(InputError, match=r"use alignment: \{scale: SD\}"):
        StatedObject(disc, ObjectUncertainty(materials={"water": 0.02}), MU_WATER).errors(GEOMETRY, 1)


def test_an_exact_object_has_no_errors_and_a_single_material_only_a_scale():
    disc = ShapesScene([cylinder("water", (0, 0, 0), 90)])
    assert StatedObject(disc, ObjectUncertainty(), MU_WATER).errors(GEOMETRY, 1).names == ()
    assert ready(None).fitter.model.object_errors.names == ()


def test_a_disc_has_an_uncertain_radius_and_without_an_energy_an_uncertain_attenuation():
    # Narrow columns: the scale multiplies line integrals of pixels, also those that the disc covers in part.
    fan = replace(disc_bench(view_interval_ms=10.0), columns=96, column_pitch_mm=4.0)
    true, told = DiscScene(160.4, "pmma", energy_kev=50.0), DiscScene(160.0, "pmma")
    taken = scans_of(Chain(true, fan, PHOTONS, samples=3).state({}), 4, np.random.default_rng(1))
    request = DiagnosisRequest("scan", RecordingSettings(None, None, {}, disc=Disc(160.0, "pmma")), MU_WATER, None)
    model, floor = model_and_floor(told, fan, 2, photons=PHOTONS)
    contents = {}
    for uncertain in (StatedObject(told, ObjectUncertainty(), MU_WATER), None):
        options = {"floor_chain": floor, "uncertain": uncertain, "known": request.alignment({})}
        data = prepared.prepare(taken, None, model, **options)
        accuracy = defaults_of("diagnosis", "model_accuracy")
        effects = ("source_distance", "detector_saturation")
        contents[uncertain is None] = find_missing_physics("disc", data, effects, accuracy).content
    assert contents[False]["verdict"] == "match" != contents[True]["verdict"]
    found = {name: number["value"] for name, number in contents[False]["alignment"].items()}
    assert found["size"] == pytest.approx(80.2 / 80, abs=2e-4)
    scanned, assumed = attenuation_per_mm("pmma", [50.0, 60.0])
    assert found["scale"] == pytest.approx(scanned / assumed, abs=1e-3)
    assert request.alignment({"energy_kev": 50.0}) == request.alignment({"tube_kvp": 80.0}) == {}


def test_a_density_within_its_uncertainty_is_fitted_and_no_effect_named():
    fit = trial(ready(ObjectUncertainty(), denser=1.015).fitter, ()).fit
    assert fit.nuisance["density_of_teflon"] == pytest.approx(0.015, abs=3 * fit.nuisance_errors["density_of_teflon"])
    assert fit.nuisance_errors["density_of_teflon"] < 0.005
    found = content(False, denser=1.015)
    assert found["verdict"] == "match"
    assert "teflon that is" in found["object_errors"]["what"]
    assert content(True, denser=1.015)["verdict"] != "match"


def test_scatter_is_named_beside_an_uncertain_object():
    found = content(False, scatter=0.05)
    assert [effect["name"] for effect in found["effects"]] == ["scatter"]
    assert found["object_errors"] == {}
    amount = found["effects"][0]["parameters"]["amount"]
    assert amount["ci95"][0] < 0.05 < amount["ci95"][1]
    exact = content(True, scatter=0.05)["effects"][0]["parameters"]["amount"]
    assert np.ptp(amount["ci95"]) > np.ptp(exact["ci95"])


def test_effects_that_errors_of_the_object_imitate_are_reported():
    found = content(False, scatter=0.008)
    assert found["verdict"] == "match"
    assert "scatter" in found["object_errors"]["imitated_by"]
    assert any("scatter or dark signal would explain this, too" in line for line in found["verdict_lines"])
    assert "another tube voltage, or repeat the scan with the beam collimated" in found["next_measurement"][0]


def test_scans_of_the_same_object_share_its_errors():
    found = []
    for uncertainty in (None, ObjectUncertainty()):
        data = ready(uncertainty)
        model, conditions = data.fitter.model, conditions_of(data)
        fit = data.fitter.fit(("scatter",))
        scene = model.chain.scene
        other = ShapesScene([cylinder("pmma", (0, 0, 0), 60), cylinder(TEFLON, (0, 0, 0), 9)])
        scans = [FurtherScan(str(number), "", of, GEOMETRY) for number, of in enumerate((scene, scene, other))]
        parts = [scan.information(model, fit, conditions) for scan in scans]
        counts = [len(set(part.keys) & set(parts[0].keys)) for part in parts[1:]]
        keys = [key for key in parts[0].keys if key[0] == "scatter"]
        gains = [
            information_gain(normal_equations(parts[:1]), normal_equations([parts[0], part]), keys)
            for part in parts[1:]
        ]
        found.append((counts, gains))
    exact, uncertain = found
    assert uncertain[0] == [exact[0][0] + 4, exact[0][1]]  # two densities and two surfaces
    assert uncertain[1][0] < exact[1][0]
    assert uncertain[1][1] == pytest.approx(exact[1][1], rel=0.01)  # errors of another object are other ones


@pytest.mark.parametrize("voxel_mm", [0.7, 2.8])  # half a detector pixel, and two
def test_sharp_edges_in_voxels_are_a_match(tmp_path, voxel_mm):
    labels = drawn(tmp_path / "labels.nii.gz", voxel_mm)
    labelled = read_label_map(labels, {str(label): material for label, material in MATERIALS.items()})
    scene = labelled_scene(labelled, ENERGY_KEV)
    true = ShapesScene([cylinder(*one) for one in CYLINDERS], ENERGY_KEV)
    state = Chain(true, FAN, PHOTONS, samples=3).state({})
    taken = scans_of(state, 4, np.random.default_rng(1))
    verdicts = []
    for uncertain in (StatedObject(scene, ObjectUncertainty(), MU_WATER), None):
        model, floor = model_and_floor(scene, FAN, 2, photons=PHOTONS)
        options = {"floor_chain": floor, "nominal_photons": PHOTONS, "uncertain": uncertain}
        data = prepared.prepare(taken, None, model, **options)
        accuracy = defaults_of("diagnosis", "model_accuracy")
        verdicts.append(find_missing_physics("bench", data, ("scatter",), accuracy).content["verdict"])
    assert verdicts[0] == "match"
    assert verdicts[1] != "match"


def test_large_errors_of_surfaces_are_exact_where_they_are_linearized():
    stated = {"surface_of_water": -0.4, "surface_of_teflon": 0.3, "density_of_teflon": 0.02}
    denser = Mixture("teflon", 1.02 * TEFLON.density_g_per_cm3, "C2F4")
    scanned = ShapesScene([cylinder("water", (0, 0, 0), 89.6), cylinder(denser, (50, 0, 0), 20.3)])
    lines = [Chain(scene, GEOMETRY, samples=4).state({}).line_integrals() for scene in (shapes_scene(), scanned)]
    left = []
    for about in (None, stated):
        uncertain = StatedObject(shapes_scene(), ObjectUncertainty(), MU_WATER)
        errors = uncertain.errors(GEOMETRY, 4, about=about)
        found = errors.lines({name: stated.get(name, 0.0) for name in errors.names})
        found += Chain(uncertain.with_surfaces(about), GEOMETRY, samples=4).state({}).line_integrals() - lines[0]
        left.append(np.std(found - (lines[1] - lines[0])) / np.std(lines[1] - lines[0]))
    assert left[0] > 0.05
    assert left[1] < 1e-4


def test_errors_of_surfaces_are_linearized_again_at_a_fit_unless_it_lacks_physics():
    def linearized(larger_mm, first=None):
        scanned = ShapesScene([cylinder("water", (0, 0, 0), 90 + larger_mm), cylinder(TEFLON, (50, 0, 0), 20)])
        taken = scans_of(Chain(scanned, GEOMETRY, PHOTONS, samples=4).state({}), 4, np.random.default_rng(2))
        uncertain = StatedObject(shapes_scene(), ObjectUncertainty(), MU_WATER)
        fitted = uncertain.with_surfaces(None if first is None else first.nuisance)
        model, floor = model_and_floor(fitted, GEOMETRY, 4, photons=PHOTONS)
        options = {"floor_chain": floor, "nominal_photons": PHOTONS, "uncertain": uncertain, "first": first}
        data = prepared.prepare(taken, None, model, known={"size": 1e-7}, **options)
        return replace(data, about=lambda fit: linearized(larger_mm, fit))

    data = linearized(0.5)
    fit = data.whole.fit(())
    again = data.linearized_at(fit, 8.0)
    assert again is not data
    better = again.whole.fit((), fit)
    assert better.chi_square < fit.chi_square - 500
    assert better.nuisance["surface_of_water"] == pytest.approx(0.5, abs=0.02)
    settled = again.linearized_at(better, 1.0)
    best = settled.whole.fit((), better)
    assert best.nuisance["surface_of_water"] == pytest.approx(0.5, abs=0.005)
    assert settled.linearized_at(best, 1.0) is settled
    wrong = linearized(1.0)
    assert wrong.linearized_at(wrong.whole.fit(()), 8.0) is wrong
    assert replace(data, about=None).linearized_at(fit, 8.0).about is None


def test_displaced_surfaces_of_voxels_follow_a_grown_disc():
    side = (np.arange(960) + 0.5) / 16 - 30
    disc, larger = (
        (np.hypot(side - 0.3, side[:, None] + 0.2) < radius).reshape(60, 16, 60, 16).mean(axis=(1, 3))[None]
        for radius in (20.0, 20.8)
    )
    voxel = (1.0, 1.0, 1.0)
    surfaces = VoxelSurfaces(disc, {"disc": growth_of(disc, disc, voxel)}, voxel)
    grown = surfaces.grown({"disc": 0.8})
    linear = disc + 0.8 * surfaces.growth["disc"]
    errors = [np.std((found - larger).sum(axis=1)) for found in (grown.values, linear)]
    assert grown.values.sum() - disc.sum() == pytest.approx(larger.sum() - disc.sum(), rel=0.05)
    assert errors[0] < 0.25 * errors[1]


@pytest.mark.parametrize("by_mm", [-0.9, -0.4, 0.3, 0.8])
def test_displaced_surfaces_of_labels_have_chords_in_closed_form(by_mm):
    voxel, radius, center = 1.5, 60.3, 0.4
    along = (np.arange(100) - 49.5) * voxel
    labels = (np.hypot(along - center, along[:, None]) < radius).astype(np.float32)
    scene = VoxelScene(labels[None, None], Grid((1, 100, 100), (voxel,) * 3), ("water",), 60.0).with_partial_volumes()
    found, first = LabelSurfaces.of(scene, labelled_parts(scene, 12)), int(labels.any(axis=0).argmax()) - MARGIN
    pixel = np.ones(3) / 3
    places = along[:, None] + (np.arange(32) + 0.5) / 32 * voxel - voxel / 2 - center

    def chords(by):
        return np.convolve(2 * np.sqrt(np.maximum((radius + by) ** 2 - places**2, 0)).mean(axis=1), pixel, "same")

    def columns(values):
        chord = np.pad(voxel * values[0].sum(axis=0), (first, 100 - first - values.shape[-1]))
        return np.convolve(chord, pixel, "same")

    grown = found.grown({"water": by_mm})
    change = (columns(grown.attenuation) - columns(found.attenuation)) / scene.attenuation_per_mm[0]
    expected = chords(by_mm) - chords(0)
    assert np.std(change - expected) < 0.15 * np.std(expected)
    slope = columns(grown.growth["water"]) / scene.attenuation_per_mm[0]
    expected = (chords(by_mm + 0.05) - chords(by_mm - 0.05)) / 0.1
    inner = chords(0) > radius
    assert np.std((slope - expected)[inner]) < 0.2 * expected[inner].mean()
    assert slope.sum() == pytest.approx(expected.sum(), rel=0.03)


@pytest.mark.parametrize("by_mm", [-0.27, 0.2])
def test_the_error_of_displaced_surfaces_of_voxels_is_the_stated_one(by_mm):
    radius, voxel = 60.3, 1.5
    side = (np.arange(100 * 8) + 0.5) * voxel / 8 - 50 * voxel
    disc = (np.hypot(side, side[:, None]) < radius).reshape(100, 8, 100, 8).mean(axis=(1, 3))
    grid = Grid((8, 100, 100), (voxel, voxel, voxel))
    hu = np.broadcast_to(1000 * (disc - 1), grid.shape).astype(np.float32)
    fine = replace(GEOMETRY, columns=61, column_pitch_mm=4.5, row_pitch_mm=2.0)
    scene = VoxelScene.of(Volume(hu, grid), Segmentation("water", None), MU_WATER)
    stated = StatedObject(scene, ObjectUncertainty(), MU_WATER, Volume(hu, grid))
    about = {"surface_of_body": by_mm}
    errors = stated.errors(fine, 4, about=about)
    found = errors.lines(dict.fromkeys(errors.names, 0.0) | about)

    def lines(radius_mm):
        water = ShapesScene([cylinder("water", (0, 0, 0), radius_mm)], scene.energy_kev)
        rays = supersampled(fine, 32)
        return -np.log(
            sum(average_rays(np.exp(-MU_WATER * water.path_lengths(one)[0]), weights) for one, weights in rays)
        )

    expected = lines(radius + by_mm) - lines(radius)
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)
    stated_sd = errors.left / np.sqrt(fine.rows)  # the rows share the error
    assert 0.4 < np.sqrt(((found - expected) ** 2).mean() / (stated_sd**2).mean()) < 1.2


@pytest.mark.parametrize("radius", [60.3, 60.7, 61.1])
def test_sharp_edges_of_labels_have_line_integrals_in_closed_form(radius):
    """The radius of a disc does not follow exactly from its voxels, so a change of the radius is fitted."""
    along = (np.arange(100) - 49.5) * 1.5
    labels = np.broadcast_to(np.hypot(along, along[:, None]) < radius, (8, 100, 100)).astype(np.float32)
    fine = replace(GEOMETRY, columns=61, column_pitch_mm=4.5, row_pitch_mm=2.0)
    scene = VoxelScene(labels[None], Grid((8, 100, 100), (1.5,) * 3), ("water",), ENERGY_KEV)
    stated, about = StatedObject(scene, ObjectUncertainty(), MU_WATER), {"edge_blur": 0.0}
    change = stated.errors(fine, 2, about=about).edges.at(IN_PLACE)["finer_edges"]

    def lines(fitted):
        return Chain(fitted, fine, samples=4).state({}).line_integrals()

    smaller, exact, larger = (
        lines(ShapesScene([cylinder("water", (0, 0, 0), one)], ENERGY_KEV)) for one in radius + np.array([-0.1, 0, 0.1])
    )
    at_edge = np.abs(change).mean(axis=(0, 1)) > 1e-3
    slope, left = (larger - smaller)[..., at_edge].ravel(), (lines(stated.with_surfaces(about)) + change - exact)
    left = left[..., at_edge].ravel()
    left -= (left @ slope) / (slope @ slope) * slope
    assert np.sqrt((left**2).mean()) < 0.003 < 0.25 * np.sqrt((change[..., at_edge] ** 2).mean())


def test_object_errors_of_opaque_metal_are_finite():
    grid = Grid((2, 61, 61), (6.0, 3.0, 3.0))
    _, y, x = grid.axes_mm()
    distance = np.hypot(x, y[:, None])
    lead = Mixture("lead", 11.35, "Pb")
    inside = np.stack([(distance < 80) & (distance >= 15), distance < 15]).astype(np.float32)
    shares = np.broadcast_to(inside[:, None], (2, *grid.shape)).copy()
    voxels = VoxelScene(shares, grid, ("water", lead), ENERGY_KEV, 1)
    rods = ShapesScene([cylinder("water", (0, 0, 0), 80), cylinder(lead, (0, 0, 0), 15)])
    about = {"surface_of_water": 0.1}
    for scene in (voxels, rods):
        errors = StatedObject(scene, ObjectUncertainty(), MU_WATER).errors(GEOMETRY, 2, about=about)
        assert all(np.isfinite(values).all() for values in (errors.changes, errors.constant, errors.left))


def test_every_material_of_a_label_map_has_errors_once():
    grid = Grid((1, 60, 60), (2.0, 2.0, 2.0))
    shares = np.zeros((2, *grid.shape), np.float32)
    shares[0] = 1.0
    shares[1, 0, 20:28, 20:28] = shares[1, 0, 20:28, 29:37] = 1.0  # a gap of one voxel
    shares[0] -= shares[1]
    scene = VoxelScene(shares, grid, ("water", "bone"), ENERGY_KEV, 1)
    parts = labelled_parts(scene, 12)
    bone = sum(part.share for name, part in parts.items() if name.startswith("bone"))
    assert len(parts) == 3 and bone == pytest.approx(shares[1])
    thin = shares * 0.4
    assert set(labelled_parts(VoxelScene(thin, grid, ("water", "bone"), ENERGY_KEV, 1), 12)) >= {"water", "bone"}


def test_inserts_of_a_single_slice_have_surfaces():
    side = (np.arange(80) - 39.5) * 2
    hu = np.full((1, 80, 80), -1000.0, np.float32)
    hu[0][np.hypot(side, side[:, None]) < 60] = 0
    hu[0][np.hypot(side - 20, side[:, None]) < 9] = 100
    assert set(growth_of_parts(hu, (2.0, 2.0, 2.0))) == {"body", "dense part 1"}
