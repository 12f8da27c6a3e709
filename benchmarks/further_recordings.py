"""Count how often a second recording resolves an ambiguous diagnosis (minutes).

A scan of a water disc has one effect of a group of similar effects. Candidates for the second scan are ranked as by
`snakemake next_measurement`. The best and the worst are simulated, and both scans together choose among the ambiguous
effects by the held-out log score. The library's chain simulates the scans, with three times as many rays per pixel and
direction as the model. The ranking omits dark frames.
"""

import time
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import chain_scans
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.planning.measurement import FurtherScan
from virtual_phantom.diagnosis.planning.ranking import possible, rank, refit
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.diagnosis.projections.prepared import prepare
from virtual_phantom.diagnosis.selection.forward_selection import choose
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, cylinder

SAMPLES, FINER = 2, 3
DISC_MM, OFF_AXIS_MM = 160.0, 45.0
GEOMETRY = common.circular_scan(60, 64, 4, 8.0, view_interval_ms=10.0)
GROUPS = {
    "place": ("detector_offset", "centre_of_rotation"),
    "blur": ("focal_spot", "xray_crosstalk", "optical_crosstalk"),
    "turn": ("afterglow", "view_blur"),
    "haze": ("dark_signal", "veiling_glare", "scatter"),
}
FIELDS = "group draw truth alone ambiguous first first_right last last_right seconds".split()


def drawn(name, random, air):
    """Parameters of medium strength as in the blind validation; the focal spot has strong ones."""

    def between(low, high):
        return common.log_uniform(random, low, high)

    sign = float(random.choice([-1, 1]))
    if name == "focal_spot":
        width = between(3.0, 3.8)
        return {"width_mm": width, "length_mm": width * between(0.6, 1)}
    if name in ("xray_crosstalk", "optical_crosstalk"):
        column = between(0.02, 0.04)
        return {"column": column, "row": column * between(0.5, 1)}
    return {
        "detector_offset": lambda: {"columns_px": sign * between(0.1, 0.2)},
        "centre_of_rotation": lambda: {"shift_mm": sign * between(0.15, 0.3)},
        "afterglow": lambda: {"share": between(0.02, 0.04), "time_constant_ms": between(6, 14), "before": 0.0},
        "view_blur": lambda: {"duty": between(0.5, 0.6)},
        "dark_signal": lambda: {"level_units": between(1e-3, 2e-3) * air, "drift_units_per_s": 0.0},
        "veiling_glare": lambda: {"share": between(0.01, 0.02), "width_mm": between(30, 60), "beyond": 0.0},
        "scatter": lambda: {"amount": between(0.03, 0.1), "width_mm": between(40, 80)},
    }[name]()


def scanned(group):
    """Object of a group's first scan; centered, it would not show a rotation."""
    if group != "turn":
        return DiscScene(DISC_MM, "water")
    return ShapesScene([cylinder("water", (OFF_AXIS_MM, 0.0, 0.0), DISC_MM / 2)])


def prepare_scan(scan, like, physics, random):
    """Simulate and prepare a scan with a small random shift of the object."""
    stated = scan.chain(like)
    model, floor = model_and_floor(
        scan.scene,
        scan.geometry,
        like.samples,
        photons=stated.photons,
        illumination=stated.illumination,
        sensor=stated.sensor,
        readout=stated.readout,
    )
    place = Pose(x_mm=float(random.normal(0, 0.3)), y_mm=float(random.normal(0, 0.3)))
    taken = chain_scans.scans(stated.copy(samples=FINER * like.samples), physics, random, place)
    return prepare(taken, None, model, floor_chain=floor, nominal_photons=model.photons, known=dict(scan.known))


def settled(prepared, further, group):
    """Effect of the group that both recordings together support."""
    together = JointFitter({"first": prepared.fitter, "further": further.fitter})
    shared_fit = together.fit(())
    scores = {}
    for name in group:
        fits = together.fit((name,), shared_fit).fits
        scores[name] = sum(one.score(fits[key]) for key, one in together.fitters.items())
    return max(scores, key=scores.get)


def compare_choices(group, draw):
    """Row of one realization: the choice with one scan and with two."""
    began, effects = time.perf_counter(), GROUPS[group]
    random = np.random.default_rng(np.random.SeedSequence(20261125, spawn_key=(list(GROUPS).index(group), draw)))
    truth = effects[draw % len(effects)]
    like = Chain(scanned(group), GEOMETRY, chain_scans.PHOTONS, SAMPLES)
    physics = {truth: drawn(truth, random, like.air_reading)}
    first = FurtherScan("first", "", like.scene, GEOMETRY)
    prepared = prepare_scan(first, like, physics, random)
    found = choose(prepared.whole, trial(prepared.whole, ()), list(effects))
    row = {"group": group, "draw": draw, "truth": truth, "alone": "", "ambiguous": ""}
    if not found.chosen.fit.effects:
        return row | {"seconds": round(time.perf_counter() - began)}
    named = found.chosen.fit.effects[0]
    ambiguous = found.ambiguous_with(named)
    row |= {"alone": named, "ambiguous": "/".join(ambiguous)}
    if ambiguous:
        chosen, ambiguities = refit(prepared, "first", {named: ambiguous})
        scans = [one for one in possible({"first": prepared}) if isinstance(one, FurtherScan)]
        ranked = rank({"first": prepared}, chosen, ambiguities, scans).ranked
        for place, which in ((0, "first"), (-1, "last")):
            scan = ranked[place].measurement
            further = prepare_scan(scan, like, physics, random)
            row |= {which: scan.name, f"{which}_right": settled(prepared, further, [named, *ambiguous]) == truth}
    return row | {"seconds": round(time.perf_counter() - began)}


def right_alone(row):
    return not row["ambiguous"] and row["alone"] == row["truth"]


def counted(rows):
    for group in GROUPS:
        of = [row for row in rows if row["group"] == group]
        open_ = [row for row in of if row["ambiguous"]]
        alone = sum(right_alone(row) for row in of)
        first, last = (sum(str(row[key]) == "True" for row in open_) for key in ("first_right", "last_right"))
        print(
            f"{group}: {len(of)} draws; identified by one scan {alone}; ambiguous {len(open_)}: right with the scan "
            f"ranked first {first}, with the last {last}; right at last {alone + first} of {len(of)}"
        )


def add_arguments(parser):
    parser.add_argument("--groups", nargs="*", default=list(GROUPS))
    common.add_realizations(parser, 10, 100)
    parser.add_argument("--out", type=Path, required=True, help="CSV; realizations in it are not repeated")


def run(options):
    rows = common.read_csv_rows(options.out)
    done = {(row["group"], int(row["draw"])) for row in rows}
    with common.csv_writer(options.out, FIELDS, append=True) as write:
        for draw in range(options.first, options.first + options.draws):
            for group in options.groups:
                if (group, draw) in done:
                    continue
                rows.append(dict.fromkeys(FIELDS, "") | compare_choices(group, draw))
                write(rows[-1])
                print(rows[-1], flush=True)
    counted(rows)
