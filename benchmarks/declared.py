"""One effect concealed beside seven that are declared, by the proof's simulator; and nothing concealed beside them.

    python benchmarks/declared.py --seed 96 --draws 40 --none 20 --out declared.jsonl

Scans as lacking.py has them. The concealed effects come in turn from all that the proof conceals, medium or strong by
chance. The declared ones are drawn from those whose every parameter has one meaning in simulator and library, of medium
strength; each parameter is stated with an error of 5 % of its value (standard deviation). Cases that the file has
already are not done again.
"""

import argparse
import tempfile
import time
from pathlib import Path

import lacking

from virtual_phantom.base.streams import branch, generator
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.physics.effect import load
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.objects import OBJECTS
from virtual_phantom.proof.hiding.suite import KNOWN

STATED = 0.05  # of a parameter: standard deviation of its statement
DECLARED = 7
PHANTOMS = tuple(OBJECTS)
ORDER, TRUTH = range(2)  # branches of the seed
LEFT_OUT = ("view_blur",)  # of what is declared: each view would be traced several times in every fit


def statable() -> list[str]:
    """Effects of which the simulator knows every parameter that the library has."""
    found = []
    for name in KNOWN:
        effect = load(name)
        _, comparable = CATALOGUE[name].draw("medium", generator(branch(0, TRUTH)))
        if name not in LEFT_OUT and not effect.pattern and {one.name for one in effect.parameters} <= set(comparable):
            found.append(name)
    return found


def stated(comparable: dict, random) -> dict[str, dict[str, float]]:
    """What somebody states who knows every parameter to 5 %."""
    return {
        key: {"value": float(random.normal(value, STATED * abs(value))), "sd": STATED * abs(value)}
        for key, value in comparable.items()
    }


def of_catalogue(name: str, strength: str, random) -> dict:
    """An effect of that strength, as a case's truth has it."""
    settings, comparable = CATALOGUE[name].draw(strength, random)
    return {"name": str(name), "strength": strength, "settings": settings, "comparable": comparable}


def drawn(number: int, draws: int, seed: int) -> tuple[dict, dict]:
    """A case's truth, and what is declared; from number `draws` on nothing is concealed."""
    random = generator(branch(seed, TRUTH, number))
    order = generator(branch(seed, ORDER)).permutation(len(KNOWN))
    hidden = KNOWN[order[number % len(KNOWN)]] if number < draws else None
    effects, baseline = [], {}
    if hidden:
        effects.append(of_catalogue(hidden, str(random.choice(["medium", "strong"])), random))
    others = [name for name in statable() if name != hidden]
    for name in random.choice(others, DECLARED, replace=False):
        effects.append(of_catalogue(name, "medium", random))
        baseline[str(name)] = stated(effects[-1]["comparable"], random)
    truth = {"case": f"case_{number:02d}", "number": number, "phantom": PHANTOMS[number % 2], "effects": effects}
    return truth | {"concealed": hidden}, baseline


def diagnosed(folder: Path, truth: dict, baseline: dict, config: dict, seed: int) -> dict:
    """What is said of a case."""
    model = lacking.recorded(folder, truth, config, seed, baseline)
    request = DiagnosisRequest.of(model, str(folder / "image.nii.gz"), 1)
    tried = candidates(model["settings"])
    began = time.process_time()
    found = run_diagnosis(request, tried, config["diagnosis"]["model_accuracy"], images=False)
    said = found.content
    return {
        "concealed": truth["concealed"],
        "strength": truth["effects"][0]["strength"] if truth["concealed"] else None,
        "declared": list(baseline),
        "effects": [one["name"] for one in said["effects"]],
        "equals": said["ambiguous_with"].get(said["effects"][0]["name"], []) if said["effects"] else [],
        "off": [f"{name}.{key}" for name, one in said["declared"].items() for key, two in one.items() if two["off"]],
        "verdict": said["verdict"],
        "sentence": said["sentence"],
        "seconds": time.process_time() - began,
    }


def counted(rows: list[dict]) -> None:
    """Print how many were named first, and false alarms."""
    single = [row for row in rows if row["concealed"]]
    none = [row for row in rows if not row["concealed"]]
    first = sum(row["effects"][:1] == [row["concealed"]] for row in single)
    equal = sum(row["concealed"] in [*row["effects"][:1], *row["equals"]] for row in single)
    alone = sum(row["effects"] == [row["concealed"]] for row in single)
    print(f"named first: {first} of {len(single)}; first or as its equal: {equal}; and nothing beside it: {alone}")
    print(f"nothing concealed, and an effect named: {sum(bool(row['effects']) for row in none)} of {len(none)}")
    print(f"a statement called off: {sum(bool(row['off']) for row in rows)} of {len(rows)}")


def main() -> None:
    """Scan, diagnose and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--none", type=int, default=20)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    config = lacking.default_config()
    rows = lacking.rows_of(options.out)
    done = {row["number"] for row in rows}
    for number in range(options.draws + options.none):
        if number in done:
            continue
        truth, baseline = drawn(number, options.draws, options.seed)
        with tempfile.TemporaryDirectory() as folder:
            rows.append({"number": number} | diagnosed(Path(folder), truth, baseline, config, options.seed))
        lacking.append(options.out, rows[-1])
        one = rows[-1]
        print(f"{number} {one['concealed'] or 'nothing'}: {one['sentence']} [{one['seconds']:.0f} s]", flush=True)
    counted(rows)


if __name__ == "__main__":
    main()
