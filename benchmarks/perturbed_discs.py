"""Add a known fault to real sinograms of discs, and count how often the diagnosis names it (25 minutes of CPU).

The folder RECORDINGS holds discs, imported as in docs/validation/real-discs.md. Every VIEW_STEP-th view is used, and
intensities are averaged over COLUMNS_BINNED columns. Each disc is first diagnosed as it is. The effects found there are
declared (`baseline_from`) in the next diagnosis of the same scan, until none is found (ROUNDS at most). The last one is
the control; what it declares is declared for the scan with the fault, too. OUT is a folder; finished cases in it are
not repeated.

FAULTS defines the right answers. Answers of the control do not count, unless a parameter is outside of the control's
95 % interval. The same holds for declared effects that contradict the data, which count as named. A group of k
indistinguishable effects scores the share of right ones in it.

Development seeds: 1 and 2 (eight cases, disc ta).
"""

import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from benchmarks import common
from benchmarks.real_discs import ALIGNMENT
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.diagnosis.selection.transfer import with_declared
from virtual_phantom.diagnosis.settings import Disc, FitSettings, MaskedObject, RecordingSettings
from virtual_phantom.io.documents import DIAGNOSIS, write_document
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.proof.hiding.case import ADMITTED
from virtual_phantom.proof.scoring.intervals import share_of
from virtual_phantom.recordings.importers import write_projections
from virtual_phantom.recordings.reading import load_recording

SOLID = "solid_disc"
VIEW_STEP, COLUMNS_BINNED = 18, 4
TRIED = (
    *("spectrum", "scatter", "veiling_glare", "dark_signal", "focal_spot", "gain_pattern", "afterglow"),
    *("xray_crosstalk", "optical_crosstalk", "centre_of_rotation", "detector_offset", "view_angle_error"),
)
ANGLE_WITHIN_DEG = 0.25  # largest error of a start angle that counts as right
START_ANGLE_DEG, STEP_DEG = 180.0, 0.5  # of the files
ROUNDS = 4  # diagnoses of a disc with what the one before has found
ORDER, CASE = range(2)  # branches of the seed


def lag(intensities, share, random):
    """Add a share of the previous view."""
    previous = np.concatenate([intensities[:1], intensities[:-1]])
    return (1 - share) * intensities + share * previous, {}


def gains(intensities, sd, random):
    """Scale every column by a random gain."""
    return intensities * np.exp(random.normal(0, sd, intensities.shape[1])), {}


def block(columns, width, random):
    """First and last column of a random block in the middle half, which the object covers."""
    first = int(random.integers(columns // 4, 3 * columns // 4 - width))
    return first, first + width - 1


def strip(intensities, transmission, random):
    """Cover a block of four columns with a strip of this transmission."""
    first, last = block(intensities.shape[1], 4, random)
    covered = intensities.copy()
    covered[:, first : last + 1] *= transmission
    return covered, {"columns": [first, last]}


def repeated(intensities, width, random):
    """Read a block of columns as the column before it."""
    first, last = block(intensities.shape[1], width, random)
    copied = intensities.copy()
    copied[:, first : last + 1] = intensities[:, first - 1 : first]
    return copied, {"columns": [first, last]}


def constant(intensities, level, random):
    """Add a share of the intensity in air."""
    return intensities + level, {}


def blur(intensities, share, random):
    """Move a share of the intensity to each neighboring column."""
    padded = np.pad(intensities, ((0, 0), (1, 1)), mode="edge")
    return (1 - 2 * share) * intensities + share * (padded[:, :-2] + padded[:, 2:]), {}


def center(intensities, columns, random):
    """Shift the detector by whole columns to a random side; air enters at the other side."""
    shift = columns * int(random.choice([-1, 1]))
    return np.roll(intensities, shift, axis=1), {"shift": shift}


def start_angle(intensities, views, random):
    """Begin with a view that was recorded before the stated first one, in a turn without a repeated view."""
    return np.roll(intensities, views, axis=0), {"turn_deg": views * STEP_DEG}


@dataclass(frozen=True)
class Fault:
    """Fault that is added to a scan.

    Attributes
    ----------
    perturb : callable
        (intensities [view, column], strength, random generator) -> changed intensities and facts for the score.
    effects : tuple of str
        Right answers. Without any, the set-up check or the alignment must state the angle.
    located : bool
        Whether unexplained differences in the changed columns are right, too.
    cases : int
        Number among 40.
    binned : bool
        Whether columns are averaged before the fault is added; otherwise after.
    with_holes : bool
        Whether a disc without holes cannot show the fault.
    """

    perturb: Callable
    strengths: tuple[float, ...]
    effects: tuple[str, ...]
    cases: int
    located: bool = False
    binned: bool = True
    with_holes: bool = False

    @property
    def of_setup(self) -> bool:
        """Whether it is a fault of the geometry, for which the scan set-up is checked."""
        return not self.binned


FAULTS = {
    "lag": Fault(lag, (0.01, 0.03, 0.1), ("afterglow",), 6, with_holes=True),
    "gains": Fault(gains, (0.005, 0.01, 0.03), ("gain_pattern",), 5),
    "strip": Fault(strip, (0.95, 0.8, 0.5), ("gain_pattern",), 5, located=True),
    "repeated columns": Fault(repeated, (2, 4, 8), ("gain_pattern",), 5, located=True),
    "constant": Fault(constant, (0.005, 0.01, 0.02), ("dark_signal",), 6),
    "blur": Fault(blur, (0.03, 0.08, 0.15), ("xray_crosstalk", "optical_crosstalk"), 6),
    "center": Fault(center, (2, 4, 8), ("detector_offset",), 4, binned=False, with_holes=True),
    "start angle": Fault(start_angle, (2, 6, 20), (), 3, binned=False, with_holes=True),
}


def cases(seed: int, discs: Sequence[str], count: int) -> list[dict]:
    """The first `count` of 40 cases in random order; strengths take turns, discs are drawn."""
    planned = []
    for name, fault in FAULTS.items():
        random = generator(branch(seed, ORDER, list(FAULTS).index(name)))
        of = [disc for disc in discs if disc != SOLID or not fault.with_holes]
        for number in range(fault.cases):
            strength = fault.strengths[number % len(fault.strengths)]
            planned.append({"fault": name, "strength": strength, "disc": str(random.choice(of))})
    order = generator(branch(seed, ORDER)).permutation(len(planned))
    return [{"number": int(number)} | planned[number] for number in order[:count]]


def reduced(lines: np.ndarray, fault: Fault | None, strength: float, random) -> tuple[np.ndarray, dict]:
    """Line integrals [view, column] of fewer views and wider columns, with the fault; and its facts."""
    intensities, facts = np.exp(-lines[: round(360 / STEP_DEG)].astype(float)), {}
    if fault and not fault.binned:
        intensities, facts = fault.perturb(intensities, strength, random)
    intensities = intensities[::VIEW_STEP]
    intensities = intensities.reshape(len(intensities), -1, COLUMNS_BINNED).mean(axis=2)
    if fault and fault.binned:
        intensities, facts = fault.perturb(intensities, strength, random)
    return -np.log(intensities), facts


def write_reduced(source: Path, target: Path, lines: np.ndarray) -> None:
    """Write a recording with these line integrals [view, column] of another recording's object."""
    target.mkdir(parents=True)
    document = yaml.safe_load((source / "recording.yaml").read_text(encoding="utf-8"))
    pitch = document["scan"]["column_pitch_mm"] * COLUMNS_BINNED
    views, columns = lines.shape
    document["scan"] |= {"views": views, "views_per_rotation": views, "columns": columns, "column_pitch_mm": pitch}
    angles = START_ANGLE_DEG + np.arange(views) * 360 / views
    write_projections(target / "projections.h5", lines[:, None].astype(np.float32), angles)
    (target / "recording.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
    if (source / "object.nii.gz").is_file():
        shutil.copy(source / "object.nii.gz", target)


def diagnosed(folder: Path, name: str, declared: Path | None, check_setup: bool) -> dict:
    """Content of the diagnosis of a reduced disc."""
    scanned = {"disc": Disc(70, "pmma")}
    if name != SOLID:
        scanned = {"object": MaskedObject(str(folder / "object.nii.gz"), "pmma")}
    settings = RecordingSettings(1, 1, ALIGNMENT, check_setup=check_setup, **scanned)
    model = FitSettings(str(folder), settings, defaults_of()["mu_water_per_mm"], Segmentation(), 0, None)
    settings = with_declared(model, declared).settings
    request = DiagnosisRequest(folder, settings, model.mu_water_per_mm, Segmentation())
    accuracy = defaults_of("diagnosis", "model_accuracy")
    return run_diagnosis(request, TRIED, accuracy, images=False).content


def moved(parameters: Mapping, control: Mapping) -> bool:
    """Whether a parameter is outside of the control's 95 % interval."""
    both = parameters.keys() & control.keys()
    return any(not control[key]["ci95"][0] <= parameters[key]["value"] <= control[key]["ci95"][1] for key in both)


def added(content: Mapping, control: Mapping) -> list[set[str]]:
    """Groups of indistinguishable effects that the control does not name, or names with other values.

    As in the verdict, declared effects that the data contradict follow the named ones.
    """
    known = {effect["name"]: effect["parameters"] for effect in control["effects"]}
    stated, groups = control.get("declared", {}), []
    for effect in content["effects"]:
        name = effect["name"]
        if name not in known or moved(effect["parameters"], known[name]):
            groups.append({name, *content["ambiguous_with"].get(name, ())})
    for name, parameters in content.get("declared", {}).items():
        if moved({key: one for key, one in parameters.items() if one["off"]}, stated.get(name, {})):
            groups.append({name})
    return groups


def columns_of(where: str) -> tuple[int, int] | None:
    """First and last column of a location, such as "column 44 of 140"; None if it has none."""
    found = re.search(r"columns? (\d+)(?: to (\d+))?", where)
    return found and (int(found[1]), int(found[2] or found[1]))


def in_columns(content: Mapping, columns: Sequence[int]) -> bool:
    """Whether an unexplained difference is located in columns, with a tolerance of one."""
    if content["verdict"] not in ADMITTED:
        return False
    found = filter(None, (columns_of(one["where"]) for one in content["unexplained"]))
    return any(first <= columns[1] + 1 and last >= columns[0] - 1 for first, last in found)


def right_angle(content: Mapping, turn_deg: float, control: Mapping) -> bool:
    """Whether the set-up check or the alignment states the angle by which the object appears rotated."""
    for line in content.get("setup", {}).get("mistakes", {}).values():
        stated = re.search(r"scan\.start_angle_deg: (-?[\d.]+)", line)
        if stated:
            return abs((START_ANGLE_DEG - turn_deg - float(stated[1]) + 180) % 360 - 180) < ANGLE_WITHIN_DEG
    turns = [one.get("alignment", {}).get("turn_deg", {}).get("value", 0.0) for one in (content, control)]
    return abs(turns[0] - turns[1] - turn_deg) < ANGLE_WITHIN_DEG


def scored(fault: Fault, facts: Mapping, content: Mapping, control: Mapping) -> dict:
    """Score of an answer: share of the right effects in the first group and anywhere, and wrong groups."""
    groups, right = added(content, control), set(fault.effects)
    shares = [len(group & right) / len(group) for group in groups]
    first, anywhere = (shares[0], max(shares)) if groups else (0.0, 0.0)
    if fault.effects and "detector offset" in " ".join(content.get("setup", {}).get("mistakes", {})):
        first = anywhere = float("detector_offset" in right)
    if not fault.effects:
        anywhere = float(right_angle(content, facts["turn_deg"], control))
        first = anywhere if not groups else 0.0
    if fault.located and in_columns(content, facts["columns"]) and not in_columns(control, facts["columns"]):
        first, anywhere = max(first, float(not groups)), 1.0
    wrong = sum(not share for share in shares)
    return {"first": first, "anywhere": anywhere, "wrong": wrong, "unexplained": content["verdict"] in ADMITTED}


def add_arguments(parser):
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=40, help="number of cases, 40 at most")
    parser.add_argument("--faults", nargs="+", default=list(FAULTS), choices=list(FAULTS))
    parser.add_argument("--discs", nargs="+", default=[SOLID, "ta", "02b", "03c"])
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")


def lines_of(folder: Path) -> np.ndarray:
    """Line integrals of a disc, shape (views, columns)."""
    (repeat,) = load_recording(folder).repeats
    return repeat.data[:, 0]


def diagnosed_case(options, disc: str, fault: Fault | None = None, strength=0.0, random=None, **settings) -> tuple:
    """Content of the diagnosis of a disc with a fault, and the facts and CPU time."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "disc"
        lines, facts = reduced(lines_of(options.recordings / disc), fault, strength, random)
        write_reduced(options.recordings / disc, target, lines)
        began = sum(os.times()[:4])
        content = diagnosed(target, disc, **settings)
        return content, facts, round(sum(os.times()[:4]) - began, 1)


def controls_of(options, disc: str) -> tuple[Path, Path]:
    """Diagnoses (json) of a disc without an added fault: whose physics is declared, and the control that declares it.

    They are made if necessary.
    """
    declared = None
    for number in range(1 + ROUNDS):
        path = options.out / "controls" / f"{disc}_{number}.json"
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            content, _, seconds = diagnosed_case(options, disc, declared=declared, check_setup=not declared)
            print(f"{path.stem}: {content['sentence']} [{seconds:.0f} s]", flush=True)
            write_document(content, path, DIAGNOSIS)
        if declared and (number == ROUNDS or not json.loads(path.read_text(encoding="utf-8"))["effects"]):
            break
        declared = path
    return declared, path


def perturbed(options, case: dict) -> dict:
    """Row of a case: its truth, the scored answer and the CPU time."""
    fault, (declared, path) = FAULTS[case["fault"]], controls_of(options, case["disc"])
    control = json.loads(path.read_text(encoding="utf-8"))
    random = generator(branch(options.seed, CASE, case["number"]))
    settings = {"declared": declared, "check_setup": fault.of_setup}
    content, facts, seconds = diagnosed_case(options, case["disc"], fault, case["strength"], random, **settings)
    kept = {"added": [sorted(group) for group in added(content, control)], "sentence": content["sentence"]}
    kept["unexplained_at"] = [one["where"] for one in content["unexplained"]]
    return case | facts | scored(fault, facts, content, control) | kept | {"seconds": seconds}


def run(options):
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / f"seed_{options.seed}.jsonl"
    rows = common.read_jsonl(path)
    done = {row["number"] for row in rows}
    for case in cases(options.seed, options.discs, options.cases):
        if case["number"] in done or case["fault"] not in options.faults:
            continue
        rows.append(perturbed(options, case))
        common.append_jsonl(path, rows[-1])
        print(" | ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
    summarize(rows)


def summarize(rows: Sequence[Mapping]) -> None:
    """Print the scores by fault as a Markdown table."""
    print("| fault | named first | named anywhere | wrong groups | something unexplained |\n|---|---|---|---|---|")
    for name in ["all", *FAULTS]:
        of = [row for row in rows if name in ("all", row["fault"])]
        if of:
            sums = [sum(row[key] for row in of) for key in ("first", "anywhere", "wrong", "unexplained")]
            first, *others = (f"{number:g}" for number in sums)
            low, high = (100 * end for end in share_of(sums[0], len(of))["ci95"])
            print(f"| {name} | {first} of {len(of)} ({low:.0f} to {high:.0f} %) | {' | '.join(others)} |")
