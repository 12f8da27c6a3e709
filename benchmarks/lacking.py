"""What diagnoses say of faults that the library lacks, on scans smaller than those of `snakemake proof`.

    python benchmarks/lacking.py --seed 31 --unknown 14 --none 2 --out lacking.jsonl

Scans by the proof's simulator, drawn as `snakemake proof` draws them: 64 columns x 4 rows x 36 views, 4 repeats of 1e5
photons per pixel. Cases that the file has already are not done again, so that a run may be stopped.
"""

import argparse
import json
import os
import tempfile
from pathlib import Path

import yaml

from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.config.config import complete
from virtual_phantom.config.dependencies import resource
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.io.volumes import write_nifti
from virtual_phantom.proof.hiding.case import Case
from virtual_phantom.proof.hiding.generate import acquire, hidden_settings, scan_section, write
from virtual_phantom.proof.hiding.objects import OBJECTS
from virtual_phantom.proof.hiding.phantoms import build
from virtual_phantom.proof.hiding.suite import scan_seed, truths
from virtual_phantom.proof.hiding.xcist import energy_of_water
from virtual_phantom.proof.scoring.remainders import summary

ROOT = Path(__file__).resolve().parents[1]
SCAN = {"columns": 64, "rows": 4, "views": 36, "photons": 1e5, "rotation_time_ms": 1000.0, "repeats": 4}


def default_config():
    """The configuration that everybody begins with, complete."""
    return complete(yaml.safe_load((ROOT / "config" / "config.yaml").read_text(encoding="utf-8")))


def add_draws(parser, strengths, none, pairs, unknown):
    """Add options of what is drawn of the proof's cases, with these defaults."""
    effects = ["scatter", "spectrum", "focal_spot", "afterglow", "dark_signal"]
    parser.add_argument("--effects", nargs="*", default=effects, help="effects of the library, each concealed alone")
    parser.add_argument("--strengths", nargs="*", default=strengths)
    parser.add_argument("--none", type=int, default=none)
    parser.add_argument("--pairs", type=int, default=pairs, help="scans with two effects of the library")
    parser.add_argument("--unknown", type=int, default=unknown)


def left_to_do(options, rows):
    """{case: truth} of what options of add_draws and a seed draw, without those that rows have."""
    drawn = {name: getattr(options, name) for name in ("seed", "effects", "strengths", "none", "pairs", "unknown")}
    drawn["unknown_kinds"] = vars(options).get("kinds")
    done = {row["truth"]["case"] for row in rows}
    return {case: truth for case, truth in truths(asked_of_proof(drawn)).items() if case not in done}


def recorded(folder, truth, config, seed, baseline=None):
    """A case's recording in a folder, with its object; what a diagnosis asks of it, with what is declared."""
    one, mu = OBJECTS[truth["phantom"]], config["mu_water_per_mm"]
    stream = branch(config["seed"], Branch.PROOF_PHANTOM)
    phantom = build(one, resource(one.layout), SCAN["columns"], SCAN["rows"], stream)
    kev, views = energy_of_water(mu), SCAN["views"]
    scan = scan_section(one, SCAN, views, SCAN["photons"], SCAN["rotation_time_ms"], kev, hidden_settings(truth))
    write(
        folder,
        truth["case"],
        scan,
        acquire(scan, one, phantom.fine, mu, SCAN["repeats"], scan_seed(seed, truth["number"])),
    )
    write_nifti(phantom.image, folder / "image.nii.gz")
    settings = {"samples": 2, "view_step": 1, "nominal_photons": SCAN["photons"], "alignment": {}}
    settings["baseline"] = baseline or {}
    model = {"folder": str(folder), "settings": settings, "mu_water_per_mm": mu, "materials": one.stated}
    return model | {"seed": config["seed"], "protocol": None}


def diagnosed(folder, truth, config, seed, left_out):
    """What is said of one case, and how long the diagnosis took of the processor."""
    model = recorded(folder, truth, config, seed)
    request = DiagnosisRequest.of(model, str(folder / "image.nii.gz"), 1)
    tried = [name for name in candidates(model["settings"]) if name not in left_out]
    began = sum(os.times()[:4])
    found = run_diagnosis(request, tried, config["diagnosis"]["model_accuracy"], images=False)
    return found.content, sum(os.times()[:4]) - began


def asked_of_proof(drawn):
    """What is drawn, as `proof` of the configuration has it: small projections alone, without pairs unless asked."""
    settings = {
        "pairs": 0,
        "unknown_kinds": None,
        "images": {"strengths": [], "effects": [], "views_times": 1},
        "scan": SCAN,
        "held_out_protocol": {"views": 30},
    } | drawn
    if not settings["effects"]:  # none alone
        settings |= {"effects": ["scatter"], "strengths": []}
    return settings


def rows_of(path):
    """What a file holds of cases that were done; nothing of one that is not there."""
    return [json.loads(row) for row in path.read_text(encoding="utf-8").splitlines()] if path.is_file() else []


def append(path, row):
    """Add a case to a file."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    add_draws(parser, ["medium"], none=0, pairs=0, unknown=14)
    parser.set_defaults(effects=[])
    parser.add_argument("--kinds", nargs="*", help="of the faults; all that there are")
    parser.add_argument("--left-out", nargs="*", default=[], help="effects that diagnoses do not try")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    config = default_config()
    rows = rows_of(options.out)
    for case, truth in left_to_do(options, rows).items():
        with tempfile.TemporaryDirectory() as folder:
            said, seconds = diagnosed(Path(folder), truth, config, options.seed, options.left_out)
        kept = (
            "recording verdict sentence effects ambiguous_with remainder_sd excess_removed outside unexplained"
        ).split()
        rows.append({"truth": truth, "diagnosis": {key: said[key] for key in kept}, "seconds": seconds})
        append(options.out, rows[-1])
        hidden = ", ".join(f"{one['name']} ({one['strength']})" for one in truth["effects"]) or "nothing"
        print(f"{case} {hidden}: {said['sentence']} [{seconds:.0f} s]", flush=True)
    cases = [Case(row["truth"], row["diagnosis"]) for row in rows]
    found = summary(cases)
    for name, one in found["by_kind"].items():
        print(f"{name}: reported as unexplained {one['count']} of {one['n']}")
    singles = [case for case in cases if case.category == "single"]
    blank = [case for case in cases if case.category == "none"]
    unknown = [case for case in cases if case.category == "unknown"]
    pairs = [case for case in cases if case.category == "pair"]
    reported = sum(case.reported_unexplained for case in unknown)
    print(f"reported as unexplained {reported} of {len(unknown)}; area {found['area']}")
    print(f"effects of the library named first {sum(case.first_right for case in singles)} of {len(singles)}")
    both, alone = (sum(getattr(case, way) for case in pairs) for way in ("all_named", "exact"))
    print(f"two effects both named {both} of {len(pairs)}, and nothing beside them in {alone}")
    print(f"nothing concealed, no match {sum(not case.right for case in blank)} of {len(blank)}")


if __name__ == "__main__":
    main()
