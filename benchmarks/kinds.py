"""Compare the projector with RTK's on every kind of processor that this machine can emulate (2 minutes).

Each kind has its own process because Numba compiles for one kind only. The engines take turns. Writes kinds.csv.
"""

import json
import tempfile
from pathlib import Path

from benchmarks import common
from benchmarks.common import engines
from virtual_phantom.projectors.processors import available, environment


def measured(repeats):
    """Rows of kind, engine, and times per ray and per voxel and view, in ns.

    The sum of both times is also relative to a full batch of Virtual Phantom with voxel-driven back-projection.
    """
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(available()):
            variables = environment(kind, Path(folder) / f"kernels{number}")
            found = common.run_scenario("kinds", "--one-kind", "--repeats", repeats, **variables)
            rows += [{"kind": kind} | row for row in found]
    return rows


def of_this_process(repeats):
    rows = []
    for scan in (engines.geometry(), engines.helix()):
        contenders = [
            engines.virtual_phantom(lanes, scan, transpose=transpose)
            for transpose in (False, True)
            for lanes in (16, 1)
        ]
        if scan.feed_per_rotation_mm == 0:
            contenders.append(engines.rtk(scan))
        ahead = common.medians([contender.forward for contender in contenders], repeats)
        behind = common.medians([contender.back for contender in contenders], repeats)
        found = [
            {
                "engine": one.name,
                "forward_ns_per_ray": forward / one.rays * 1e9,
                "back_ns_per_voxel_and_view": back / one.voxels_by_views * 1e9,
            }
            for one, forward, back in zip(contenders, ahead, behind, strict=True)
        ]
        rows += [
            row | {"both_over_full_batch": engines.ns_of_a_view(row) / engines.ns_of_a_view(found[0])} for row in found
        ]
    return rows


def add_arguments(parser):
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--one-kind", action="store_true", help="print the rows of this process as JSON")


def run(options):
    if options.one_kind:
        print(json.dumps(of_this_process(options.repeats)))
        return
    common.print_table(options.out / "kinds.csv", measured(options.repeats))
