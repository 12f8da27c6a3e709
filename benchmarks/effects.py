"""Measure the CPU time of projections with effects relative to clean projections (5 minutes).

Needs the fine phantom of a completed default study. Effects have typical strength; one thread.
"""

from pathlib import Path

from benchmarks import common
from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, load, names
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.physics.scenes.scene import VoxelScene


def add_arguments(parser):
    parser.add_argument("--phantom", type=Path, default=common.ROOT / "results" / "phantom" / "fine.nii.gz")
    parser.add_argument("--views", type=int, default=150)


def run(options):
    config = common.configuration()
    phantom, mu_water = read_nifti(options.phantom), config.mu_water_per_mm
    few, geometry = (scan_geometry(config.scan, views, grid_of(config.grid)) for views in (2, options.views))

    def clean():
        clean_line_integrals(phantom, geometry, mu_water)

    def apply_image_effects(chosen):
        scene = VoxelScene.of(phantom, Segmentation(**vars(config.materials)), mu_water, 1)
        physics = {name: {parameter.name: parameter.typical for parameter in load(name).parameters} for name in chosen}
        Chain(scene, geometry, photons=1.0).state(physics).line_integrals()

    clean_line_integrals(phantom, few, mu_water)  # compiles
    alone = common.cpu_seconds(clean)
    print(f"clean projections of {options.views} views: {alone:.2f} s", flush=True)
    everything = [name for name in names() if not acts_on_images(name)]
    for chosen in (["spectrum"], ["spectrum", "scatter"], ["spectrum", "focal_spot"], ["motion"], everything):
        both = alone + common.cpu_seconds(lambda chosen=chosen: apply_image_effects(chosen))
        shown = " and ".join(chosen) if len(chosen) < 3 else f"all {len(chosen)} effects"
        print(f"with {shown}: {both:.2f} s, {both / alone:.1f} times", flush=True)
