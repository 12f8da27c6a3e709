"""Compare the projectors and SIRT with other packages, and measure how costs scale (4 minutes).

First run `pip install -r benchmarks/requirements.txt`. Writes projectors.csv, bandwidth.csv, sirt.csv, growth.csv
and speed.png. Times are medians of CPU time with one thread; the engines take turns.
"""

import os
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

from benchmarks import common
from benchmarks.common import engines, growth, iterations

ONE_THREAD = True


def projectors(repeats):
    """Times per ray, and per voxel and view, also relative to a full batch; difference of the projections."""
    scan, helix = engines.geometry(), engines.helix()
    pairs = [(where, transpose) for where in (scan, helix) for transpose in (False, True)]
    contenders = [
        engines.virtual_phantom(lanes, where, transpose=transpose) for where, transpose in pairs for lanes in (1, 16)
    ]
    contenders += [engines.rtk(scan), engines.rtk(scan, transpose=True), engines.astra_fan(scan)]
    forward = common.medians([contender.forward for contender in contenders], repeats)
    back = common.medians([contender.back for contender in contenders], repeats)
    reference = contenders[0].projected
    rows = []
    for one, ahead, behind in zip(contenders, forward, back, strict=True):
        row = {"engine": one.name, "forward_ns_per_ray": ahead / one.rays * 1e9}
        row["back_ns_per_voxel_and_view"] = behind / one.voxels_by_views * 1e9
        if one.projected is not None:
            row["difference"] = float(np.sqrt(np.mean((one.projected - reference) ** 2)) / reference.max())
        rows.append(row)
    for row in rows:
        batch = (
            "Virtual Phantom, 16 at once, helix" if row["engine"].endswith("helix") else "Virtual Phantom, 16 at once"
        )
        row["both_over_full_batch"] = engines.ns_of_a_view(row) / engines.ns_of_a_view(
            next(row for row in rows if row["engine"] == batch)
        )
    rows.append(
        {"engine": "XCIST, distance-driven", "forward_ns_per_ray": engines.xcist_ns_per_ray(scan, engines.GRID)}
    )
    return rows


# Cache lines that a sample of 16 lanes needs: two are read (the previous sample has read the neighbors along the line),
# and one is read and written.
LINES, LINE_BYTES = 4, 64
TILE_KIB = 800  # working set of a full batch (projectors/kernels.py)


def bound():
    """Lower limit of the time per sample in a full batch from the bandwidth of the caches."""
    rates = {
        f"{kib} KiB": float(np.median([engines.cache_bytes_per_ns(kib) for _ in range(5)]))
        for kib in (24, TILE_KIB, 8192)
    }
    rows = [{"working_set": name, "bytes_per_ns": rate} for name, rate in rates.items()]
    for row in rows:
        row["ns_per_sample_of_a_lane"] = LINES * LINE_BYTES / row["bytes_per_ns"] / 16
    return rows


def draw(path, rows, grown):
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    shown = [row for row in rows if "back_ns_per_voxel_and_view" in row]
    places = np.arange(len(shown))
    left.plot([row["forward_ns_per_ray"] for row in shown], places, "o", label="forward, ns per ray")
    left.plot([row["back_ns_per_voxel_and_view"] for row in shown], places, "s", label="back, ns per voxel and view")
    left.set_yticks(places, [row["engine"] for row in shown])
    left.set_xscale("log")
    left.set_xlabel("CPU time per realization, ns")
    left.invert_yaxis()
    left.grid(axis="x", alpha=0.3)
    for name in dict.fromkeys(row["of"] for row in grown):
        points = [(row["size"], row["seconds"]) for row in grown if row["of"] == name]
        sizes, seconds = np.array(points).T
        exponent = next(row["exponent"] for row in grown if row["of"] == name)
        right.loglog(sizes / sizes[0], seconds / seconds[0], "o-", ms=3, label=f"{name}, exponent {exponent:.2f}")
    right.set(xlabel="size over the smallest", ylabel="time over the shortest")
    for axis in (left.xaxis, right.xaxis, right.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")
    for axes in (left, right):
        axes.legend(frameon=False, fontsize="small", loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    figure.savefig(path, dpi=150)


def add_arguments(parser):
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    parser.add_argument("--repeats", type=int, default=7)


def run(options):
    matplotlib.use("Agg")
    print(f"{engines.machine()}; load of the last minute {os.getloadavg()[0]:.1f}")
    compared = projectors(options.repeats)
    common.print_table(options.out / "projectors.csv", compared)
    common.print_table(options.out / "bandwidth.csv", bound())
    common.print_table(options.out / "sirt.csv", iterations.compared())
    grown = growth.measured(options.repeats)
    common.print_table(options.out / "growth.csv", grown)
    draw(options.out / "speed.png", compared, grown)
