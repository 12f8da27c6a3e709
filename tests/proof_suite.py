"""A blind test of nine cases, written by hand, with known scores."""

import json

import numpy as np

from virtual_phantom.io.files import write_text
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.case import Case
from virtual_phantom.proof.scoring.verdicts import verdict_document

SALT = "5a" * 32


def truth(case, category, effects=(), strength=None, where=(), kind="projections", phantom="abdomen", **fields):
    """Truth with effects {name: comparable parameters}; the library has no model of those with an exclamation mark.

    The library's own equation makes `heel`, unless `equation` is given. fields: further ones, such as simulator.
    """
    equation = fields.pop("equation", None)
    return {
        "case": case,
        "kind": kind,
        "phantom": phantom,
        "category": category,
        "strength": strength,
        "effects": [
            {
                "name": name.lstrip("!"),
                "known": not name.startswith("!"),
                "strength": strength,
                "settings": {"scale": 1.0},
                "comparable": comparable,
                "equation": equation or {"heel": "own"}.get(name, "other" if name.startswith("!") else "simulator"),
            }
            for name, comparable in dict(effects).items()
        ],
        "where": list(where),
        **{"simulator": "xcist", "geometry": "circular, flat detector", "object": phantom},
        "imperfections": {"declared": {}, "undeclared": {}},
        **fields,
    }


def diagnosis(case, verdict, effects=(), ambiguous=None, ruled_out=None, removed=None, p=0.0, gain=500.0, **named):
    """Scored content of a diagnosis.json.

    effects: {name: {parameter: (value, low, high)}}, the first chosen first; p: of the location in columns.
    """
    return {
        "recording": case,
        "verdict": verdict,
        "sentence": named.get("sentence", f"{case}: {verdict}"),
        "locations": [
            {"domain": "columns", "where": "column 3 of 64", "z": 9.0, "p": p, "map": "columns.npy"},
            {"domain": "edges", "where": "the 10 % steepest rays", "z": 1.0, "p": 0.2, "map": "edges.npy"},
        ],
        "effects": [
            {
                "name": name,
                "physics": "A sentence.",
                "parameters": {
                    key: {"value": value, "ci95": [low, high], "unit": "1"}
                    for key, (value, low, high) in values.items()
                },
                "evidence": {"held_out_gain": gain, "p": 1e-50},
            }
            for name, values in dict(effects).items()
        ],
        "ambiguous_with": {name: (ambiguous or {}).get(name, []) for name in dict(effects)},
        "ruled_out": ruled_out or {},
        "excess_rms_removed": removed,
        "remainder_sd": named.get("remainder", 0.0),
    }


def judged(truth, diagnosis, other=None):
    """Case of a truth and a diagnosis."""
    return Case(truth, verdict_document(diagnosis), diagnosis, other)


def metric(before, after, floor):
    def column(difference):
        return {"value": 40 * (1 + difference), "relative_difference": difference}

    return {"unit": "HU", "recorded": 40.0, "before": column(before), "after": column(after), "floor": floor}


def share(before, after, floor):
    columns = {
        name: {"value": value, "relative_difference": None} for name, value in (("before", before), ("after", after))
    }
    return {"unit": "share", "recorded": None, **columns, "floor": floor}


TRUTHS = [
    truth("case_01", "single", {"scatter": {"amount": 0.05}}, "strong", ["columns", "rows"]),
    truth("case_02", "single", {"focal_spot": {"width_mm": 1.0}}, "medium", ["edges"], "images"),
    truth("case_03", "single", {"heel": {}}, "weak"),
    truth("case_04", "none"),
    truth("case_05", "none", phantom="quality_assurance"),
    truth("case_06", "pair", {"scatter": {"amount": 0.1}, "electronic_noise": {}}),
    truth("case_07", "pair", {"bowtie": {}, "heel": {}}),
    truth("case_08", "unknown", {"!periodic_motion": {}}),
    truth("case_09", "unknown", {"!rotation_blur": {}}),
]
DIAGNOSES = [
    diagnosis("case_01", "mismatch explained", {"scatter": {"amount": (0.052, 0.048, 0.056)}}, removed=0.98),
    diagnosis(
        "case_02",
        "mismatch explained",
        {"xray_crosstalk": {"column": (0.02, 0.01, 0.03)}},
        {"xray_crosstalk": ["focal_spot"]},
        removed=0.9,
        gain=8.0,
    ),
    diagnosis("case_03", "match", p=0.5),
    diagnosis("case_04", "match", p=1.0),
    diagnosis("case_05", "mismatch explained", {"gain_pattern": {}}, removed=0.5, gain=6.0),
    diagnosis(
        "case_06",
        "mismatch explained",
        {"electronic_noise": {"photons": (30.0, 29.0, 31.0)}, "scatter": {"amount": (0.09, 0.085, 0.095)}},
        removed=1.0,
    ),
    diagnosis(
        "case_07",
        "mismatch partly explained",
        {"heel": {"depth_um": (5.0, 3.0, 7.0)}},
        {"heel": ["bowtie"]},
        removed=0.5,
        remainder=6.0,
        sentence="left <b>over</b> & more",
    ),
    diagnosis("case_08", "mismatch partly explained", {"veiling_glare": {}}, ruled_out={"scatter": 40.0}, removed=0.7),
    diagnosis("case_09", "mismatch explained", {"focal_spot": {}}, removed=0.6, remainder=2.0),
]
OTHERS = {
    "case_01": {
        "metrics": {
            "contrast": metric(-0.03, 0.01, 0.004),
            "resolution": metric(-0.2, -0.02, 0.01),
            "features": share(0.4, 0.9, 0.7),
        }
    },
    "case_02": {"metrics": {"contrast": metric(0.05, -0.02, 0.006)}, "left_out": {"resolution": "no edge"}},
}


def write_suite(folder, truths=TRUTHS, diagnoses=DIAGNOSES, others=OTHERS):
    """All files of the test under `folder`; returns the arguments of case.collect."""
    documents = [seal.sealed(truth, SALT) for truth in truths]
    seal.write(seal.publish(documents), folder / "seals.json")
    paths = {"sealed": [], "seals": folder / "seals.json", "verdicts": [], "diagnoses": [], "others": []}
    for document, content in zip(documents, diagnoses, strict=True):
        case = document["case"]
        paths["sealed"].append(folder / "sealed" / f"{case}.json")
        seal.write(document, paths["sealed"][-1])
        paths["diagnoses"].append(folder / "diagnosis" / case / "diagnosis.json")
        write_text(json.dumps(content, indent=2) + "\n", paths["diagnoses"][-1])
        other = folder / "diagnosis" / case / "held_out_protocol.json" if case in others else None
        if other is not None:
            paths["others"].append(other)
            seal.write(others[case], other)
        paths["verdicts"].append(folder / "verdicts" / f"{case}.json")
        verdict = verdict_document(content) | {"files": seal.files_of(paths["diagnoses"][-1], other)}
        seal.write(verdict, paths["verdicts"][-1])
        maps = folder / "diagnosis" / case / "maps"
        maps.mkdir()
        ramp = np.linspace(-8, 8, 30 * 20).reshape(30, 20)
        np.save(maps / "residuals before.npy", ramp)
        np.save(maps / "residuals after.npy", ramp / 8)
    return paths
