"""Diagnose a cone-beam CT of a Catphan 504, module CTP404, with time and memory (5 minutes).

The folder RECORDING is made from the demonstration scan of pylinac 1.2.0 (64 slices of 512 x 512) by
`virtual-phantom-import dicom`. Prints the verdict, the share of the excess removed on slices that were not fitted, CPU
time and memory.
"""

import resource
import time
from pathlib import Path

import virtual_phantom as vp

SLICES = [28, 36]  # of CTP404, from the lowest z
GIGABYTE = 1e6  # in the unit of ru_maxrss


def add_arguments(parser):
    parser.add_argument("recording", type=Path)
    parser.add_argument("--effects", nargs="+", help="effects to try (default: all)")
    parser.add_argument("--object", default="catphan504_ctp404", help="object of shapes")
    parser.add_argument("--slices", nargs=2, type=int, default=SLICES, help="first and last slice that show it")
    parser.add_argument("--processes", type=int, default=2)


def run(options):
    begin = time.time()
    found = vp.diagnose(
        options.recording,
        shapes=options.object,
        slices=options.slices,
        effects=options.effects,
        processes=options.processes,
    ).content
    print(f"{found['verdict']}\n" + "\n".join(found["verdict_lines"]))
    removed = found["excess_rms_removed"]
    if removed is not None:
        print(f"excess RMS removed on slices that were not fitted: {100 * removed:.1f} %")
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu = sum(one.ru_utime + one.ru_stime for one in used)
    memory = [one.ru_maxrss / GIGABYTE for one in used]
    print(
        f"{time.time() - begin:.0f} s, CPU time {cpu:.0f} s, memory {memory[0]:.2f} GB; parallel processes at most "
        f"{memory[1]:.2f} GB each"
    )
