"""Forecast of the time of a diagnosis: counted work, and its users."""

import math
import os
import re

import numpy as np
import pytest
from simulated_scans import SCAN
from test_context import context_of, recorded

from benchmarks.diagnosis_rates import CASES
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.diagnosis.settings import RecordingSettings
from virtual_phantom.diagnosis.workload import MOST_FITTED
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.effect import load
from virtual_phantom.physics.scenes.sampling import sources
from virtual_phantom.physics.state import State
from virtual_phantom.study.costs import forecast
from virtual_phantom.study.costs.diagnoses import (
    EVALUATIONS,
    RATES_OFF,
    RAYS_PER_PIXEL,
    ROUNDS,
    SHARED,
    STAGE,
    UNITS,
    Extent,
    extent,
    points_of_source,
    rays_text,
)
from virtual_phantom.study.costs.forecast import forecast_line
from virtual_phantom.study.costs.limits import FLOORS, SLOWER_NODE
from virtual_phantom.study.costs.rates import read_rates
from virtual_phantom.study.costs.table import diagnoses_text
from virtual_phantom.study.progress.status import duration_range

RATES = read_rates(RESOURCES / "rates.yaml")
CONE = SCAN | {"rows": 16, "columns": 128, "views": 180, "column_pitch_mm": 4.0, "row_pitch_mm": 4.0}
SETTINGS = {"samples": 2, "view_step": None, "check_setup": True}
PHANTOM = ([96, 256, 240], 2)  # voxels along z, y and x, and materials


def counted(shape=(180, 16, 128), effects=27, **settings):
    return extent(from_mapping(RecordingSettings, SETTINGS | settings), shape, effects, PHANTOM)


def diagnosed(folder, **recordings):
    """Context of recordings of projections, {name: (changes of the scan, settings of the diagnosis)}."""
    places = {name: recorded(folder, name, "projections", scan=CONE | scan) for name, (scan, _) in recordings.items()}
    settings = {name: settings for name, (_, settings) in recordings.items()}
    return context_of(results_dir=f"{folder}/r", recordings=places, diagnosis={"recordings": settings})


def seconds_of(context, name, cores):
    (found,) = (forecast for forecast in context.diagnosis.forecasts(cores) if forecast["name"] == name)
    assert found["processes"] == cores
    return found["seconds"]


def drawn(path, *shape):
    write_nifti(Volume(np.ones(shape, np.uint8), Grid(shape, (1.0, 1.0, 1.0))), path)
    return str(path)


def test_rays_are_those_of_the_fitted_views():
    assert counted().rays == 180 * 16 * 128 * 2**2 and counted().pixels == 180 * 16 * 128
    assert counted(view_step=7).rays == math.ceil(180 / 7) * 16 * 128 * 4
    assert counted((60, 16, 128), samples=3).rays == 60 * 16 * 128 * 9
    # In a fan beam, all rays of a pixel are in its plane.
    assert counted((180, 1, 512)).rays == 180 * 512 * 2
    assert counted((984, 64, 888), samples=1).rays <= MOST_FITTED


@pytest.mark.parametrize(
    "physics",
    [
        {},
        {"focal_spot": {"width_mm": 1.0, "length_mm": 0.8}},
        {"off_focal_radiation": {"share": 0.05, "width_mm": 20.0, "collimator_mm": 200.0}},
        {"focal_spot": {"width_mm": 1.0, "length_mm": 0.8}, "view_blur": {"duty": 0.5}},
    ],
    ids=" and ".join,
)
@pytest.mark.parametrize("rows", [1, 8])
def test_every_point_of_a_declared_source_has_its_own_rays(physics, rows):
    """As in the chain, if no blur is wider than two pixels."""
    scan = {"source_to_isocentre_mm": 570.0, "source_to_detector_mm": 1040.0, "view_interval_ms": 1.0}
    geometry = circular(views=720, columns=32, rows=rows, column_pitch_mm=12.0, row_pitch_mm=12.0, **scan)
    state = State(geometry, 1e5)
    for name, values in physics.items():
        load(name).apply(state, values)
    assert points_of_source(physics) == len(list(sources(state)))
    rays = counted((720, rows, 32), baseline=dict.fromkeys(physics, {})).rays
    assert rays == points_of_source(physics) * counted((720, rows, 32)).rays


def test_planes_are_those_that_a_ray_crosses(tmp_path):
    assert counted().planes == 256 * 2
    assert counted(disc={"diameter_mm": 70, "material": "pmma"}).planes == 0
    assert counted(object={"kind": "step_wedge", "parameters": {}}).planes == 5
    mask = drawn(tmp_path / "mask.nii.gz", 1, 40, 60)
    assert counted(object={"mask": mask, "material": "pmma"}).planes == 60
    materials = {"1": "pmma", "2": "bone", "3": "water"}
    assert counted(object={"labels": mask, "materials": materials}).planes == 3 * 60


def test_work_depends_on_simulations_and_rankings():
    pixels, rays, planes = 180 * 16 * 128, 180 * 16 * 128 * 4, 512
    points = pixels + rays / RAYS_PER_PIXEL
    assert counted().work(1000, 3, compiled=True) == {
        "job": 1,
        "compiled": 1,
        "plane": planes,
        "point": points,
        "filter_point": points * 27 * 3,
        "filter_step": rays * 27 * 3 * planes,
        "evaluation": 1000,
        "evaluation_point": points * 1000,
    }
    few = counted(effects=2, check_setup=False).work(10, 1)
    assert set(few) == set(UNITS) and few["plane"] == few["compiled"] == 0 and few["filter_point"] == 2 * points


def test_forecast_ranges_from_few_scans_and_rounds_to_many():
    """One rate at a time, so that both ends have a closed form."""
    points = counted().work(1, 1)["point"]

    def forecast(unit, processes=1):
        found = counted().forecast({"seconds": {STAGE: {unit: 2.0}}}, processes)
        return found.cpu, found.wall

    assert forecast("job") == ((2 / RATES_OFF, 2 * RATES_OFF),) * 2
    assert forecast("compiled")[0] == (0, 2 * RATES_OFF)  # kernels may be cached
    cpu, wall = forecast("evaluation_point", 4)
    low, high = (2 * points * count for count in EVALUATIONS)
    assert cpu == pytest.approx((low / RATES_OFF, high * RATES_OFF))
    assert wall == pytest.approx((cpu[0] / 4, cpu[1] / 2.5))  # half of the processes are idle at worst
    assert forecast("filter_point")[0] == pytest.approx(
        [2 * points * 27 * k for k in (ROUNDS[0] / RATES_OFF, ROUNDS[1] * RATES_OFF)]
    )
    assert forecast("point", 4)[1] == forecast("point")[1] and not {"job", "plane", "point"} & set(SHARED)
    assert counted().forecast({"seconds": {}}) is None


# Recordings and the CPU seconds of their diagnosis with one or two processes on a loaded machine. Kernels were partly
# cached. The first is a real disc (docs/validation/real-discs.md); skimage's Radon transform scanned the others.
DISC = {"disc": {"diameter_mm": 70, "material": "pmma"}}
TAKEN = [
    ((721, 1, 560), DISC | {"samples": 1, "view_step": 15}, 6, (39.8, 46.5)),
    ((721, 1, 560), DISC | {"samples": 1, "view_step": 5}, 6, (65.1,)),
    ((360, 1, 256), DISC | {"samples": None}, 4, (54.7, 41.1, 35.0)),
]


@pytest.mark.parametrize("shape, settings, effects, taken", TAKEN)
def test_real_diagnoses_took_the_forecast_time(shape, settings, effects, taken):
    low, high = counted(shape, effects, **settings).forecast(RATES).cpu
    assert all(low < seconds < high for seconds in taken), (low, high)


def test_diagnoses_of_simulated_recordings_took_the_forecast_time():
    """The recordings behind the rates, and three others; their sizes are in benchmarks/diagnosis_rates.py."""
    seconds, inside, off = RATES["measured"]["diagnoses"]["seconds"], 0, []
    named = [case for case in CASES if case.name in seconds]
    for case in named:
        phantom = ([48, case.across, case.across], 2)
        settings = case.scanned if "mask" not in case.scanned.get("object", {}) else {}
        if settings != case.scanned:
            phantom = ([1, case.across, case.across], 1)
        shape = (case.views, case.rows, case.columns)
        described = from_mapping(RecordingSettings, SETTINGS | settings | {"samples": None})
        one = extent(described, shape, len(case.effects) or 27, phantom)
        low, high = one.forecast(RATES).cpu
        inside += low <= seconds[case.name] <= high
        off.append(max(low / seconds[case.name], seconds[case.name] / high))
    assert len(named) >= 12 and inside >= 5 / 6 * len(named) and max(off) < 2


def test_plan_lists_the_known_work_of_each_diagnosis(tmp_path):
    disc = {"disc": {"diameter_mm": 70, "material": "pmma"}}
    context = diagnosed(
        tmp_path,
        bench=({}, {"effects": ["scatter", "heel", "motion"]}),
        disc=({"rows": 1}, disc),
        again=({"rows": 1}, disc | {"physics_from": "disc"}),
        missing=({}, {"object": {"kind": "pmma_disc"}}),
    )
    forecasts = {forecast["name"]: forecast for forecast in context.diagnosis.forecasts(4)}
    rays = 180 * 16 * 128 * 4
    bench = Extent(
        rays // 4, rays, 2 * 256, 3, True
    )  # the study's phantom is drawn with half the voxel size of its images
    assert context.diagnosis.extent("bench") == bench
    assert forecasts["bench"] == {
        "name": "bench",
        "effects": 3,
        "processes": 3,
        "rays": rays,
        "seconds": list(bench.forecast(context.rates, 3).wall),
        "cpu_seconds": list(bench.forecast(context.rates, 3).cpu),
    }
    assert forecasts["again"] == {"name": "again", "effects": 0, "processes": 1, "seconds": None}
    lines = diagnoses_text([*forecasts.values(), {"name": "scanner", "seconds": None}]).splitlines()
    assert lines[0] == "" and "processes" in lines[1] and len(lines) == 7
    assert re.fullmatch(rf"bench +3 +1.5 million rays +3 +{duration_range(*forecasts['bench']['seconds'])}", lines[2])
    assert re.fullmatch("again +0 +1 +unknown", lines[4]) and re.fullmatch("scanner +unknown", lines[6])
    assert diagnoses_text([]) == ""


@pytest.mark.parametrize("load", [1.0, 3.0])
def test_job_and_plan_state_the_same_forecast(tmp_path, monkeypatch, load):
    """The job reads the phantom's file, the plan the configuration. The time is longer with other load."""
    monkeypatch.setattr(forecast, "slowdown", lambda cores: load)
    context = diagnosed(tmp_path, bench=({}, {"check_setup": False}))
    fine = drawn(tmp_path / "fine.nii", 2, 256, 200)
    planned = context.diagnosis.forecasts(2)[0]
    model, shape = context.diagnosis.model("bench"), (180, 16, 128)
    line = forecast_line("bench", model, shape, planned["effects"], 2, fine)
    time, effects = duration_range(*(load * seconds for seconds in planned["seconds"])), planned["effects"]
    cpu = duration_range(*planned["cpu_seconds"])
    assert line == (
        f"diagnosis of bench: {time} with 2 processes (CPU time {cpu}; {effects} effects, 1.5 million rays)"
    )
    one = forecast_line("bench", model, shape, 1, 1, fine)
    assert " with 1 process (CPU time " in one and one.endswith("; 1 effect, 1.5 million rays)")
    assert forecast_line("bench", model, shape, 0, 1, fine) is None
    os.remove(fine)  # stated by the job itself
    assert forecast_line("bench", model, shape, 3, 1, fine) is None


def test_more_cores_take_less_time_and_the_console_gets_core_seconds(tmp_path):
    context = diagnosed(tmp_path, bench=({}, {}))
    one, two = (seconds_of(context, "bench", cores) for cores in (1, 2))
    assert all(single / 2 < double < single for single, double in zip(one, two, strict=True))
    document = f"{tmp_path}/r/diagnosis/bench/diagnosis.json"
    assert context.expected_seconds(2)[document] == pytest.approx([2 * end for end in two])
    assert context.expected_seconds(1)[document] == pytest.approx(one)


def test_cluster_jobs_request_more_than_the_forecast(tmp_path):
    """In whole minutes and at least the minimum; an hour per round of fits without a forecast."""
    context = diagnosed(
        tmp_path,
        small=({"rows": 1}, {"disc": {"diameter_mm": 70, "material": "pmma"}}),
        large=({"views": 4000, "views_per_rotation": 4000}, {"view_step": 1, "samples": 6}),
        again=({}, {"physics_from": "large"}),
    )
    diagnosis = context.diagnosis
    assert diagnosis.minutes("small", 2) == FLOORS[STAGE]
    expected = seconds_of(context, "large", 2)[1] / 60
    assert SLOWER_NODE * expected <= diagnosis.minutes("large", 2) < SLOWER_NODE * expected + 1
    assert diagnosis.minutes("again", 1) == 60 * 4


def test_rays_are_printed_with_two_digits():
    assert [rays_text(count) for count in (46_080, 412_345, 12_345_678)] == [
        "46 thousand rays",
        "0.41 million rays",
        "12 million rays",
    ]
