"""Fit the rates by which `snakemake plan` estimates the time of a diagnosis (30 minutes).

The library's chain simulates recordings of several sizes. Each is diagnosed by one process in a new Python process, and
the rates are fitted to the CPU time of its parts. Prints the forecasts, also of recordings that are held out. Writes
the stage `diagnose` of the library's rates.yaml if --machine is given.
"""

import argparse
import json
import os
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks import THREAD_VARIABLES, common
from benchmarks.fit_rates import RATES, fit_parts, write
from virtual_phantom.api.simulated import draw_phantom
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.settings import MaterialSettings, from_mapping, to_mapping
from virtual_phantom.base.streams import Branch
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume
from virtual_phantom.diagnosis.preparation import compare_images, prepare_recording
from virtual_phantom.diagnosis.projections.model import ScansModel
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.scanned_object import scene_of
from virtual_phantom.diagnosis.selection.progress import FITTED, RANKED, DiagnosisProgress
from virtual_phantom.diagnosis.settings import FitSettings, RecordingSettings
from virtual_phantom.diagnosis.setup.check import check_setup
from virtual_phantom.diagnosis.workload import SAMPLES
from virtual_phantom.io.exchange import write_line_integrals
from virtual_phantom.io.schema import defaults_of, fill_defaults, schema_of
from virtual_phantom.io.volumes import Volume, shape_of, write_nifti
from virtual_phantom.phantom import write_phantom
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import checked
from virtual_phantom.recordings.importers.study import scan_section
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.report.diagnosis import diagnosis_page, residual_maps
from virtual_phantom.study.costs.diagnoses import STAGE, Extent, extent, material_count
from virtual_phantom.study.costs.rates import read_rates
from virtual_phantom.study.progress.status import duration_range

PHOTONS, REPEATS = 1e5, 4
WIDE_MM, HIGH_MM = 512.0, 128.0  # detector; a single row has the height of eight
ACROSS_MM, SLICES = 300.0, 24  # the phantom
HOLES = (((30, 10), 15), ((-35, -20), 10))  # holes of the masked object: center and radius, mm
# Parts of a diagnosis and their units of work.
START, COMPILED, CHECK, ALONE = "start", "compiled", "check", "alone"
PARTS = {
    START: ("job",),
    COMPILED: ("compiled",),
    CHECK: ("plane",),
    ALONE: ("point",),
    RANKED: ("filter_point", "filter_step"),
    FITTED: ("evaluation", "evaluation_point"),
}
COMPILED_SECONDS = 16.0  # additional CPU time with an empty cache of kernels
SEED = 20261124


@dataclass(frozen=True)
class Case:
    """A recording: object, size and missing effects."""

    name: str
    columns: int
    rows: int
    views: int
    lacks: tuple = ()
    across: int = 0  # voxels of the phantom or of the mask
    scanned: dict = field(default_factory=dict)
    effects: tuple = ()  # candidates; empty: all
    held_out: bool = False
    repeats: int = REPEATS


PHANTOM, MASK = {}, {"object": {"mask": "mask.nii.gz", "material": "pmma"}}
DISC = {"disc": {"diameter_mm": 150, "material": "pmma"}, "alignment": {"scale": 1, "size": 0.01}}
SHAPES = {"object": {"kind": "catphan504_ctp404"}}
FEW = ("scatter", "detector_offset", "focal_spot", "dark_signal", "heel", "motion", "electronic_noise", "veiling_glare")
CASES = (
    Case("nothing", 64, 8, 90, (), 128),
    Case("scatter", 64, 8, 90, ("scatter",), 128),
    Case("spectrum", 96, 8, 90, ("spectrum",), 128),
    Case("offset", 64, 8, 120, ("detector_offset",), 256),
    Case("large", 128, 12, 120, ("focal_spot",), 128),
    Case("few", 96, 8, 120, ("scatter",), 128, effects=FEW),
    Case("disc", 512, 1, 180, ("scatter",), scanned=DISC),
    Case("mask", 256, 1, 180, ("spectrum",), 256, scanned=MASK),
    Case("shapes", 64, 8, 90, ("scatter",), scanned=SHAPES),
    Case("held_nothing", 96, 12, 150, (), 192, held_out=True),
    Case("held_motion", 96, 8, 120, ("motion",), 160, held_out=True),
    Case("held_disc", 256, 1, 180, ("veiling_glare",), scanned=DISC, held_out=True),
    Case("two", 64, 8, 90, ("scatter", "focal_spot"), 128),
    Case("held_three", 96, 8, 90, ("spectrum", "veiling_glare", "detector_offset"), 128, held_out=True),
    Case("held_shapes", 96, 8, 120, ("heel",), scanned=SHAPES, held_out=True),
)


def geometry_of(case):
    pitches = WIDE_MM / case.columns, HIGH_MM / max(case.rows, 8)
    return common.circular_scan(case.views, case.columns, case.rows, *pitches, view_interval_ms=900 / case.views)


def written(case, folder):
    """Write a recording with its object and the input of its job."""
    folder.mkdir()
    section, inputs = dict(case.scanned), {}
    if case.scanned == PHANTOM:
        half = case.across // 2  # drawn with twice as many voxels
        write_phantom(draw_phantom((SLICES, half, half), (4.0, ACROSS_MM / half, ACROSS_MM / half)), folder)
        inputs = {"phantom": folder / "fine.nii.gz", "image": folder / "image.nii.gz", "rois": folder / "rois.csv"}
    elif case.scanned == MASK:
        inputs = {"mask": folder / "mask.nii.gz"}
        write_nifti(masked(case.across), inputs["mask"])
        section["object"] = section["object"] | {"mask": str(inputs["mask"])}
    schema = schema_of("diagnosis", "recordings")["additionalProperties"] | {"$defs": schema_of()["$defs"]}
    fill_defaults(section, schema)
    settings, study = from_mapping(RecordingSettings, section).in_fits, defaults_of()
    materials = MaterialSettings(**study["materials"])
    model = FitSettings(str(folder), settings, study["mu_water_per_mm"], materials, study["seed"], protocol=None)
    inputs = {key: str(path) for key, path in inputs.items()}
    geometry, random = geometry_of(case), np.random.default_rng(np.random.SeedSequence(SEED))
    scene = scene_of(DiagnosisRequest.of(model, inputs.get("phantom"), 1))
    chain = Chain(scene, geometry, PHOTONS, samples=(settings.samples or SAMPLES) + 1)
    state = chain.state(checked(dict.fromkeys(case.lacks, {})))
    air = state.measured_air * state.photons
    files = [f"{number}.h5" for number in range(case.repeats)]
    for file in files:
        lines = -np.log(np.maximum(state.counts(random), 0.5) / air)
        write_line_integrals(folder / file, lines.astype(np.float32), geometry)
    content = {"name": case.name, "kind": "projections", "scan": scan_section(geometry), "repeats": files}
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    tried = list(case.effects) or candidates(settings)
    (folder / "case.json").write_text(json.dumps({"model": to_mapping(model), "given": inputs, "effects": tried}))
    voxels = shape_of(inputs["phantom"]) if "phantom" in inputs else ()
    return extent(settings, geometry.shape, len(tried), (voxels, material_count(materials)))


def masked(across):
    """Ellipse of one material with two holes."""
    grid = Grid((1, across, across), (1.0, 200 / across, 200 / across))
    _, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    share = (x / 80) ** 2 + (y / 70) ** 2 < 1
    for (column, row), radius in HOLES:
        share &= (x - column) ** 2 + (y - row) ** 2 > radius**2
    return Volume(share.astype(np.float32), grid)


def processor_seconds():
    """CPU time of this process and its finished children."""
    return sum(os.times()[:4])


class Timed(DiagnosisProgress):
    """Total time of rankings and fits."""

    def __init__(self, clock):
        super().__init__()
        self.now, self.seconds, self.counts = clock, Counter(), Counter()

    def begin(self, what, count, beside=()):
        self.counts[what] += count
        began, done, left = self.now(), super().begin(what, count, beside), count

        def counted():
            nonlocal left
            done()
            left -= 1
            if not left:
                self.seconds[what] += self.now() - began

        return counted


def counted_scans():
    """List that gets an entry per simulated scan."""
    scans, predict = [], ScansModel.predict

    def counted(*arguments, **options):
        scans.append(1)
        return predict(*arguments, **options)

    ScansModel.predict = counted
    return scans


def diagnose_case(folder, processes):
    """Diagnose as workflow/scripts/diagnose.py does; prints times, counts and named effects."""
    clock, scans = processor_seconds, counted_scans()
    case = json.loads((folder / "case.json").read_text())
    inputs, timed = case["given"], Timed(clock)
    diagnosis_request = DiagnosisRequest.of(from_mapping(FitSettings, case["model"]), inputs.get("phantom"), processes)
    recording = load_recording(folder)
    marks = [clock()]
    assert check_setup(recording, diagnosis_request).kind == "as stated", folder
    marks.append(clock())
    _, prepared = prepare_recording(diagnosis_request, recording)
    found = find_missing_physics(
        folder.name, prepared, case["effects"], defaults_of("diagnosis", "model_accuracy"), processes, None, timed
    )
    study_rois = (inputs["image"], inputs["rois"]) if "phantom" in inputs else None
    scanned = ScannedVolume.of(diagnosis_request, recording, study_rois)
    found.content["agreement"] = compare_images(
        recording, found.prepared, found.choice, diagnosis_request, Branch.AGREEMENT, scanned=scanned, with_changes=True
    )
    marks.append(clock())
    found = replace(found, scanned=scanned)
    diagnosis_page(found, residual_maps(found))
    check, rest = np.diff(marks)
    shared = {part: timed.seconds[part] for part in (RANKED, FITTED)}
    parts = {CHECK: check, ALONE: rest - sum(shared.values())} | shared
    rounds = timed.counts[RANKED] / len(case["effects"])
    named = [effect["name"] for effect in found.content["effects"]]
    print(json.dumps({"parts": parts, "found": named, "scans": len(scans), "rounds": rounds}))


def run_case(folder, processes=1):
    """Diagnose in a new Python; returns CPU time per part, wall time, counts and named effects."""
    began, before = time.perf_counter(), common.child_seconds()[1]
    arguments = "--one", folder, "--processes", processes
    outcome = common.run_scenario("diagnosis_rates", *arguments, **dict.fromkeys(THREAD_VARIABLES, str(processes)))
    spent = common.child_seconds()[1] - before
    parts = outcome["parts"] | {START: spent - sum(outcome["parts"].values())}
    return outcome | {"parts": parts, "wall": time.perf_counter() - began}


@dataclass(frozen=True)
class Run:
    """A diagnosis with its recording, size and the result of `run_case`."""

    case: Case
    extent: Extent
    outcome: dict

    @property
    def seconds(self):
        return sum(self.outcome["parts"].values())

    @property
    def measured(self):
        """Work and seconds per part; kernels count as compiled once."""
        work = self.extent.work(self.outcome["scans"], self.outcome["rounds"], compiled=True)
        return work, self.outcome["parts"] | {COMPILED: COMPILED_SECONDS}


def runs_of(cases):
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            size = written(case, Path(folder) / case.name)
            run_case(Path(folder) / case.name)  # compiles what this kind of object needs
            found.append(Run(case, size, run_case(Path(folder) / case.name)))
            outcome = found[-1].outcome
            words = ", ".join(f"{part} {outcome['parts'][part]:.1f}" for part in PARTS if part in outcome["parts"])
            counts = f"{outcome['scans']} scans, {outcome['rounds']:.1f} rounds"
            print(f"{case.name:20s} {found[-1].seconds:6.1f} s: {words}; {counts}; {outcome['found']}", flush=True)
    return found


def report(runs, rates):
    print(f"{'recording':20s} {'CPU time, s':>12s} {'forecast':>18s}")
    inside, off = 0, []
    for one_run in runs:
        low, high = one_run.extent.forecast({"seconds": {STAGE: rates}}).cpu
        suffix = " held out" if one_run.case.held_out else ""
        print(f"{one_run.case.name:20s} {one_run.seconds:12.1f} {duration_range(low, high):>18s}{suffix}")
        inside += low <= one_run.seconds <= high
        off.append(max(low / one_run.seconds, one_run.seconds / high))
    print(f"{inside} of {len(runs)} within the forecast; the farthest is off by a factor of {max(*off, 1.0):.2f}")


def add_arguments(parser):
    parser.add_argument("--machine", help="description of the machine for rates.yaml; needed to write it")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--processes", type=int, default=1, help=argparse.SUPPRESS)


def run(options):
    if options.one:
        diagnose_case(options.one, options.processes)
        return
    runs = runs_of(CASES)
    fitted = [one_run for one_run in runs if not one_run.case.held_out]
    rates = fit_parts([one_run.measured for one_run in fitted], PARTS)
    print(rates)
    report(runs, rates)
    if options.machine:
        whole = read_rates(RATES)
        whole["seconds"][STAGE] = rates
        whole["measured"]["diagnoses"] = {
            "machine": options.machine,
            "time": "CPU time, one process",
            "recordings": len(fitted),
            "seconds": {one_run.case.name: round(one_run.seconds, 1) for one_run in runs},
            "simulated_scans": {one_run.case.name: one_run.outcome["scans"] for one_run in runs},
        }
        write(whole)
