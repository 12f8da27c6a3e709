"""Small scans by the simulator of the blind validation."""

import os
import tempfile
from functools import cache
from pathlib import Path

from benchmarks.common.tuning_objects import OBJECTS, acquire, build, scan_of
from virtual_phantom.base.proof_settings import ProofSettings
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.base.streams import Branch, branch, generator
from virtual_phantom.config.dependencies import resource
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.diagnosis.settings import FitSettings, RecordingSettings
from virtual_phantom.io.volumes import write_nifti
from virtual_phantom.physics.effect import load
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.generate import hidden_settings, write
from virtual_phantom.proof.hiding.missing_effects import MISSING_EFFECTS
from virtual_phantom.proof.hiding.suite import KNOWN, scan_seed, truths
from virtual_phantom.proof.hiding.xcist import energy_of_water

SCAN = {"columns": 64, "rows": 4, "views": 36, "photons": 1e5, "rotation_time_ms": 1000.0, "repeats": 4}


def add_draws(parser, strengths, none, pairs, unknown):
    """Add the options that select cases of the blind validation."""
    effects = ["scatter", "spectrum", "focal_spot", "afterglow", "dark_signal"]
    parser.add_argument("--effects", nargs="*", default=effects, help="effects of the library, each hidden alone")
    parser.add_argument("--strengths", nargs="*", default=strengths)
    parser.add_argument("--none", type=int, default=none)
    parser.add_argument("--pairs", type=int, default=pairs, help="scans with two effects of the library")
    parser.add_argument("--unknown", type=int, default=unknown)


def left_to_do(options, rows):
    """{case: truth} that the options of add_draws and a seed select, without finished cases."""
    drawn = {name: getattr(options, name) for name in ("seed", "effects", "strengths", "none", "pairs", "unknown")}
    done = {row["truth"]["case"] for row in rows}
    return {case: truth for case, truth in truths(proof_settings(drawn)).items() if case not in done}


@cache
def built(phantom, columns, rows, seed):
    """Phantom of the blind validation, as a study with this seed makes it."""
    one = OBJECTS[phantom]
    return build(one, resource(one.layout), columns, rows, branch(seed, Branch.PROOF_PHANTOM))


def recorded(folder, truth, config, seed, baseline=None, taken=SCAN):
    """Write the recording and the object of a case; returns what a diagnosis request needs. `taken` is the scan."""
    one, mu = OBJECTS[phantom_of(truth)], config.mu_water_per_mm
    phantom = built(phantom_of(truth), taken["columns"], taken["rows"], config.seed)
    hidden = hidden_settings({"effects": truth["effects"]})
    orbit, scan = scan_of(one, taken, energy_of_water(mu), hidden)
    readings = acquire(scan, one, phantom.fine, mu, taken["repeats"], scan_seed(seed, truth["number"]))
    write(folder, truth["case"], orbit, taken["rotation_time_ms"], readings, mu)
    write_nifti(phantom.image, folder / "image.nii.gz")
    settings = RecordingSettings(2, 1, {}, nominal_photons=taken["photons"], baseline=baseline or {})
    return FitSettings(str(folder), settings, mu, one.stated, config.seed, protocol=None)


OF_OBJECT = ("patient_table", "truncated_object", "wrong_insert")  # faults of the object, which these scans lack


def phantom_of(truth):
    """Phantom of a truth; truths of the blind validation, whose objects are others, use both in turn."""
    return truth["phantom"] if truth["phantom"] in OBJECTS else tuple(OBJECTS)[truth["number"] % len(OBJECTS)]


def proof_settings(drawn):
    """Settings of the section `proof` for small projections, with no pairs by default."""
    settings = {
        "simulators": ("xcist",),
        "declared": 0,
        "pairs": 0,
        "unknown_kinds": [name for name in MISSING_EFFECTS if name not in OF_OBJECT],
        "images": {"strengths": [], "effects": [], "views_times": 1},
        "scan": SCAN,
        "held_out_protocol": {"views": 30},
    } | drawn
    if not settings["effects"]:  # none alone
        settings |= {"effects": ["scatter"], "strengths": []}
    return from_mapping(ProofSettings, settings)


ORDER, TRUTH = range(2)  # branches of the seed
LEFT_OUT = ("view_blur",)  # not declared: it multiplies the rays of each fit


def declarable_effects() -> list[str]:
    """Effects whose parameters all exist in the simulator."""
    found = []
    for name in KNOWN:
        effect = load(name)
        _, comparable = CATALOGUE[name].draw("medium", generator(branch(0, TRUTH)))
        if (
            name not in LEFT_OUT
            and not effect.pattern
            and {parameter.name for parameter in effect.parameters} <= set(comparable)
        ):
            found.append(name)
    return found


def of_catalogue(name: str, strength: str, random) -> dict:
    settings, comparable = CATALOGUE[name].draw(strength, random)
    return {"name": str(name), "strength": strength, "settings": settings, "comparable": comparable}


def prepared(truth, config, seed):
    """Recording of a case, its preparation for fits, and what the diagnosis needs."""
    with tempfile.TemporaryDirectory() as folder:
        model = recorded(Path(folder), truth, config, seed)
        return *prepare_recording(request(model)), model


def request(model):
    return DiagnosisRequest.of(model, str(Path(model.folder) / "image.nii.gz"), 1)


def diagnosed(truth, config, seed, baseline=None):
    """Content of the diagnosis of a case, and its CPU time."""
    with tempfile.TemporaryDirectory() as folder:
        model = recorded(Path(folder), truth, config, seed, baseline)
        tried = list(candidates(model.settings))
        began = sum(os.times()[:4])
        found = run_diagnosis(request(model), tried, config.diagnosis.model_accuracy, images=False)
        return found.content, sum(os.times()[:4]) - began
