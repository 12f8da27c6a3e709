"""Count how often the diagnosis finds one hidden effect beside seven declared ones (30 minutes).

The scans come from the simulator of the blind validation. The hidden effects take turns and are of medium or strong
size. The declared effects are of medium size; each parameter is declared with an error of 5 % (standard deviation).
Cases in the output file are not repeated.
"""

from pathlib import Path

from benchmarks import common
from benchmarks.common import simulator_scans
from benchmarks.common.tuning_objects import OBJECTS
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.proof.hiding.suite import KNOWN

STATED = 0.05  # relative SD of a declared parameter
DECLARED = 7
PHANTOMS = tuple(OBJECTS)


def stated(comparable: dict, random) -> dict[str, dict[str, float]]:
    """Declared values with a relative SD of STATED."""
    return {
        key: {"value": float(random.normal(value, STATED * abs(value))), "sd": STATED * abs(value)}
        for key, value in comparable.items()
    }


def drawn(number: int, draws: int, seed: int) -> tuple[dict, dict]:
    """Truth and declared physics of a case; cases from `draws` on have no hidden effect."""
    random = generator(branch(seed, simulator_scans.TRUTH, number))
    order = generator(branch(seed, simulator_scans.ORDER)).permutation(len(KNOWN))
    hidden = KNOWN[order[number % len(KNOWN)]] if number < draws else None
    effects, baseline = [], {}
    if hidden:
        effects.append(simulator_scans.of_catalogue(hidden, str(random.choice(["medium", "strong"])), random))
    others = [name for name in simulator_scans.declarable_effects() if name != hidden]
    for name in random.choice(others, DECLARED, replace=False):
        effects.append(simulator_scans.of_catalogue(name, "medium", random))
        baseline[str(name)] = stated(effects[-1]["comparable"], random)
    truth = {"case": f"case_{number:02d}", "number": number, "phantom": PHANTOMS[number % 2], "effects": effects}
    return truth | {"hidden": hidden}, baseline


def diagnosed(truth: dict, baseline: dict, config: dict, seed: int) -> dict:
    content, seconds = simulator_scans.diagnosed(truth, config, seed, baseline=baseline)
    return {
        "hidden": truth["hidden"],
        "strength": truth["effects"][0]["strength"] if truth["hidden"] else None,
        "declared": list(baseline),
        "effects": [effect["name"] for effect in content["effects"]],
        "equals": content["ambiguous_with"].get(content["effects"][0]["name"], []) if content["effects"] else [],
        "off": [f"{name}.{key}" for name, one in content["declared"].items() for key, two in one.items() if two["off"]],
        "verdict": content["verdict"],
        "sentence": content["sentence"],
        "seconds": seconds,
    }


def counted(rows: list[dict]) -> None:
    single = [row for row in rows if row["hidden"]]
    none = [row for row in rows if not row["hidden"]]
    first = sum(row["effects"][:1] == [row["hidden"]] for row in single)
    equal = sum(row["hidden"] in [*row["effects"][:1], *row["equals"]] for row in single)
    alone = sum(row["effects"] == [row["hidden"]] for row in single)
    print(f"named first: {first} of {len(single)}; first or as its equal: {equal}; and nothing beside it: {alone}")
    print(f"no hidden effect, and an effect named: {sum(bool(row['effects']) for row in none)} of {len(none)}")
    print(f"a declared value reported as inconsistent: {sum(bool(row['off']) for row in rows)} of {len(rows)}")


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--none", type=int, default=20)
    parser.add_argument("--out", type=Path, required=True)


def run(options):
    config = common.configuration()
    rows = common.read_jsonl(options.out)
    done = {row["number"] for row in rows}
    for number in range(options.draws + options.none):
        if number in done:
            continue
        truth, baseline = drawn(number, options.draws, options.seed)
        rows.append({"number": number} | diagnosed(truth, baseline, config, options.seed))
        common.append_jsonl(options.out, rows[-1])
        one = rows[-1]
        print(f"{number} {one['hidden'] or 'nothing'}: {one['sentence']} [{one['seconds']:.0f} s]", flush=True)
    counted(rows)
