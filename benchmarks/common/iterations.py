"""Time of 500 SIRT iterations: Virtual Phantom (Chebyshev and plain), RTK (SART, one subset) and ASTRA (2D); memory.

The grid has half the size of the paper's groups (config/paper_groups.yaml) in each direction, with half of the pixels
and 75 views. The times of RTK and ASTRA are extrapolated from a few iterations, ASTRA's from one slice.
"""

from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.common import engines, medians
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction.sirt import sirt

GRID = Grid((24, 64, 64), (4.0, 4.7, 4.7))
SCAN = circular(views=75, columns=80, rows=24, column_pitch_mm=8.0, row_pitch_mm=8.0, **engines.SCANNER)
SETTINGS = defaults_of("reconstruction", "sirt") | {"terms": 60, "tolerance_hu": 0}
ITERATIONS = SETTINGS["iterations"]
LANES = 16
FEW, MORE = 2, 6  # iterations of RTK, whose difference is timed
OF_ASTRA = 50


def compared():
    """Seconds per image of 500 iterations, and the difference of the Chebyshev and the plain image."""
    rows = []
    images = {}
    for lanes in (LANES, 1):
        projector = CpuProjector(SCAN, GRID, lanes)
        volume = np.repeat(engines.phantom(GRID)[None], lanes, 0)
        lines = projector.unpack_projections(projector.forward(projector.pack_volume(volume)))
        noise = np.random.default_rng(np.random.SeedSequence(1)).normal(0, 0.01, lines.shape)
        noisy = lines + noise.astype(np.float32)

        def solve(solver, projector=projector, noisy=noisy, lanes=lanes):
            images[lanes, solver] = sirt(projector, noisy, **(SETTINGS | {"solver": solver}))

        for solver in ("chebyshev", "plain"):
            (seconds,) = medians([lambda solver=solver, solve=solve: solve(solver)], 1)
            rows.append({"solver": f"Virtual Phantom, {solver}, {lanes} at once", "seconds_per_image": seconds / lanes})
    noise_sd = float((images[LANES, "plain"] - images[LANES, "plain"].mean(axis=0)).std())
    off = float((images[LANES, "chebyshev"] - images[LANES, "plain"]).std())
    rows[0]["off_plain_over_noise_sd"] = off / noise_sd
    few, more = medians([lambda: rtk(FEW), lambda: rtk(MORE)], 3)
    rows.append({"solver": "RTK, SART of one subset", "seconds_per_image": (more - few) / (MORE - FEW) * ITERATIONS})
    (astra,) = medians([astra_slice], 3)
    share = GRID.shape[0] * ITERATIONS / OF_ASTRA
    rows.append({"solver": "ASTRA, 2D fan beam, slice by slice", "seconds_per_image": astra * share})
    for row in rows:
        row["over_virtual_phantom"] = row["seconds_per_image"] / rows[0]["seconds_per_image"]
    rows.append(memory())
    return rows


def rtk(iterations):
    import itk
    from itk import RTK

    kind = itk.Image[itk.F, 3]
    there, volume, empty = engines.rtk_parts(SCAN, GRID)
    ahead = RTK.JosephForwardProjectionImageFilter[kind, kind].New()
    ahead.SetInput(0, empty)
    ahead.SetInput(1, volume)
    ahead.SetGeometry(there)
    ahead.Update()
    blank = engines.rtk_image(np.zeros_like(itk.array_from_image(volume)), volume.GetSpacing(), volume.GetOrigin())
    solver = RTK.SARTConeBeamReconstructionFilter[kind, kind].New()
    solver.SetInput(0, blank)
    solver.SetInput(1, ahead.GetOutput())
    solver.SetGeometry(there)
    solver.SetNumberOfIterations(iterations)
    solver.SetNumberOfProjectionsPerSubset(SCAN.views)
    solver.Update()


def astra_slice():
    import astra

    projector, image = engines.astra_parts(SCAN, GRID)
    made, _ = astra.create_sino(image, projector)
    into = astra.data2d.create("-vol", astra.projector.volume_geometry(projector), 0)
    settings = astra.astra_dict("SIRT")
    settings |= {"ProjectorId": projector, "ProjectionDataId": made, "ReconstructionDataId": into}
    solver = astra.algorithm.create(settings)
    astra.algorithm.run(solver, OF_ASTRA)
    astra.algorithm.delete(solver)
    astra.data2d.delete([made, into])


def memory():
    """Additional memory of a Chebyshev reconstruction relative to the arrays that it must hold."""
    with get_context("spawn").Pool(1) as pool:
        needed, array_bytes = pool.apply(_memory)
    return {"solver": "Virtual Phantom, memory", "needed_mib": needed / 2**20, "over_arrays": needed / array_bytes}


def _memory():
    projector = CpuProjector(engines.geometry(64), engines.GRID, LANES)
    small = CpuProjector(engines.geometry(64), Grid((4, 16, 16), (2.0, 2.0, 2.0)), LANES)
    shape = (LANES, 64, engines.DETECTOR["rows"], engines.DETECTOR["columns"])
    sirt(small, np.zeros((LANES, 64, *shape[2:]), np.float32), **(SETTINGS | {"iterations": 2, "terms": 2}))  # compiled
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    before = _peak()
    lines = np.ones(shape, np.float32)
    sirt(projector, lines, **(SETTINGS | {"terms": 3}))
    after = _peak()
    volume, block = projector.empty_volume().nbytes, projector.views_per_block
    packed = projector.pack_projections(lines).nbytes
    array_bytes = lines.nbytes + packed + packed / LANES + 4 * volume + volume / LANES + packed * block / 64
    return after - before, array_bytes


def _peak():
    """Peak memory of this process, bytes."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.split("VmHWM:")[1].split()[0])
