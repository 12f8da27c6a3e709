"""Measure the time of path lengths through shapes and through voxels (2 minutes).

Prints medians of CPU time with one thread for 256 columns x 16 rows x 90 views and one ray per pixel. "In turn" is the
sum over the same shapes traced separately.
"""

import numpy as np

from benchmarks import common
from virtual_phantom.base.geometry import Grid
from virtual_phantom.physics.scenes.objects import read_object
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid

ONE_THREAD = True
GEOMETRY = common.circular_scan(90, 256, 16, 1.6)
BALLS = (1, 5, 20, 80)
VOXELS = Grid((36, 220, 220), (1.0, 1.0, 1.0))  # as wide as the Catphan


def balls(count):
    """Cylinder with `count` balls of 10 mm."""
    random = np.random.default_rng(np.random.SeedSequence(1))
    places = random.uniform(-65, 65, (count, 2))
    return [cylinder("water", (0, 0, 0), 100.0)] + [ellipsoid("pmma", (x, y, 0.0), (5, 5, 5)) for x, y in places]


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
    z, y, x = np.meshgrid(*VOXELS.axes_mm(), indexing="ij", sparse=True)
    inside = np.broadcast_to(np.hypot(x, y) < 100, VOXELS.shape).astype(np.float32)
    scene = VoxelScene(inside[None], VOXELS, ("water",), 60.0)
    (whole,) = common.medians([lambda: scene.path_lengths(GEOMETRY)], repeats)
    print(f"voxels of 1 mm, one material: {1e9 * whole / rays:.0f} ns a ray, {whole:.3f} s")
