"""Count how often a diagnosis reports effects that the library does not model as unexplained (1 hour).

The simulator of the blind validation makes small scans: 64 columns x 4 rows x 36 views, 4 repeats of 1e5 photons per
pixel. Cases in the output file are not repeated.
"""

from pathlib import Path

from benchmarks import common
from benchmarks.common import simulator_scans
from virtual_phantom.proof.hiding.case import Case
from virtual_phantom.proof.scoring.remainders import summary
from virtual_phantom.proof.scoring.verdicts import verdict_document

KEPT = "recording verdict sentence effects ambiguous_with remainder_sd excess_removed outside unexplained".split()


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    simulator_scans.add_draws(parser, ["medium"], none=0, pairs=0, unknown=14)
    parser.set_defaults(effects=[])
    parser.add_argument("--out", type=Path, required=True)


def run(options):
    config = common.configuration()
    rows = common.read_jsonl(options.out)
    for case, truth in simulator_scans.left_to_do(options, rows).items():
        content, seconds = simulator_scans.diagnosed(truth, config, options.seed)
        rows.append({"truth": truth, "diagnosis": {key: content[key] for key in KEPT}, "seconds": seconds})
        common.append_jsonl(options.out, rows[-1])
        hidden = ", ".join(f"{effect['name']} ({effect['strength']})" for effect in truth["effects"]) or "nothing"
        print(f"{case} {hidden}: {content['sentence']} [{seconds:.0f} s]", flush=True)
    cases = [Case(row["truth"], verdict_document(row["diagnosis"]), row["diagnosis"]) for row in rows]
    found = summary(cases)
    for name, one in found["by_kind"].items():
        print(f"{name}: reported as unexplained: {one['count']} of {one['n']}")
    categories = ("single", "none", "unknown", "pair")
    singles, blank, unknown, pairs = ([case for case in cases if case.category == category] for category in categories)
    reported = sum(case.reported_unexplained for case in unknown)
    print(f"reported as unexplained: {reported} of {len(unknown)}; area {found['area']}")
    print(f"single effects ranked first: {sum(case.first_right for case in singles)} of {len(singles)}")
    both, alone = (sum(getattr(case, way) for case in pairs) for way in ("all_named", "exact"))
    print(f"both effects of a pair named: {both} of {len(pairs)}, without others: {alone}")
    print(f"false alarms: {sum(not case.right for case in blank)} of {len(blank)}")
