"""Our projector on every kind of processor whose instructions this machine has, RTK beside it.

    python benchmarks/kinds.py --out results/benchmarks        # kinds.csv: what speed.py writes too

Each kind has a process of its own, as numba compiles for one only, in which all engines take turns.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import engines

from virtual_phantom.projectors.processors import available, environment


def measured(repeats):
    """Rows of kind, engine, ns per ray forwards and per voxel and view back, and both over ours in a full batch of the
    same scan, with voxel-driven back-projection."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(available()):
            out = Path(folder) / f"{number}.json"
            command = [sys.executable, __file__, "--one-kind", str(out), "--repeats", str(repeats)]
            variables = environment(kind, Path(folder) / f"kernels{number}")
            subprocess.run(command, check=True, env=os.environ | variables)
            rows += [{"kind": kind} | row for row in json.loads(out.read_text(encoding="utf-8"))]
    return rows


def of_this_process(repeats):
    from speed import medians, of_a_view

    rows = []
    for scan in (engines.geometry(), engines.helix()):
        many, *others = [
            engines.ours(16, scan),
            engines.ours(1, scan),
            engines.ours(16, scan, transpose=True),
            engines.ours(1, scan, transpose=True),
        ]
        if scan.feed_per_rotation_mm == 0:
            others.append(engines.rtk(scan))
        contenders = [many, *others]
        ahead = medians([one.forward for one in contenders], repeats)
        behind = medians([one.back for one in contenders], repeats)
        found = [
            {
                "engine": one.name,
                "forward_ns_per_ray": forward / one.rays * 1e9,
                "back_ns_per_voxel_and_view": back / one.voxels_by_views * 1e9,
            }
            for one, forward, back in zip(contenders, ahead, behind, strict=True)
        ]
        rows += [row | {"both_over_full_batch": of_a_view(row) / of_a_view(found[0])} for row in found]
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--one-kind", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one_kind:
        options.one_kind.write_text(json.dumps(of_this_process(options.repeats)), encoding="utf-8")
        return
    from speed import write

    options.out.mkdir(parents=True, exist_ok=True)
    write(options.out / "kinds.csv", measured(options.repeats))


if __name__ == "__main__":
    main()
