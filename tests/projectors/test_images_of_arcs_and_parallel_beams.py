"""Images from curved detectors, flying focal spots and parallel beams: HU, contrast and sharpness of known objects."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical, parallel_beam, scan_geometry
from virtual_phantom.base.settings import ScanSettings, from_mapping
from virtual_phantom.config.config import inspect_config, read_study
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import DISC_ENERGY_KEV
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction.fbp import fbp
from virtual_phantom.reconstruction.sirt import sirt
from virtual_phantom.recordings.scan import check_lengths, missing_for_geometry
from virtual_phantom.recordings.scan import scan_geometry as recorded_geometry

ROOT = Path(__file__).resolve().parents[2]
WATER = float(attenuation_per_mm("water", [DISC_ENERGY_KEV])[0])
# Position x, y, mm. At the aluminum, rotation from view to view causes no blur.
RODS = {"pmma": (35.0, 10.0), "polyethylene": (-20.0, -30.0), "aluminium": (4.0, -3.0)}
ROD_MM, BODY_MM = 9.0, 70.0
SCANNER = dict(source_to_isocentre_mm=541.0, source_to_detector_mm=949.0, rows=4, row_pitch_mm=2.0)
HELIX = dict(
    views=960, volume_height_mm=3.0, turns=2.0, columns=320, column_pitch_mm=0.9, column_offset_px=0.25, **SCANNER
)
IN_PLANE = ((-0.3, 0.0, 0.0), (0.3, 0.0, 0.0))  # by a quarter of a pixel at the isocenter: rays interleave
ALONG_Z = ((0.0, 3.0, -0.6), (0.0, -3.0, 0.6))
SCANS = {
    "flat": helical(**HELIX),
    "arc": helical(surface="cylindrical", **HELIX),
    "spot in the plane": helical(surface="cylindrical", spots_mm=np.array(IN_PLANE), **HELIX),
    "spot along z": helical(surface="cylindrical", spots_mm=np.array(ALONG_Z), **HELIX),
    "parallel": circular(
        views=540,
        turns=0.5,
        columns=320,
        column_pitch_mm=0.9 * 541 / 949,
        column_offset_px=0.25,
        rows=2,
        row_pitch_mm=2.0,
        **parallel_beam(),
    ),
}


@pytest.fixture(scope="module")
def lines():
    """Line integrals [lane, view, row, column] of water with rods, by name of the scan."""
    body = [cylinder("water", (0, 0, 0), BODY_MM), *(cylinder(name, (*at, 0), ROD_MM) for name, at in RODS.items())]
    scene = ShapesScene(body)
    return {
        name: Chain(scene, one, 1e5, samples=2).state({}).line_integrals()[None].astype(np.float32)
        for name, one in SCANS.items()
    }


def around(x, y, half_mm, spacing, geometry, stack):
    """HU on a plane of voxels around a position, and their distances from it."""
    n = 2 * round(half_mm / spacing) + 1
    grid = Grid((1, n, n), (1.0, spacing, spacing))
    image = fbp(CpuProjector(geometry, grid, centre_mm=(x, y, 0.0)), stack)[0, 0]
    along = (np.arange(n) - n // 2) * spacing
    return 1000 * (image / WATER - 1), np.hypot(along, along[:, None])


@pytest.mark.parametrize("name", SCANS)
def test_water_is_0_hu_and_rods_have_the_contrast_of_their_material(name, lines):
    hu, away = around(-35.0, 25.0, 12.0, 0.5, SCANS[name], lines[name])
    assert hu[away < 10].mean() == pytest.approx(0, abs=1)
    for material, (x, y) in RODS.items():
        hu, away = around(x, y, 6.0, 0.5, SCANS[name], lines[name])
        expected = 1000 * (float(attenuation_per_mm(material, [DISC_ENERGY_KEV])[0]) / WATER - 1)
        assert hu[away < 6].mean() == pytest.approx(expected, rel=0.01, abs=1), material


def mtf50_per_cm(name, lines):
    """Frequency at which the spectrum of a rod's edge falls to one half, over all directions."""
    x, y = RODS["aluminium"]
    hu, away = around(x, y, 13.0, 0.25, SCANS[name], lines[name])
    step, reach = 0.1, 3.5
    bins = np.round((away.ravel() - ROD_MM) / step).astype(int)
    edge = np.array(
        [hu.ravel()[bins == place].mean() for place in range(-round(reach / step), round(reach / step) + 1)]
    )
    spread = np.diff(edge) * np.hanning(len(edge) - 1)
    per_mm = np.linspace(0, 1.5, 600)
    place = (np.arange(len(spread)) - (len(spread) - 1) / 2) * step
    mtf = np.abs(np.exp(-2j * np.pi * per_mm[:, None] * place) @ spread)
    return 10 * per_mm[np.argmax(mtf < mtf[0] / 2)]


@pytest.fixture(scope="module")
def sharpness(lines):
    return cache(lambda name: mtf50_per_cm(name, lines))


@pytest.mark.parametrize(("name", "error"), [("arc", 0.03), ("parallel", 0.03), ("spot along z", 0.06)])
def test_images_are_as_sharp_as_those_of_a_flat_detector(name, error, sharpness):
    """Slightly less for a spot along z, each of whose positions has half of the views."""
    assert sharpness(name) == pytest.approx(sharpness("flat"), rel=error)


def test_spot_that_flies_in_the_plane_sharpens_images(sharpness):
    """Its rays interleave, so that linear interpolation between them blurs half as much."""
    assert sharpness("spot in the plane") > 1.2 * sharpness("flat")


def test_parallel_rays_have_the_chords_of_a_disc(lines):
    """To 1e-6 of the ray distance, relative to which chords at the disc's edge are short."""
    geometry = replace(SCANS["parallel"], rows=1)
    disc = Chain(ShapesScene([cylinder("water", (0, 0, 0), BODY_MM)]), geometry, 1e5).state({}).line_integrals()
    expected = 2 * np.sqrt(np.maximum(BODY_MM**2 - geometry.column_positions_mm() ** 2, 0)) * WATER
    np.testing.assert_allclose(disc, np.broadcast_to(expected, disc.shape), atol=3e-5 * expected.max())


def test_iterations_of_a_parallel_beam_converge_to_the_object():
    geometry = circular(
        views=90, turns=0.5, columns=64, column_pitch_mm=3.0, rows=4, row_pitch_mm=3.0, **parallel_beam()
    )
    grid = Grid((4, 64, 64), (3.0, 3.0, 3.0))
    scene = ShapesScene([cylinder("water", (0, 0, 0), BODY_MM)])
    stack = Chain(scene, geometry, 1e5, samples=3).state({}).line_integrals()[None].astype(np.float32)
    projector = CpuProjector(geometry, grid)
    found = sirt(projector, stack, iterations=200, solver="chebyshev", terms=50, backprojector="adjoint")
    assert 1000 * found[0, :, 20:44, 20:44].mean() / WATER == pytest.approx(1000, abs=2)


OFFSETS = {"column_offset_px": 0.0, "row_offset_px": 0.0, "start_angle_deg": 0.0, "rotation_time_ms": 500.0}


def study(**changes):
    whole = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text(encoding="utf-8"))
    return whole | {"scan": whole["scan"] | {"beam": "parallel", "trajectory": "circular"}} | changes


def test_study_of_a_parallel_beam_has_no_distances():
    geometry = scan_geometry(read_study(study()).scan, 180, Grid((4, 32, 32), (2.0, 2.0, 2.0)))
    assert geometry.parallel and geometry.magnification == pytest.approx(1)
    # The same for a section without completed defaults, as virtual_phantom.scan accepts it.
    section = defaults_of("scan") | study()["scan"] | {"turns": 1.0, **OFFSETS}
    assert scan_geometry(from_mapping(ScanSettings, section), 180, Grid((4, 8, 8), (2.0,) * 3)).parallel


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"physics": {"bowtie": {}}, "noise": {"model": "physical"}}, "bowtie needs a focal spot"),
        (
            {"scans": {"other": {"detector": "cylindrical"}}},
            "scans.other.beam is parallel; remove scans.other.detector",
        ),
    ],
)
def test_effects_of_the_focal_spot_are_rejected_with_parallel_rays(changes, message):
    whole = study()
    merged = {key: whole.get(key, {}) | value if isinstance(value, dict) else value for key, value in changes.items()}
    lines, _ = inspect_config(whole | merged)
    assert any(message in line for line in lines), lines


def test_recording_of_a_parallel_beam_has_no_distances():
    scan = {
        "trajectory": "circular",
        "beam": "parallel",
        "columns": 64,
        "rows": 2,
        "column_pitch_mm": 2.0,
        "row_pitch_mm": 2.0,
        "views": 90,
        "views_per_rotation": 180,
        "start_angle_deg": 0,
        "direction": 1,
    }
    assert missing_for_geometry(scan) == [] and recorded_geometry(scan, "here").parallel
    del scan["beam"]
    assert missing_for_geometry(scan) == ["source_to_isocentre_mm", "source_to_detector_mm"]
    with pytest.raises(InputError, match="here: scan.source_to_detector_mm has no meaning in a parallel beam"):
        check_lengths(scan | {"beam": "parallel", "source_to_detector_mm": 900.0}, "here")
