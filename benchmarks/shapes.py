"""Measure time and error of path lengths through shapes, and their time through voxels (2 minutes).

Prints medians of CPU time with one thread for 256 columns x 16 rows x 90 views and one ray per pixel. "In turn" is the
sum over the same shapes traced separately.

For wide pixels with several rays, it also prints the time of the mean signal and the chi-square of its error, with and
without divided pixels at edges. Noise is that of 4 x 10^5 photons; the reference has 16 nodes.
"""

from unittest import mock

import numpy as np

from benchmarks import common
from virtual_phantom.base.geometry import Grid
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes import edges
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid

ONE_THREAD = True
GEOMETRY = common.circular_scan(90, 256, 16, 1.6)
BALLS = (1, 5, 20, 80)
WIDE = common.circular_scan(24, 60, 6, 6.0)
RAYS, REFERENCE = (2, 4, 8, 16), (6, 16)  # rays per pixel and direction; of the reference, with nodes
PHOTONS = 4e5
VOXELS = Grid((36, 220, 220), (1.0, 1.0, 1.0))  # as wide as the Catphan


def balls(count):
    """Cylinder with `count` balls of 10 mm."""
    random = np.random.default_rng(np.random.SeedSequence(1))
    places = random.uniform(-65, 65, (count, 2))
    return [cylinder("water", (0, 0, 0), 100.0)] + [ellipsoid("pmma", (x, y, 0.0), (5, 5, 5)) for x, y in places]


def insert_body():
    """Body of water with five inserts."""
    rods = (("pmma", -4.2, 14.5, 15.0), ("bone", 40.7, 8.2, 8.7), ("aluminium", -41.0, -18.7, 6.3))
    shapes = [cylinder("water", (0, 0, 0), 93.0), cylinder("nothing", (-29.4, -52.8, 0), 13.8)]
    shapes += [cylinder(material, (x, y, 0), radius) for material, x, y, radius in rods]
    return ShapesScene([*shapes, ellipsoid("pmma", (7.9, 53.8, 1.6), (5.1, 5.1, 5.1))])


def print_errors(repeats):
    """Time and error of the mean signal, by rays per pixel."""
    scene = insert_body()

    def lines(samples, divided):
        chain = Chain(scene, WIDE, samples=samples)
        if divided:
            return chain.state({}).line_integrals()
        with mock.patch.object(ShapesScene, "edge_scans", lambda *_: ()):
            return chain.state({}).line_integrals()

    samples, nodes = REFERENCE
    with mock.patch.object(edges, "NODES", nodes):
        exact = lines(samples, True)
    for divided in (False, True):
        for count in RAYS[: 2 if divided else None]:
            (seconds,) = common.medians([lambda count=count, divided=divided: lines(count, divided)], repeats)
            error = float((PHOTONS * np.exp(-exact) * (lines(count, divided) - exact) ** 2).sum())
            print(
                f"{count} x {count} rays{' and divided pixels' if divided else ''}: {seconds:.3f} s, chi-square "
                f"{error:.3g} in {exact.size} rays",
                flush=True,
            )


def add_arguments(parser):
    parser.add_argument("--repeats", type=int, default=5)


def run(options):
    repeats = options.repeats
    rays = int(np.prod(GEOMETRY.shape))
    cases = {name: read_object(name).shapes for name in ("water_cylinder", "catphan504_ctp404", "acr464_module1")}
    cases |= {f"cylinder and {count} balls": balls(count) for count in BALLS}
    for name, shapes in cases.items():
        (whole,) = common.medians([lambda shapes=shapes: ShapesScene(shapes).path_lengths(GEOMETRY)], repeats)
        alone = common.medians(
            [
                lambda shape=shape: ShapesScene([cylinder("water", (0, 0, 0), 100.0), shape]).path_lengths(GEOMETRY)
                for shape in shapes
            ],
            1,
        )
        print(
            f"{name}: {len(shapes)} shapes, {1e9 * whole / rays:.0f} ns a ray, {whole:.3f} s; in turn "
            f"{sum(alone) / whole:.1f} times as long",
            flush=True,
        )
    print_errors(repeats)
    z, y, x = np.meshgrid(*VOXELS.axes_mm(), indexing="ij", sparse=True)
    inside = np.broadcast_to(np.hypot(x, y) < 100, VOXELS.shape).astype(np.float32)
    scene = VoxelScene(inside[None], VOXELS, ("water",), 60.0)
    (whole,) = common.medians([lambda: scene.path_lengths(GEOMETRY)], repeats)
    print(f"voxels of 1 mm, one material: {1e9 * whole / rays:.0f} ns a ray, {whole:.3f} s")
