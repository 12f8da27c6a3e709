"""What path lengths through shapes cost: shipped objects, boxes of more and more balls, and voxels beside them.

    python benchmarks/shapes.py

Medians of processor time, one thread, of a scan of 256 columns x 16 rows x 90 views, one ray per pixel. "In turn" is
the sum over the same shapes, each traced alone: what they would cost if every ray asked every shape.
"""

import argparse
import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"

import time  # noqa: E402

import numpy as np  # noqa: E402

from virtual_phantom.base.geometry import Grid, circular  # noqa: E402
from virtual_phantom.physics.scenes.objects import read_object  # noqa: E402
from virtual_phantom.physics.scenes.scene import VoxelScene  # noqa: E402
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid  # noqa: E402

GEOMETRY = circular(
    views=90,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=256,
    rows=16,
    column_pitch_mm=1.6,
    row_pitch_mm=1.6,
)
BALLS = (1, 5, 20, 80)
VOXELS = Grid((36, 220, 220), (1.0, 1.0, 1.0))  # of a body as wide as the Catphan, 1 mm


def median_s(function, repeats):
    function()
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        taken.append(time.process_time() - began)
    return float(np.median(taken))


def balls(count):
    """A cylinder with so many balls of 10 mm in it, on rings."""
    random = np.random.default_rng(np.random.SeedSequence(1))
    places = random.uniform(-65, 65, (count, 2))
    return [cylinder("water", (0, 0, 0), 100.0)] + [ellipsoid("pmma", (x, y, 0.0), (5, 5, 5)) for x, y in places]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    rays = int(np.prod(GEOMETRY.shape))
    cases = {name: read_object(name).shapes for name in ("water_cylinder", "catphan504_ctp404", "acr464_module1")}
    cases |= {f"cylinder and {count} balls": balls(count) for count in BALLS}
    for name, shapes in cases.items():
        whole = median_s(lambda shapes=shapes: ShapesScene(shapes).path_lengths(GEOMETRY), repeats)
        alone = sum(
            median_s(lambda one=one: ShapesScene([cylinder("water", (0, 0, 0), 100.0), one]).path_lengths(GEOMETRY), 1)
            for one in shapes
        )
        print(
            f"{name}: {len(shapes)} shapes, {1e9 * whole / rays:.0f} ns a ray, {whole:.3f} s; in turn "
            f"{alone / whole:.1f} times as long",
            flush=True,
        )
    z, y, x = np.meshgrid(*VOXELS.axes_mm(), indexing="ij", sparse=True)
    inside = np.broadcast_to(np.hypot(x, y) < 100, VOXELS.shape).astype(np.float32)
    scene = VoxelScene(inside[None], VOXELS, ("water",), 60.0)
    whole = median_s(lambda: scene.path_lengths(GEOMETRY), repeats)
    print(f"voxels of 1 mm, one material: {1e9 * whole / rays:.0f} ns a ray, {whole:.3f} s")


if __name__ == "__main__":
    main()
