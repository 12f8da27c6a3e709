"""Fit the rates of SIRT at the paper's scale, with voxel-driven back-projection (4 minutes, 9 GB).

Times few Chebyshev steps of config/paper.yaml for several numbers of projections and realizations. They are scaled to
the expected number of steps, which all take the same time, and to all views. Writes the stage
`reconstruct_sirt_voxel` of the library's rates.yaml if --machine is given.
"""

import resource
import time
from dataclasses import replace

import numpy as np

from benchmarks import common
from benchmarks.fit_rates import RATES, fit, write
from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.config.plan import Plan
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction.sirt import SirtUpdate
from virtual_phantom.study.costs.jobs import Job, Sizes, sirt_updates
from virtual_phantom.study.costs.rates import read_rates, seconds

ONE_THREAD = True
STAGE = "reconstruct_sirt_voxel"
# Projections, realizations, views that are timed, factor of the size of voxels and pixels, and iterations.
CASES = (
    *((150, 1, 150, 1, 500), (450, 1, 450, 1, 500), (150, 8, 30, 1, 500), (150, 16, 30, 1, 500)),
    *((150, 1, 150, 2, 500), (60, 1, 60, 2, 20), (60, 1, 60, 1, 20)),
)
STEPS = 3
UNITS = ["ray_step", "ray_step_lane", "image_voxel_term"]
FILES_S = 1.2e-7  # CPU time of reading, noise and writing, per voxel of an image


def timed(call):
    """CPU seconds and result."""
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def sized(config, factor, projections, iterations):
    """The configuration with larger voxels and pixels in the same fields of view, for one number of projections."""
    grid, scan, reconstruction = config.grid, config.scan, config.reconstruction
    return replace(
        config,
        grid=replace(
            grid,
            shape=tuple(size // factor for size in grid.shape),
            spacing_mm=tuple(size * factor for size in grid.spacing_mm),
        ),
        scan=replace(
            scan,
            columns=scan.columns // factor,
            rows=scan.rows // factor,
            column_pitch_mm=scan.column_pitch_mm * factor,
            row_pitch_mm=scan.row_pitch_mm * factor,
        ),
        reconstruction=replace(reconstruction, sirt=replace(reconstruction.sirt, iterations=iterations)),
        protocols={"sirt_150": replace(config.protocols["sirt_150"], projections=projections)},
    )


def measure(config, projections, lanes, views):
    """CPU seconds of a job, and those of single steps."""
    grid = grid_of(config.grid)
    geometry = scan_geometry(config.scan, views, grid)
    projector = CpuProjector(geometry, grid, lanes)
    line = np.ones((1, geometry.views, geometry.rows, geometry.columns), np.float32)
    line_integrals = np.broadcast_to(line, (lanes, *line.shape[1:]))
    shortest_mm = max(grid.spacing)
    SirtUpdate(projector, line_integrals, projector.back, shortest_mm)  # compiles
    weights, update = timed(lambda: SirtUpdate(projector, line_integrals, projector.back, shortest_mm))
    volume = projector.empty_volume()
    update(volume)  # fills memory
    steps = []
    for _ in range(STEPS):
        step, change = timed(lambda volume=volume: update(volume))
        of_volumes, _ = timed(lambda: np.multiply(projector.empty_volume(), update.column_weights))
        volume += change
        further, _ = timed(lambda volume=volume, change=change: volume.__iadd__(change))
        # Five more operations on volumes follow in _chebyshev.
        steps.append((step - of_volumes) * projections / views + of_volumes + 5 * further)
    packing, _ = timed(lambda: projector.unpack_volume(volume))
    weights *= projections / views
    return weights + sirt_updates(config.reconstruction.sirt) * float(
        np.median(steps)
    ) + packing + FILES_S * lanes * np.prod(grid.shape), steps


def add_arguments(parser):
    parser.add_argument("--machine", help="description of the machine for rates.yaml; needed to write it")


def run(options):
    config = common.configuration("config/paper_groups.yaml", "config/paper.yaml")
    jobs = []
    for projections, lanes, views, factor, iterations in CASES:
        case = sized(config, factor, projections, iterations)
        took, steps = measure(case, projections, lanes, views)
        _, work = Sizes(Plan(case), "cpu").reconstruction(["sirt_150"], lanes)
        jobs.append((Job("reconstruct", STAGE, (), work), took))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        listed = ", ".join(f"{step:.1f}" for step in steps)
        sizes = f"{projections} projections, {lanes} realizations, voxels x {factor}"
        print(f"{sizes}: {took:.1f} s; steps {listed} s; {peak:.1f} GiB so far", flush=True)
    rates = fit(jobs, {STAGE: UNITS})[STAGE]
    print(rates)
    for job, took in jobs:
        print(f"measured {took:.0f} s, estimated {seconds(job, {'seconds': {STAGE: rates}}):.0f} s")
    if options.machine:
        whole = read_rates(RATES)
        whole["seconds"][STAGE] = rates
        whole["measured"]["sirt_voxel"] = {
            "machine": options.machine,
            "seconds": [round(float(took), 1) for _, took in jobs],
        }
        write(whole)
