"""Simulate noise-free line integrals of the finely sampled phantom in one scan geometry."""

import math
from collections.abc import Mapping, Sequence

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.plan import GeometrySettings
from virtual_phantom.study.job import job, log


def main(
    *,
    phantom_file: str,
    image_file: str,
    rois_file: str,
    physics_files: Sequence[str],
    output: str,
    geometry_settings: GeometrySettings,
    mu_water_per_mm: float,
    materials: Mapping,
    sensor: Mapping,
    pose_settings: Mapping | None,
    start_angle_deg: float,
    threads: int,
) -> None:
    from virtual_phantom.base.geometry import scan_geometry
    from virtual_phantom.base.pose import IN_PLACE
    from virtual_phantom.io.exchange import write_line_integrals
    from virtual_phantom.io.volumes import read_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.phantom.repositioning import random_pose
    from virtual_phantom.physics.beam.materials import Segmentation
    from virtual_phantom.physics.beam.sensors import Sensor
    from virtual_phantom.physics.scenes.line_integrals import check_rois_seen
    from virtual_phantom.physics.stored_state import to_store
    from virtual_phantom.simulation.project import project_phantom, read_diagnosed_physics

    phantom = read_nifti(phantom_file)
    grid = read_nifti(image_file).grid  # only this file has the world position of the phantom
    geometry = scan_geometry(geometry_settings.scan, geometry_settings.projections, grid)
    if start_angle_deg:
        geometry = geometry.turned(math.radians(start_angle_deg))
    log.info(
        "%d views from %.1f degrees, %.3f turns, feed %.1f mm per turn",
        geometry.views,
        start_angle_deg,
        geometry.views / geometry.views_per_rotation,
        geometry.feed_per_rotation_mm,
    )
    _, masks = read_masks(rois_file, grid)
    check_rois_seen(geometry, grid, masks)
    physics = geometry_settings.physics
    if physics_files:
        physics, _ = read_diagnosed_physics(*physics_files)
    pose = random_pose(**pose_settings) if pose_settings else IN_PLACE
    log.info("%s", pose)
    line_integrals, state = project_phantom(
        phantom,
        geometry,
        physics,
        mu_water_per_mm=mu_water_per_mm,
        materials=Segmentation(**materials),
        sensor=Sensor(**sensor),
        threads=threads,
        pose=pose,
        samples=geometry_settings.scan.samples,
    )
    log.info("effects: %s", physics or "none")
    write_line_integrals(output, line_integrals, geometry, None if state is None else to_store(state))


if "snakemake" in globals():
    with job(snakemake):
        main(
            phantom_file=snakemake.input.phantom,
            image_file=snakemake.input.image,
            rois_file=snakemake.input.rois,
            physics_files=snakemake.input.physics,
            output=snakemake.output[0],
            geometry_settings=from_mapping(GeometrySettings, snakemake.params.geometry),
            mu_water_per_mm=snakemake.params.mu_water_per_mm,
            materials=snakemake.params.materials,
            sensor=snakemake.params.sensor,
            pose_settings=snakemake.params.pose,
            start_angle_deg=snakemake.params.start_angle_deg,
            threads=snakemake.threads,
        )
