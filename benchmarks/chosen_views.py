"""Whether the verdict on a few of a scan's views is the verdict on all of them.

    python benchmarks/chosen_views.py --draws 40 --first 0 --out chosen_views.csv

Of large scans one view of so many is fitted (`view_step`). Here scans that are small enough are diagnosed twice, with
all of their 360 views and with one of `--step`. Every fourth has nothing concealed, the others one effect, which stands
10 to 200 standard deviations out of the noise of the whole scan beyond what the alignment takes up (log-uniform), or as
far as its plausible range reaches. Object, noise and strengths are made as diagnosis_draws.py makes them.
"""

import argparse
import contextlib
import csv
import os
import time
from concurrent.futures import ProcessPoolExecutor

import diagnosis_draws as draws
import numpy as np

from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections import prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.diagnosis.verdict.verdict import diagnose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, load, names

WEAKEST, STRONGEST = 10.0, 200.0
GEOMETRY = circular(
    views=360,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=64,
    rows=4,
    column_pitch_mm=8.0,
    row_pitch_mm=8.0,
    view_interval_ms=2.5,
)
SAMPLES = 2
LIBRARY = [name for name in names() if not acts_on_images(name)]
FIELDS = "draw truth stands step chosen equals verdict seconds".split()


def one(task):
    """The rows of a scan, with all views and with one of some."""
    draw, step = task
    random = np.random.default_rng(np.random.SeedSequence(20261124, spawn_key=(draw,)))
    scene = draws.scene()
    chain = Chain(scene, GEOMETRY, draws.PHOTONS, samples=2 * SAMPLES)
    model, floor = model_and_floor(scene, GEOMETRY, SAMPLES, photons=draws.PHOTONS)
    options = {"floor_chain": floor, "nominal_photons": draws.PHOTONS}
    physics = {}
    if draw % 4:
        wanted = float(np.exp(random.uniform(np.log(WEAKEST), np.log(STRONGEST))))
        blank = prepared.prepare(draws.scans(chain, {}, random), None, model, **options)
        for name in map(str, random.permutation(LIBRARY)):
            with contextlib.suppress(ValueError):  # it stands nowhere in its range out of this noise
                physics[name] = draws.strengths(name, wanted, random, blank)
                break
    taken = draws.scans(chain, physics, random)
    rows = []
    for every in (1, step):
        began = time.perf_counter()
        given = prepared.prepare(taken, None, model, step=every, **options)
        found = choose(given.fitter, trial(given.fitter, ()), LIBRARY)
        content = diagnose("draw", given, found).content
        if every == 1:
            told = physics and not any(load(name).pattern for name in physics)
            stands = draws.stands_out(given, physics) if told else None
        rows.append(
            {
                "draw": draw,
                "truth": "+".join(physics) or "none",
                "stands": "" if stands is None else round(stands, 1),
                "step": every,
                "chosen": "+".join(effect["name"] for effect in content["effects"]) or "none",
                "equals": ";".join("/".join(found.ambiguous_with(name)) for name in found.chosen.fit.effects),
                "verdict": content["verdict"],
                "seconds": round(time.perf_counter() - began, 1),
            }
        )
    return rows


def alike(every, some):
    """Whether both name the same effects, or one of them the other's equals, with the same verdict."""
    if every["verdict"] != some["verdict"]:
        return False
    groups = []
    for row in (every, some):
        named = zip(row["chosen"].split("+"), row["equals"].split(";"), strict=True)
        groups.append([{name, *equals.split("/")} - {""} for name, equals in named])
    return len(groups[0]) == len(groups[1]) and all(a & b for a, b in zip(*groups, strict=True))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=int, default=9, help="one view of so many; odd")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--out", default="chosen_views.csv")
    options = parser.parse_args()
    tasks = [(draw, options.step) for draw in range(options.first, options.first + options.draws)]
    same, times = [], {1: [], options.step: []}
    with ProcessPoolExecutor(options.processes) as pool, open(options.out, "w", newline="") as file:
        writer = csv.DictWriter(file, FIELDS)
        writer.writeheader()
        for rows in pool.map(one, tasks):
            writer.writerows(rows)
            file.flush()
            same.append(alike(*rows))
            for row in rows:
                times[row["step"]].append(row["seconds"])
            said = [f"{row['chosen']} [{row['equals']}] {row['verdict']}" for row in rows]
            print(rows[0]["draw"], rows[0]["truth"], rows[0]["stands"], said, "" if same[-1] else "DIFFER", flush=True)
    medians = ", ".join(f"{np.median(seconds):.1f} s with one view of {step}" for step, seconds in times.items())
    print(f"{sum(same)} of {len(same)} verdicts are the same; median {medians}")


if __name__ == "__main__":
    main()
