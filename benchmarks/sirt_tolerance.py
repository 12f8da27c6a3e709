"""Compare SIRT that stops by its tolerance with 60 Chebyshev terms and with the image of all terms (3 minutes).

Scans have the geometry and noise of config/paper_groups.yaml. One object is inside the grid, one crosses its ends along
z, and one also crosses its sides. Prints CPU time, the share of voxels beyond the tolerance, and the RMS difference in
the middle and in the whole grid.
"""

import time

import numpy as np

from benchmarks import common
from virtual_phantom.base.geometry import Grid, grid_of, scan_geometry
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction.sirt import sirt

ONE_THREAD = True
MARGIN = (24, 64, 64)  # voxels by which the grid of the scanned objects is larger
MIDDLE_MM = (30, 80)  # half height and radius
ALL_TERMS = 120


def objects(grid):
    """{name: object in 1/mm} with a texture."""
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij", sparse=True)
    texture = 1 + 0.05 * np.random.default_rng(1).standard_normal(grid.shape)
    body = (x / 130) ** 2 + (y / 100) ** 2
    shapes = {"inside": body + (z / 40) ** 2, "leaves along z": body, "leaves along x": (x / 170) ** 2 + (y / 120) ** 2}
    rod = (x - 40) ** 2 + (y - 20) ** 2 < 25**2
    return {
        name: (0.0193 * (np.broadcast_to(shape, grid.shape) < 1) * texture + 0.01 * rod * (shape < 1)).astype(
            np.float32
        )
        for name, shape in shapes.items()
    }


def add_arguments(parser):
    parser.add_argument("--projections", type=int, default=150)
    parser.add_argument("--tolerance-hu", type=float, nargs="+", default=[0.5, 1.0, 2.0])


def run(options):
    config = common.configuration()
    grid = grid_of(config.grid)
    geometry = scan_geometry(config.scan, options.projections, grid)
    wide = Grid(tuple(int(n) for n in np.add(grid.shape, MARGIN)), grid.spacing)
    scanned, projector = CpuProjector(geometry, wide), CpuProjector(geometry, grid)
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij", sparse=True)
    middle = (abs(z) < MIDDLE_MM[0]) & (np.hypot(y, x) < MIDDLE_MM[1])
    noise = config.noise.levels["dose10"].A
    settings = vars(config.reconstruction.sirt) | {"mu_water_per_mm": config.mu_water_per_mm}
    for name, scene in objects(wide).items():
        clean = scanned.unpack_projections(scanned.forward(scanned.pack_volume(scene[None])))
        random = np.random.default_rng(2)
        lines = clean + np.sqrt(noise * np.exp(clean)) * random.standard_normal(clean.shape, dtype=np.float32)

        def image(lines=lines, **changed):
            began = time.process_time()
            volume = sirt(projector, lines, **(settings | changed))[0]
            return time.process_time() - began, volume * 1000 / config.mu_water_per_mm

        _, reference = image(terms=ALL_TERMS, tolerance_hu=0)
        for changed in ({"terms": 60, "tolerance_hu": 0}, *({"tolerance_hu": hu} for hu in options.tolerance_hu)):
            took, found = image(**changed)
            off = abs(found - reference)
            beyond = [f"{np.mean(off > hu):.1%} beyond {hu:g} HU" for hu in options.tolerance_hu]
            rms = [np.sqrt(np.mean(part**2)) for part in (off[middle], off)]
            text = ", ".join(f"{key} {value:g}" for key, value in changed.items())
            print(f"{name}: {text}: {took:.1f} s; {', '.join(beyond)}; RMS {rms[0]:.2f} HU in the middle,")
            print(f"    {rms[1]:.1f} HU in all, at most {off.max():.0f} HU", flush=True)
