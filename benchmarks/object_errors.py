"""Count how often a diagnosis distinguishes a local object mismatch from missing physics (30 minutes).

The scanned body differs from the model by a missing insert, a bubble or dense ball, another material, a displaced
insert or a rod. In every fourth scan the object is correct and one effect is missing. The library's chain simulates the
scans with three times as many rays per pixel and direction as the model. The column `diagnosis` has its result.
"""

import time
from itertools import cycle, islice

import numpy as np

from benchmarks import common
from benchmarks.common import chain_scans
from benchmarks.common.chain_scans import INSERTS, LIBRARY, ROD, body
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid

SAMPLES, FINER = 4, 3
KINDS = ("missing", "bubble", "denser", "material", "displaced", "rod")
FIELDS = (
    "draw kind truth diagnosis verdict place_off_mm width_mm hu removes mended_verdict mended_effects seconds".split()
)


def place(random):
    """Random location in the body, away from its inserts."""
    while True:
        x, y = random.uniform(-80, 80), random.uniform(-55, 55)
        near = [np.hypot(x - at[0], y - at[1]) - radius for at, radius in INSERTS.values()]
        if (x / 95) ** 2 + (y / 65) ** 2 < 1 and min(*near, np.hypot(x - ROD[0][0], y - ROD[0][1]) - ROD[1]) > 12:
            return np.array([x, y, random.uniform(-8, 8)])


def changed(kind, random):
    """Scanned shapes, and description and location of the mismatch."""
    if kind == "missing":
        name = str(random.choice(list(INSERTS)))
        return body(**{name: None}), f"{name} is missing", np.array(INSERTS[name][0])
    if kind in ("bubble", "denser"):
        at, radius = place(random), random.uniform(2, 6)
        material = "nothing" if kind == "bubble" else str(random.choice(["pmma", "bone"]))
        return body(more=ellipsoid(material, at, [radius] * 3)), f"{material}, {2 * radius:.1f} mm wide", at
    if kind == "material":
        at, radius = INSERTS["adipose"]
        return body(adipose=ellipsoid("water", at, [radius] * 3)), "water for adipose", np.array(at)
    if kind == "displaced":
        at, radius = INSERTS["adipose"]
        angle, by = random.uniform(0, 2 * np.pi), random.uniform(2, 6)
        there = np.array(at) + by * np.array([np.cos(angle), np.sin(angle), 0])
        return body(adipose=ellipsoid("adipose", there, [radius] * 3)), f"adipose {by:.1f} mm off", np.array(at)
    at, radius = place(random), random.uniform(2, 6)
    return body(more=cylinder("pmma", at, radius)), f"rod of pmma, {2 * radius:.1f} mm wide", at


def diagnose_scan(task):
    draw, kind = task
    random = np.random.default_rng(np.random.SeedSequence(20261125, spawn_key=(draw,)))
    accuracy = defaults_of("diagnosis", "model_accuracy")

    def prepare_scans(scans):
        return chain_scans.prepared_with_floor(scans, chain_scans.shapes_scene(), chain_scans.GEOMETRY, SAMPLES)

    physics, at = {}, None
    if kind == "physics":
        shapes = body()
        blank = prepare_scans(
            chain_scans.scans(Chain(ShapesScene(shapes), chain_scans.GEOMETRY, chain_scans.PHOTONS), {}, random)
        )
        target_snr = common.log_uniform(random, 15.0, 150.0)
        truth = str(random.choice([name for name in LIBRARY if name != "gain_pattern"]))
        physics = {truth: chain_scans.strengths(truth, target_snr, random, blank)}
    else:
        shapes, truth, at = changed(kind, random)
    scanned = Chain(ShapesScene(shapes), chain_scans.GEOMETRY, chain_scans.PHOTONS, samples=FINER * SAMPLES)
    scans = chain_scans.scans(scanned, physics, random)
    began = time.perf_counter()
    content = find_missing_physics("draw", prepare_scans(scans), LIBRARY, accuracy).content
    row = {"draw": draw, "kind": kind, "truth": truth, "verdict": content["verdict"]}
    row |= {"diagnosis": "+".join(effect["name"] for effect in content["effects"]) or "none"}
    row["seconds"] = round(time.perf_counter() - began, 1)
    if "object" in content:
        piece = content["object"]["pieces"][0]
        row |= {"diagnosis": "object", "removes": round(content["object"]["removes"], 3), "hu": round(piece["hu"])}
        row["width_mm"] = round(piece["width_mm"], 1)
        if at is not None:
            axes = 2 if piece["z_mm"] is None else 3
            found = np.array([piece["x_mm"], piece["y_mm"], piece["z_mm"] or 0.0])
            row["place_off_mm"] = round(float(np.linalg.norm((found - at)[:axes])), 1)
        mended = find_missing_physics("draw", prepare_scans(scans), LIBRARY, accuracy, object_may_differ=True).content
        row |= {"mended_verdict": mended["verdict"]}
        row["mended_effects"] = "+".join(effect["name"] for effect in mended["effects"]) or "none"
    return [row]


def add_arguments(parser):
    common.add_realizations(parser, 40, out="object_errors.csv")


def run(options):
    order = islice(cycle([*KINDS[:3], "physics", *KINDS[3:], "physics"]), options.first + options.draws)
    tasks = [*enumerate(order)][options.first :]
    rows = []
    for (row,) in common.parallel_rows(diagnose_scan, tasks, options, FIELDS):
        rows.append(row)
        print(row, flush=True)
    objects = [row for row in rows if row["kind"] != "physics"]
    found = sum(row["diagnosis"] == "object" for row in objects)
    false = sum(row["diagnosis"] == "object" for row in rows if row["kind"] == "physics")
    print(
        f"mismatch reported in {found} of {len(objects)}; "
        f"physics reported as mismatch in {false} of {len(rows) - len(objects)}"
    )
    seconds = [row["seconds"] for row in objects]
    off = max(
        (row["place_off_mm"] for row in objects if row["kind"] != "displaced" and "place_off_mm" in row), default=0
    )
    print(f"in {np.median(seconds):.1f} s (median; {max(seconds):.0f} at most)")
    print(f"location error, without displaced inserts: at most {off:.1f} mm")
    mended = [row for row in objects if row["diagnosis"] == "object"]
    match = sum(row["mended_verdict"] == "match" for row in mended)
    named = sum(row["mended_effects"] != "none" for row in mended)
    print(f"with the object mended: a match in {match} of {len(mended)}, effects named in {named}")
