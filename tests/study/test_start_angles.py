"""Repeats with their own start angle: which projections are planned, what they are, and how they are reconstructed."""

import copy
import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from virtual_phantom.base.geometry import Grid, scan_geometry
from virtual_phantom.base.settings import FbpSettings, ImageSettings, ScanSettings, SirtSettings, from_mapping
from virtual_phantom.base.streams import random_start_angle_deg
from virtual_phantom.config.config import read_study
from virtual_phantom.config.plan import GeometrySettings, Plan
from virtual_phantom.io.exchange import read_line_integrals
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.phantom import synthetic, write_phantom
from virtual_phantom.study.acquisitions import Acquisitions
from virtual_phantom.study.costs.jobs import study_jobs

ROOT = Path(__file__).resolve().parents[2]
GRID = Grid((6, 24, 24), (4.0, 4.0, 4.0))
MU = 0.0193
ANGLES_DEG = {0: 0.0, 1: 37.0, 2: 200.0}  # by seed
SCAN = {"trajectory": "circular", "columns": 50, "rows": 12, "column_pitch_mm": 5.0, "row_pitch_mm": 6.0}
SCAN |= {"source_to_isocentre_mm": 500, "source_to_detector_mm": 1000}
GEOMETRY = GeometrySettings(from_mapping(ScanSettings, defaults_of("scan") | SCAN), 60, {})
ROIS = {"bright": (100, -18), "dark": (50, 18)}  # HU, x in mm
LAYOUT = {
    "tissues": {"body": {"hu": 0}, **{name: {"hu": hu} for name, (hu, _) in ROIS.items()}},
    "shapes": [{"kind": "column", "tissue": "body", "centre_mm": [0, 0], "semi_axes_mm": [40, 30]}],
    "rois": [
        {"name": name, "tissue_class": name, "tissue": name, "centre_mm": [x, 0, 0], "margin_mm": 2}
        | {"width_mm": 20, "height_mm": 20, "volume_mm3": 4188.79}
        for name, (_, x) in ROIS.items()
    ],
}


def script(name):
    """`main` of a script of the workflow."""
    spec = importlib.util.spec_from_file_location(f"script_{name}", ROOT / "workflow" / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


# ---- plan ----------------------------------------------------------------------------------------


def plan(**repeats):
    config = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text())
    config |= {"repeats": repeats, "analyses": {"stability": {"noise": "dose10"}}}
    config["noise"]["levels"] = {"dose10": {"A": 1e-6, "repeats": 3}}
    config["protocols"] = {name: config["protocols"][name] for name in ("sirt_150", "fbp_150")}
    return Plan(read_study(config))


def projected(chosen):
    """Files of the projection jobs of a plan, sorted."""
    jobs = study_jobs(chosen, "cpu", 6)
    return sorted(path for job in jobs if job.rule == "project" for path in job.outputs)


def test_every_repeat_has_its_own_projections():
    assert projected(plan()) == ["projections/views150/clean.h5"]
    own = [f"projections/views150/clean_angle{seed}.h5" for seed in ("00", "01", "02")]
    assert projected(plan(start_angle="random")) == own
    moved = "projections/views150/clean_seed02.h5"
    assert projected(plan(start_angle="random", repositioned=1, shift_mm=1.0)) == [*own[:2], moved]
    assert projected(plan(repositioned=1, shift_mm=1.0)) == ["projections/views150/clean.h5", moved]


def test_start_angle_of_a_repeat_depends_on_both_seeds_only():
    angles = [random_start_angle_deg(2022, seed) for seed in range(100)]
    assert angles[3] == random_start_angle_deg(2022, 3) != random_start_angle_deg(2023, 3)
    assert len(set(angles)) == 100 and min(angles) >= 0 and max(angles) < 360
    assert np.histogram(angles, 4, (0, 360))[0].min() > 10
    fixed, random = (Acquisitions(plan(start_angle=choice), None) for choice in ("fixed", "random"))
    assert [one.start_angle_deg("01") for one in (fixed, random)] == [0.0, angles[1]]


# ---- projections and images ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Folder with a phantom of two balls, and its projections for each of ANGLES_DEG."""
    folder = tmp_path_factory.mktemp("angles")
    write_phantom(synthetic.build(copy.deepcopy(LAYOUT), GRID, 1, np.random.SeedSequence(1)), folder)
    for seed, angle in ANGLES_DEG.items():
        script("project")(
            phantom_file=f"{folder}/fine.nii.gz",
            image_file=f"{folder}/image.nii.gz",
            rois_file=f"{folder}/rois.csv",
            physics_files=[],
            output=f"{folder}/{seed}.h5",
            geometry_settings=GEOMETRY,
            mu_water_per_mm=MU,
            materials=defaults_of("materials"),
            sensor=defaults_of("sensor"),
            pose_settings=None,
            start_angle_deg=angle,
            threads=1,
        )
    return folder


def test_start_angle_turns_the_scan(scans):
    expected = scan_geometry(GEOMETRY.scan, GEOMETRY.projections, GRID)
    for seed, angle in ANGLES_DEG.items():
        _, geometry = read_line_integrals(scans / f"{seed}.h5")
        turned = expected.turned(np.deg2rad(angle))
        assert geometry.angles_rad == pytest.approx(turned.angles_rad, abs=1e-6)
        assert replace(geometry, angles_rad=turned.angles_rad).views == expected.views


def test_projections_of_a_start_angle_are_those_of_later_views(scans):
    """200 degrees are 33.33 views of 6 degrees: view 33 of the first scan is two degrees before view 0 of the other."""
    (first, _), (last, _) = (read_line_integrals(scans / f"{seed}.h5") for seed in (0, 2))
    between = (2 * np.roll(first, -33, axis=0) + np.roll(first, -34, axis=0)) / 3
    far = np.abs(first - last).mean()
    assert np.abs(between - last).mean() < 0.1 * far


@pytest.mark.parametrize("algorithm", ["sirt", "fbp"])
def test_repeats_of_one_job_are_reconstructed_with_their_own_start_angle(scans, algorithm):
    """Two seeds per job with different angles give the images of two with the same."""
    sirt = SirtSettings(**defaults_of("reconstruction", "sirt") | {"iterations": 60, "terms": 20})
    settings = {"sirt": sirt, "fbp": FbpSettings("coverage")}[algorithm]
    masks = {name: read_nifti(scans / "rois" / f"{name}.nii.gz").array > 0 for name in ROIS}

    def means(*seeds):
        outputs = [f"{scans}/{algorithm}_{lane}.nii.gz" for lane in range(len(seeds))]
        script("reconstruct")(
            phantom_file=f"{scans}/image.nii.gz",
            clean_files=[f"{scans}/{seed}.h5" for seed in seeds],
            levels=[],
            roi_files=[],
            physics_files=[],
            outputs=outputs,
            images=[ImageSettings(algorithm, algorithm, settings, {})],
            geometry_name="views60",
            acquisitions=[{"noise": "low", "noise_level": 1e-8, "seed": lane} for lane in range(len(seeds))],
            engine="cpu",
            noise={"model": "astra", "draws": "independent", "study_seed": 1},
            mu_water_per_mm=MU,
            zero_counts_as=0.5,
            threads=1,
        )
        images = [read_nifti(path).array for path in outputs]
        return np.array([[image[mask].mean() for mask in masks.values()] for image in images])

    fixed = means(0, 0)
    assert fixed == pytest.approx(np.array([[hu for hu, _ in ROIS.values()]] * 2), abs=15)
    assert means(1, 2) == pytest.approx(fixed, abs=3)
    assert means(2, 0, 2) == pytest.approx(np.vstack([fixed, fixed[:1]]), abs=3)
