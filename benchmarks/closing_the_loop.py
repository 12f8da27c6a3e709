"""Compare features of a study that has the diagnosed physics, none, or a wrong effect with held-out scans (10 minutes).

XCIST scans a phantom of the blind validation with one strong hidden effect. The scan by SCAN is diagnosed, and the
verdict is written to physics.yaml. The study simulates the protocol HELD_OUT with this file (`physics: {from: ...}`),
without it, and with a wrong effect. The wrong effect fits SCAN best alone, among effects that are neither hidden nor
indistinguishable from the hidden effect. Features are in 2D, from filtered back-projections on the same grid. Measures:

* "error": median over features and regions of |mean of the study's repeats / mean of XCIST's repeats - 1|
* "within": share of the study's means that differ from XCIST's by at most one SD of XCIST's repeats
* "noise" compares two halves of XCIST's repeats.

Finished cases of the output file are not repeated.

Development seed: 1 (four cases).
"""

import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from benchmarks import common
from benchmarks.common import simulator_scans
from benchmarks.common.tuning_objects import OBJECTS
from virtual_phantom.base.settings import FbpSettings, to_mapping
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.comparison.agreement import share_within
from virtual_phantom.diagnosis.comparison.regions import ScannedVolume, complete, image_grid, phantom_regions
from virtual_phantom.diagnosis.comparison.scans import scans
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.features import MINIMUM_VOXELS
from virtual_phantom.features.extraction import extract_repeats
from virtual_phantom.features.names import FEATURES
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.beam.sensors import Sensor
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.report.diagnosis import overlay_of
from virtual_phantom.simulation.acquire import acquire
from virtual_phantom.simulation.project import project_phantom, read_diagnosed_physics
from virtual_phantom.simulation.reconstruct import reconstruct

EFFECTS, STRENGTH = ("scatter", "spectrum", "focal_spot", "optical_crosstalk"), "strong"
PHANTOM = "abdomen"  # the other phantom of the blind validation has too small regions
SCAN = simulator_scans.SCAN | {"columns": 72}
HELD_OUT = SCAN | {"views": 60, "photons": 2e5, "repeats": 10}
OTHER_NOISE = 10_000  # added to the number of a case, for other noise in the held-out scan


def error_of(recorded: np.ndarray, simulated: np.ndarray) -> float:
    """Median over quantities of |mean of simulated repeats / mean of recorded repeats - 1|.

    Parameters
    ----------
    recorded, simulated : ndarray, shape (repeats, quantities)
        Quantities with a recorded mean of 0 do not count.
    """
    theirs, ours = recorded.mean(axis=0), simulated.mean(axis=0)
    there = theirs != 0
    return float(np.median(np.abs(ours[there] / theirs[there] - 1)))


def wrong_effect(diagnosis, hidden: str) -> dict:
    """{effect: parameters} of the effect that fits best alone, among those that cannot be the hidden one."""
    content, choice = diagnosis.content, diagnosis.choice
    groups = [{name, *others} for name, others in content["ambiguous_with"].items()]
    right = set().union({hidden}, *(group for group in groups if hidden in group))
    others = {name: trial for name, trial in choice.singles.items() if name not in right and trial.fit.physics}
    if not others:
        return {}
    fit = max(others.values(), key=lambda trial: trial.score).fit
    return diagnosis.prepared.fitter.model.in_study_units(fit.physics, fit.nuisance)


MEASURES = {"error": error_of, "within": share_within}
COLUMNS = ("noise", "verdict", "none", "wrong")


class HeldOut:
    """Features of the held-out protocol, recorded by XCIST and simulated by a study."""

    def __init__(self, folder: Path, phantom, one, config, seed: int, rays: int):
        self.recording, self.phantom, self.one = load_recording(folder), phantom, one
        self.config, self.seed, self.rays = config, seed, rays
        scanned = ScannedVolume(phantom.image, {roi.name: roi.mask for roi in phantom.rois}, phantom.image.grid)
        geometry = self.recording.geometry
        self.grid = image_grid(geometry, scanned.radius_mm)
        regions = phantom_regions(self.grid, complete(geometry, self.grid), scanned, Pose())
        self.masks = {
            name: mask for name, mask in regions.rois.items() if mask.sum(axis=(1, 2)).max() >= MINIMUM_VOXELS
        }
        self.parameters = read_parameters(None, section="largest")

    def features(self, lines: np.ndarray) -> np.ndarray:
        """Features of line integrals [repeat, view, row, column], shape (repeats, features and regions)."""
        options = {"engine": "cpu", "mu_water_per_mm": self.config.mu_water_per_mm}
        images = reconstruct(
            lines, self.recording.geometry, self.grid, "fbp", FbpSettings(normalise="coverage"), **options
        )
        arrays = np.stack([image.array for image in images])
        table = extract_repeats(arrays, self.grid, self.masks, "held out", self.parameters)
        return table[list(FEATURES)].to_numpy(float).reshape(len(images), -1)

    def recorded(self) -> np.ndarray:
        """Features of the recording's repeats."""
        return self.features(scans(self.recording.repeats).repeats.astype(np.float32))

    def simulated(self, physics_file: Path | None) -> np.ndarray:
        """Features of the study's repeats with the physics of a file."""
        physics = read_diagnosed_physics(physics_file)[0] if physics_file else {}
        clean, state = project_phantom(
            self.phantom.fine,
            self.recording.geometry,
            physics,
            mu_water_per_mm=self.config.mu_water_per_mm,
            materials=Segmentation(**to_mapping(self.one.stated)),
            sensor=Sensor(**to_mapping(self.config.sensor)),
            samples=self.rays,
        )
        taken = {
            "geometry": "held_out",
            "noise": "held_out",
            "noise_level": 1 / HELD_OUT["photons"],
            "model": "physical",
        }
        counts = (
            acquire(clean, seed=repeat, study_seed=self.seed, state=state, **taken)
            for repeat in range(HELD_OUT["repeats"])
        )
        return self.features(np.stack([one.line_integrals(self.config.noise.zero_counts_as) for one in counts]))


def case_of(number: int, seed: int) -> dict:
    """Truth of a case; effects take turns."""
    random = generator(branch(seed, number))
    effect = simulator_scans.of_catalogue(EFFECTS[number % len(EFFECTS)], STRENGTH, random)
    return {"case": f"case_{number:02d}", "number": number, "phantom": PHANTOM, "effects": [effect]}


def row_of(number: int, options, config) -> dict:
    """Errors of a case by the physics of the study."""
    seed = options.seed
    truth = case_of(number, seed)
    hidden, one = truth["effects"][0]["name"], OBJECTS[PHANTOM]
    began = sum(os.times()[:4])
    with tempfile.TemporaryDirectory() as root:
        folders = {name: Path(root, name) for name in ("scan", "held_out")}
        for folder in folders.values():
            folder.mkdir()
        model = simulator_scans.recorded(folders["scan"], truth, config, seed, taken=SCAN)
        other = truth | {"number": number + OTHER_NOISE}
        simulator_scans.recorded(folders["held_out"], other, config, seed, taken=HELD_OUT)
        tried = candidates(model.settings)
        diagnosis = run_diagnosis(simulator_scans.request(model), tried, config.diagnosis.model_accuracy, images=False)
        found = {"verdict": overlay_of(diagnosis)["physics"], "none": {}, "wrong": wrong_effect(diagnosis, hidden)}
        phantom = simulator_scans.built(PHANTOM, SCAN["columns"], SCAN["rows"], config.seed)
        held_out = HeldOut(folders["held_out"], phantom, one, config, seed, options.rays)
        recorded = held_out.recorded()
        compared = {"noise": (recorded[::2], recorded[1::2])}
        for name, physics in found.items():
            path = Path(root, f"{name}.yaml")
            path.write_text(yaml.safe_dump({"physics": physics}), encoding="utf-8")
            compared[name] = recorded, held_out.simulated(path if physics else None)
    named = [effect["name"] for effect in diagnosis.content["effects"]]
    row = {
        "number": number,
        "hidden": hidden,
        "phantom": simulator_scans.phantom_of(truth),
        "named": named,
        "wrong": list(found["wrong"]),
    }
    row |= {measure: {key: of(*pair) for key, pair in compared.items()} for measure, of in MEASURES.items()}
    return row | {"quantities": recorded.shape[1], "cpu_s": round(sum(os.times()[:4]) - began, 1)}


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument(
        "--rays", type=int, default=2, help="of the study, per pixel and direction; 1: as in the workflow"
    )
    parser.add_argument("--out", type=Path, required=True, help="JSON lines")


def run(options):
    config = common.configuration()
    rows = common.read_jsonl(options.out)
    done = {row["number"] for row in rows}
    for number in range(options.cases):
        if number not in done:
            rows.append(row_of(number, options, config))
            common.append_jsonl(options.out, rows[-1])
            print(rows[-1], flush=True)
    summarize(rows)


def summarize(rows: Sequence[Mapping]) -> None:
    """Print both measures by hidden effect as Markdown tables: mean over cases, and the worst case."""
    for measure, worst in (("error", max), ("within", min)):
        print(f"\n| {measure} | cases | named first | {' | '.join(COLUMNS)} | better than none, than wrong |")
        print("|" + "---|" * (len(COLUMNS) + 4))
        for name in ("all", *EFFECTS):
            of = [row for row in rows if name in ("all", row["hidden"])]
            if not of:
                continue
            first = sum(row["named"][:1] == [row["hidden"]] for row in of)
            by = {key: 100 * np.array([row[measure][key] for row in of]) for key in COLUMNS}
            shown = " | ".join(f"{values.mean():.1f} % (worst {worst(values):.1f} %)" for values in by.values())
            sign = 1 if worst is max else -1
            better = [int((sign * by["verdict"] < sign * by[other]).sum()) for other in COLUMNS[2:]]
            print(f"| {name} | {len(of)} | {first} | {shown} | {better[0]}, {better[1]} |")
