"""Extensions in one user file each: an effect on projections, an effect on images, and a kind of scene."""

import ast
import importlib.util
import sys
from dataclasses import replace

import numpy as np
import pytest
from simulated_scans import body, chosen, noisy_lines, scans_of

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import FbpSettings, from_mapping
from virtual_phantom.config.dependencies import LIBRARY
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.comparison.regions import complete
from virtual_phantom.diagnosis.images.prepared import prepare as prepare_images
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.diagnosis.uncertainty.model_error import kernel_error
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.diagnosis.verdict.warnings import caveats, doubts
from virtual_phantom.physics import effect, effects
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.reconstruction.images import reconstruct_hu
from virtual_phantom.simulation.reconstruct import apply_image_effects

DRIFT = '''"""Tube output that drifts during the scan."""

from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Let the signal drift over the scan."""
    time = state.geometry.times_s[:, None, None]
    state.signal = state.signal * (1 + values["drift_per_s"] * time)


EFFECT = Effect(
    name="output_drift",
    physics="The tube gives more photons at the end of the scan, and no monitor corrects for it.",
    equation="S' = S (1 + d t)",
    source="a test",
    stage="noise",
    signature="line integrals that change from view to view",
    settled_by="a monitor pixel beside the object",
    parameters=(Parameter("drift_per_s", "1/s", "relative change per second", -0.3, 0.3, 0.0, 0.1),),
    apply=apply,
)
'''
CUPPING = '''"""Images that are darker the nearer to the axis."""

import numpy as np

from ..effect import Effect, Parameter
from ..image_state import ImageState


def apply(state: ImageState, values: dict[str, float]) -> None:
    """Lower the HU towards the axis."""
    y, x = (np.linspace(-1, 1, n) for n in state.hu.shape[-2:])
    state.hu = state.hu - values["depth_hu"] * (1 - np.minimum(1, x**2 + y[:, None] ** 2))


EFFECT = Effect(
    name="cupping",
    physics="The maker's correction of beam hardening leaves a cup.",
    equation="HU' = HU - d (1 - r^2)",
    source="a test",
    stage="image",
    signature="HU that fall towards the axis",
    settled_by="a water cylinder of another size",
    parameters=(Parameter("depth_hu", "HU", "depth on the axis", -100.0, 100.0, 0.0, 20.0),),
    apply=apply,
    rank=2,
)
'''
BALLS = '''"""Balls of one material."""

import numpy as np

from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.scenes.scene import IN_PLACE, turned_back


class Balls:
    """Path lengths through balls that do not overlap, in closed form."""

    threads = 1

    def __init__(self, balls, material):
        self.balls, self.materials, self.energy_kev = balls, (material,), 60.0
        self.attenuation_per_mm = attenuation_per_mm(material, [self.energy_kev])

    def path_lengths(self, geometry, pose=IN_PLACE, motion_mm=None):
        geometry, shift = turned_back(geometry, pose, motion_mm)
        to, rows = geometry.bundles()
        way = np.moveaxis(to, 0, -1)[:, None] + rows[:, None, None] * [0.0, 0.0, 1.0]
        way = way / np.linalg.norm(way, axis=-1, keepdims=True)
        source = (geometry.source_mm - shift)[:, None, None]
        total = 0.0
        for *centre, radius in self.balls:
            off = np.linalg.norm(np.cross(np.array(centre) * pose.size - source, way), axis=-1)
            total = total + 2 * np.sqrt(np.maximum((radius * pose.size) ** 2 - off**2, 0))
        return total.astype(np.float32).reshape(1, *geometry.shape)
'''
LEAKAGE = '''"""Radiation that leaks through the tube's housing, with everything that an effect may declare."""

from ..effect import (
    DARK_LEVEL, HELIX, NEEDS, NOMINAL_PHOTONS, SUCCESSIVE_VIEWS, DIVERGENT_BEAM, TUBE_VOLTAGE, Effect, Parameter
)
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Add a share of the signal in air."""
    state.signal = state.signal + values["share"] * (values["kvp"] / 120) * state.air


EFFECT = Effect(
    name="leakage",
    physics="The housing lets a little radiation through.",
    equation="S' = S + g A",
    source="a test",
    stage="scatter",
    signature="line integrals too low behind the object",
    settled_by="a lead plate",
    parameters=(
        Parameter("share", "1", "share of the signal in air", 0.0, 0.3, 0.01, 0.02, dark=DARK_LEVEL),
        Parameter("kvp", "kV", "voltage of the tube", 20.0, 200.0, 90.0, 110.0, None, nominal=TUBE_VOLTAGE,
                  title="voltage behind the housing"),
        Parameter("width_mm", "mm", "of the leak", 1.0, 90.0, 30.0, 30.0, None, kernel=True, kernel_error=0.7),
    ),
    apply=apply,
    needs=(DIVERGENT_BEAM, NOMINAL_PHOTONS, SUCCESSIVE_VIEWS, HELIX),
    of_one_scan=True,
    removed_by=("dark",),
    correction="housing",
    absolute_attenuation=True,
    if_absent="A tube of {tube_kvp:g} kV leaks, and this one does not.",
)
'''
GEOMETRY = circular(
    views=40,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=50,
    rows=8,
    column_pitch_mm=10.0,
    row_pitch_mm=10.0,
    view_interval_ms=25.0,
)
MU, PHOTONS = 0.0193, 1e5


@pytest.fixture(scope="module")
def scene():
    grid = Grid((14, 48, 48), (4.0, 5.0, 5.0))
    volume = body(grid, (100, 75), 20.0, [((45, 10, None), 18, 800.0), ((-40, -20, None), 16, -80.0)])
    return VoxelScene.of(volume, Segmentation(), MU)


@pytest.fixture
def added(tmp_path):
    """Effects of a user folder, which are removed afterwards."""
    before = list(effects.__path__)
    (tmp_path / "output_drift.py").write_text(DRIFT)
    (tmp_path / "cupping.py").write_text(CUPPING)
    yield effect.add_folder(tmp_path)
    effects.__path__[:] = before
    for name in ("output_drift", "cupping"):
        sys.modules.pop(f"{effects.__name__}.{name}", None)


def test_user_effect_on_projections_is_found(scene, added):
    assert added == ("cupping", "output_drift") and set(added) <= set(effect.names())
    tried = candidates(from_mapping(RecordingSettings, {"nominal_photons": PHOTONS}))
    assert "output_drift" in tried and "cupping" not in tried
    chain = Chain(scene, GEOMETRY, PHOTONS)
    state = chain.state({"output_drift": {"drift_per_s": 0.03}})
    lines = noisy_lines(state, 4, np.random.default_rng(1)).astype(np.float32)
    taken = observed.Scans(lines, state.measured_air.mean(axis=0) * PHOTONS, np.ones(lines[0].shape, bool))
    prepared_data = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)
    found = diagnose(
        "bench", prepared_data, chosen(prepared_data.fitter, ("output_drift", "scatter", "motion"))
    ).content
    (one,) = found["effects"]
    low, high = one["parameters"]["drift_per_s"]["ci95"]
    assert one["name"] == "output_drift" and low < 0.03 < high and found["verdict"] == "mismatch explained"


def test_user_effect_on_images_is_found(scene, added):
    tried = candidates(from_mapping(RecordingSettings, {"nominal_photons": PHOTONS}), "images")
    assert set(added) <= set(tried)
    grid, chain = Grid((6, 40, 40), (5.4, 6.4, 6.4)), Chain(scene, GEOMETRY, PHOTONS)

    def reconstruct(lines):
        return reconstruct_hu(lines.astype(np.float32), GEOMETRY, grid, "fbp", FbpSettings("coverage"), "cpu", MU)

    noisy = reconstruct(noisy_lines(chain.state({}), 4, np.random.default_rng(2)))
    images = np.stack([apply_image_effects(one, grid.spacing, {"cupping": {"depth_hu": 12.0}}) for one in noisy])
    seed, valid = np.random.SeedSequence(3), complete(GEOMETRY, grid)
    prepared_data = prepare_images(
        images, None, chain, chain, reconstruct, grid.spacing, valid, seed, nominal_photons=PHOTONS
    )
    found = diagnose(
        "scanner", prepared_data, chosen(prepared_data.fitter, ("cupping", "hu_calibration", "scatter"))
    ).content
    assert [effect["name"] for effect in found["effects"]][:1] == ["cupping"]
    low, high = found["effects"][0]["parameters"]["depth_hu"]["ci95"]
    assert low - (high - low) / 2 < 12.0 < high + (high - low) / 2


@pytest.fixture
def leaking(tmp_path):
    """An effect with all optional declarations."""
    before = list(effects.__path__)
    (tmp_path / "leakage.py").write_text(LEAKAGE)
    effect.add_folder(tmp_path)
    yield effect.load("leakage")
    effects.__path__[:] = before
    sys.modules.pop(f"{effects.__name__}.leakage", None)


FAVORABLE = {"corrected": ["housing"], "helical": True}


@pytest.mark.parametrize(
    ("settings", "scan", "message"),
    [
        ({}, {}, "leakage is relative to nominal_photons"),
        ({"view_step": 2}, {}, "leakage changes from view to view"),
        ({}, {"helical": False}, "leakage changes along the axis"),
        ({}, {"parallel": True}, "leakage needs a focal spot"),
        ({}, {"corrected": ["housing", "dark"]}, r"leakage was corrected by the scanner's maker \(corrected: dark"),
        ({}, {"corrected": []}, r"leakage models a correction .* state corrected: \[housing\]"),
    ],
)
def test_effect_is_a_candidate_where_its_needs_are_met(leaking, settings, scan, message):
    photons = {"nominal_photons": None if "nominal" in message else PHOTONS}
    stated = from_mapping(RecordingSettings, photons | settings)
    assert "leakage" in candidates(from_mapping(RecordingSettings, {"nominal_photons": PHOTONS}), **FAVORABLE)
    assert "leakage" not in candidates(stated, **FAVORABLE | scan)
    with pytest.raises(InputError, match=message):
        candidates(replace(stated, effects=("leakage",)), **FAVORABLE | scan)


def test_effect_declares_its_priors_and_its_owner(scene, leaking):
    """A declared voltage is a prior of its parameter, the scale is the density, and each scan has its own effect."""
    assert effect.scan_effects().count("leakage") == 1 and "leakage" in effect.effects_needing(effect.DIVERGENT_BEAM)
    assert effect.absolute_attenuation(["leakage"]) and not effect.absolute_attenuation(["scatter"])
    taken = scans_of(Chain(scene, GEOMETRY, PHOTONS).state({}), 4, np.random.default_rng(1))
    fitter = prepared.prepare(taken, None, Chain(scene, GEOMETRY, PHOTONS), tube_kvp=100.0).fitter
    kvp = next(unknown for unknown in fitter.model.unknowns(("leakage",)) if unknown.name == "kvp")
    assert (kvp.expected, kvp.sd, kvp.low, kvp.high, kvp.starts) == (100.0, 1.0, 95.0, 105.0, (100.0,))
    scale, free = (
        next(one for one in fitter.model.nuisances_for(names) if one.name == "scale") for names in (("leakage",), ())
    )
    assert (scale.expected, scale.sd) == (fitter.model.density[0], min(free.sd, fitter.model.density[1]))
    share, _, width = leaking.parameters
    assert [kernel_error(one, 0.1) for one in (share, width)] == [0.0, 0.7]


def test_effect_warns_at_a_bound_and_if_absent(scene, leaking):
    taken = scans_of(Chain(scene, GEOMETRY, PHOTONS).state({}), 4, np.random.default_rng(1))
    prepared_data = prepared.prepare(taken, None, Chain(scene, GEOMETRY, PHOTONS), tube_kvp=100.0)
    choice = chosen(prepared_data.fitter, ("scatter",))
    absent = replace(choice, alone={"leakage": -20.0})
    assert "A tube of 100 kV leaks, and this one does not." in caveats(prepared_data, absent)
    assert caveats(prepared_data, replace(choice, alone={"leakage": 0.0})) == caveats(prepared_data, choice)
    values = {"leakage": {"share": 0.01, "kvp": 105.0, "width_mm": 30.0}}
    errors = {"leakage": dict.fromkeys(values["leakage"], 0.01)}
    fit = replace(choice.chosen.fit, effects=("leakage",), physics=values, errors=errors)
    (doubt,) = doubts(replace(choice, chosen=replace(choice.chosen, fit=fit)), prepared_data.fitter.model, {})
    assert doubt == "voltage behind the housing of leakage is at its upper bound, 105 kV (stated: 100 ± 1)"


SHARED = ("noise", "fitting", "residuals", "uncertainty", "selection", "verdict", "comparison", "planning", "scanner")


def test_core_names_no_effect():
    """Check the shared packages of the diagnosis, and the effects module except its list of stages."""
    core = LIBRARY / "diagnosis"
    paths = [path for package in SHARED for path in (core / package).glob("*.py")] + list(core.glob("*.py"))
    found = [
        f"{path.relative_to(LIBRARY)}:{node.lineno} names {node.value}"
        for path in (*paths, LIBRARY / "physics" / "effect.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in effect.names()
        if path.parent != LIBRARY / "physics" or node.value not in effect.STAGES
    ]
    assert len(paths) > 40 and not found, found


def test_invalid_effect_folder_is_rejected(tmp_path):
    with pytest.raises(InputError, match="holds no effects"):
        effect.add_folder(tmp_path / "missing")
    (tmp_path / "scatter.py").write_text(DRIFT)
    with pytest.raises(InputError, match="there is an effect 'scatter' already"):
        effect.add_folder(tmp_path)
    assert str(tmp_path) not in effects.__path__


def test_kind_of_scene_is_one_file(tmp_path):
    """A scene only has materials, their attenuation, the beam's energy, and path lengths."""
    (tmp_path / "balls_scene.py").write_text(BALLS)
    spec = importlib.util.spec_from_file_location("balls_scene", tmp_path / "balls_scene.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    scene = module.Balls([(30.0, 10.0, 0.0, 25.0), (-40.0, -20.0, 5.0, 20.0)], "pmma")
    chain, _ = model_and_floor(scene, GEOMETRY, 2, photons=PHOTONS)
    state = chain.state({"detector_offset": {"columns_px": 0.05}})
    lines = noisy_lines(state, 4, np.random.default_rng(1)).astype(np.float32)
    taken = observed.Scans(lines, state.measured_air.mean(axis=0) * PHOTONS, np.ones(lines[0].shape, bool))
    prepared_data = prepared.prepare(taken, None, chain, nominal_photons=PHOTONS)
    found = diagnose("bench", prepared_data, chosen(prepared_data.fitter, ("detector_offset", "scatter"))).content
    assert [effect["name"] for effect in found["effects"]] == ["detector_offset"] and found[
        "verdict"
    ] == "mismatch explained"
    low, high = found["effects"][0]["parameters"]["columns_px"]["ci95"]
    assert low < 0.05 < high and high - low < 0.05
