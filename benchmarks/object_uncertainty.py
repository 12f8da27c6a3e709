"""Diagnose scans with a slightly wrong object, described as exact and with its default uncertainty (20 minutes of CPU).

Scans are by the simulator of the blind validation. With nothing hidden, the object's description is changed. With a
hidden effect, it is the known phantom of the validation. Finished cases of the output file are not repeated.

Development seeds were 101 and 102. The results in docs/validation/limits.md are for the 56 finished cases of the seeds
7201 and 7202. The other cases have not been run. The validation record has seed 7203, by photons and repeats.
"""

import os
import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks import common
from benchmarks.common import simulator_scans
from benchmarks.common.tuning_objects import OBJECTS
from virtual_phantom.base.streams import Branch, branch, generator
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.io.volumes import Volume, read_nifti, write_nifti

NONE = "none"
EFFECTS = ("scatter", "veiling_glare", "spectrum", "focal_spot", "afterglow", "dark_signal")
STRENGTHS = ("weak", "medium", "strong")


def above(hu, threshold, changed):
    return np.where(hu > threshold, changed, hu)


def coarse(hu):
    """Voxels of twice the size, on the same grid."""
    even = hu[tuple(slice(n // 2 * 2) for n in hu.shape)]
    means = even.reshape(*(part for n in even.shape for part in (n // 2, 2))).mean(axis=(1, 3, 5))
    repeated = means.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    return np.pad(repeated, [(0, n % 2) for n in hu.shape], mode="edge")


TOLD = {
    "as scanned": lambda hu: hu,
    "+5 HU above 60 HU": lambda hu: above(hu, 60, hu + 5),
    "x 1.01": lambda hu: (hu + 1000) * 1.01 - 1000,
    "+3 % above 150 HU": lambda hu: above(hu, 150, (hu + 1000) * 1.03 - 1000),
    "+2 HU": lambda hu: above(hu, -950, hu + 2),
    "x 1.005": lambda hu: (hu + 1000) * 1.005 - 1000,
    "blur of half a voxel": lambda hu: ndimage.gaussian_filter(hu, 0.5, mode="nearest"),
    "voxels twice as large": coarse,
}


def cases(options):
    """Rows without results, of the options."""
    for seed, (number, phantom), dose in product(options.seeds, enumerate(OBJECTS), options.doses):
        if phantom not in options.phantoms:
            continue
        photons, _, repeats = dose.partition("x")
        scan = {"seed": seed, "number": number, "phantom": phantom, "photons": float(photons), "repeats": int(repeats)}
        for told in options.told:
            yield scan | {"hidden": NONE, "strength": "", "told": told}
        for effect, strength in product(options.effects, options.strengths):
            yield scan | {"hidden": effect, "strength": strength, "told": "as scanned"}


def diagnosed(folder, model, exact, config):
    settings = replace(model.settings, object_exact=exact)
    model = replace(model, settings=settings)
    began = sum(os.times()[:4])
    tried = list(candidates(settings))
    content = run_diagnosis(
        simulator_scans.request(model), tried, config.diagnosis.model_accuracy, images=False
    ).content
    return content, round(sum(os.times()[:4]) - began, 1)


def rows_of(case, model, config, folder):
    """Rows of a case, with the object described as exact and with its default uncertainty."""
    image, effect = read_nifti(folder / "as_scanned.nii.gz"), case["hidden"]
    write_nifti(Volume(TOLD[case["told"]](image.array).astype(np.float32), image.grid), folder / "image.nii.gz")
    for exact in (True, False):
        content, seconds = diagnosed(folder, model, exact, config)
        named = [found["name"] for found in content["effects"]]
        others = content["ambiguous_with"].get(named[0], []) if named else []
        imitated = [one["what"] for one in content["object_alternatives"].values()]
        yield case | {
            "exact": exact,
            "verdict": content["verdict"],
            "named": "+".join(named),
            "right": int(named[:1] == [effect] if effect != NONE else content["verdict"] == "match"),
            "alternatives": "+".join(others),
            "object": "; ".join(imitated) or "+".join(content["object_errors"].get("imitated_by", [])),
            "cpu_s": seconds,
        }


KEYS = ("seed", "number", "phantom", "photons", "repeats", "hidden", "strength", "told")
FIELDS = (*KEYS, "exact", "verdict", "named", "right", "alternatives", "object", "cpu_s")


def add_arguments(parser):
    parser.add_argument("--seeds", nargs="*", type=int, default=[7201, 7202])
    parser.add_argument("--told", nargs="*", default=list(TOLD), choices=list(TOLD))
    parser.add_argument("--effects", nargs="*", default=list(EFFECTS))
    parser.add_argument("--strengths", nargs="*", default=list(STRENGTHS))
    parser.add_argument("--phantoms", nargs="*", default=list(OBJECTS), choices=list(OBJECTS))
    parser.add_argument("--doses", nargs="*", default=["1e5x4"], help="photons per pixel in air x repeats")
    parser.add_argument("--out", type=Path, default=Path("object_uncertainty.csv"))


def key_of(row):
    return tuple(str(row[name]) for name in KEYS)


def run(options):
    config = common.configuration()
    rows = common.read_csv_rows(options.out)
    done = set(map(key_of, rows))
    with tempfile.TemporaryDirectory() as root, common.csv_writer(options.out, FIELDS, append=True) as write:
        scanned, model, folder = None, None, None
        for case in cases(options):
            if key_of(case) in done:
                continue
            if scanned != key_of(case)[:-1]:  # the descriptions of a scan's object come after each other
                scanned = key_of(case)[:-1]
                folder = Path(root, *scanned)
                folder.mkdir(parents=True)
                model = recorded(folder, case, config)
            for row in rows_of(case, model, config, folder):
                write(row)
                rows.append({key: str(value) for key, value in row.items()})
                print(*row.values(), sep=", ", flush=True)
    summarize(rows)


def recorded(folder, case, config):
    """Scan a case; returns what a diagnosis request needs."""
    seed, effect = case["seed"], case["hidden"]
    random = generator(branch(seed, Branch.PROOF_PHANTOM))
    hidden = [] if effect == NONE else [simulator_scans.of_catalogue(effect, case["strength"], random)]
    truth = {"case": "case", "phantom": case["phantom"], "number": case["number"], "effects": hidden}
    taken = simulator_scans.SCAN | {"photons": case["photons"], "repeats": case["repeats"]}
    model = simulator_scans.recorded(folder, truth, config, seed, taken=taken)
    os.replace(folder / "image.nii.gz", folder / "as_scanned.nii.gz")
    return model


def summarize(rows):
    """Print how often the answer was right: a match, or the hidden effect named first."""
    for exact in ("True", "False"):
        print("exact object" if exact == "True" else "default uncertainty")
        chosen = [row for row in rows if row["exact"] == exact]
        for keys in (("photons", "repeats", "told"), ("photons", "repeats", "strength"), ("hidden",)):
            counts = {}
            for row in chosen:
                if (row["hidden"] == NONE) == ("told" in keys):
                    counts.setdefault(tuple(row[key] for key in keys), []).append(int(row["right"]))
            for values, right in counts.items():
                print(f"  {', '.join(values)}: {sum(right)} of {len(right)}")
