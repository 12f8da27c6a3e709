"""Compare the verdict on a subset of a scan's views with the verdict on all views (10 minutes).

Each scan has 360 views and is diagnosed with all of them and with every `--step`-th view. Every fourth scan has no
hidden effect. The others have one effect with a signal-to-noise ratio of 10 to 200 (log-uniform), or as much as its
range allows.
"""

import contextlib
import time

import numpy as np

from benchmarks import common
from benchmarks.common import chain_scans
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import load

WEAKEST, STRONGEST = 10.0, 200.0
GEOMETRY = common.circular_scan(360, 64, 4, 8.0, view_interval_ms=2.5)
SAMPLES = 2
FIELDS = "draw truth stands step chosen equals verdict seconds".split()


def diagnose_subset(task):
    """Rows of one scan: with all views and with every `step`-th view."""
    draw, step = task
    random = np.random.default_rng(np.random.SeedSequence(20261124, spawn_key=(draw,)))
    scene = chain_scans.scene()
    chain = Chain(scene, GEOMETRY, chain_scans.PHOTONS, samples=2 * SAMPLES)
    model, floor = model_and_floor(scene, GEOMETRY, SAMPLES, photons=chain_scans.PHOTONS)
    options = {"floor_chain": floor, "nominal_photons": chain_scans.PHOTONS}
    physics = {}
    if draw % 4:
        target_snr = common.log_uniform(random, WEAKEST, STRONGEST)
        blank = prepared.prepare(chain_scans.scans(chain, {}, random), None, model, **options)
        for name in map(str, random.permutation(chain_scans.LIBRARY)):
            with contextlib.suppress(ValueError):  # too weak within its range
                physics[name] = chain_scans.strengths(name, target_snr, random, blank)
                break
    taken = chain_scans.scans(chain, physics, random)
    rows = []
    for every in (1, step):
        began = time.perf_counter()
        prepared_data = prepared.prepare(taken, None, model, step=every, **options)
        found = choose(prepared_data.whole, trial(prepared_data.whole, ()), chain_scans.LIBRARY)
        content = diagnose("draw", prepared_data, found, found.on_halves(prepared_data)).content
        if every == 1:
            testable = physics and not any(load(name).pattern for name in physics)
            snr = chain_scans.signal_to_noise(prepared_data, physics) if testable else None
        rows.append(
            {
                "draw": draw,
                "truth": "+".join(physics) or "none",
                "stands": "" if snr is None else round(snr, 1),
                "step": every,
                "chosen": "+".join(effect["name"] for effect in content["effects"]) or "none",
                "equals": ";".join("/".join(found.ambiguous_with(name)) for name in found.chosen.fit.effects),
                "verdict": content["verdict"],
                "seconds": round(time.perf_counter() - began, 1),
            }
        )
    return rows


def agree(every, some):
    """Whether the verdicts agree and name the same or indistinguishable effects."""
    if every["verdict"] != some["verdict"]:
        return False
    groups = []
    for row in (every, some):
        named = zip(row["chosen"].split("+"), row["equals"].split(";"), strict=True)
        groups.append([{name, *equals.split("/")} - {""} for name, equals in named])
    return len(groups[0]) == len(groups[1]) and all(a & b for a, b in zip(*groups, strict=True))


def add_arguments(parser):
    common.add_realizations(parser, 40, out="chosen_views.csv")
    parser.add_argument("--step", type=int, default=9, help="distance of the fitted views; an odd number")


def run(options):
    tasks = [(draw, options.step) for draw in range(options.first, options.first + options.draws)]
    same, times = [], {1: [], options.step: []}
    for rows in common.parallel_rows(diagnose_subset, tasks, options, FIELDS):
        same.append(agree(*rows))
        for row in rows:
            times[row["step"]].append(row["seconds"])
        texts = [f"{row['chosen']} [{row['equals']}] {row['verdict']}" for row in rows]
        print(rows[0]["draw"], rows[0]["truth"], rows[0]["stands"], texts, "" if same[-1] else "DIFFER", flush=True)
    medians = ", ".join(f"{np.median(seconds):.1f} s with one view of {step}" for step, seconds in times.items())
    print(f"{sum(same)} of {len(same)} verdicts are the same; median {medians}")
