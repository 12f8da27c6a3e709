"""Noise-free line integrals of the finely sampled phantom in one geometry."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    from virtual_phantom.base.geometry import scan_geometry
    from virtual_phantom.base.pose import IN_PLACE
    from virtual_phantom.io.exchange import write_line_integrals
    from virtual_phantom.io.volumes import read_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.phantom.repositioning import random_pose
    from virtual_phantom.physics.scenes.line_integrals import check_rois_seen
    from virtual_phantom.physics.stored_state import to_store
    from virtual_phantom.simulation.project import project_phantom, read_diagnosed_physics

    params = snakemake.params
    phantom = read_nifti(snakemake.input.phantom)
    grid = read_nifti(snakemake.input.image).grid  # the phantom's own: it alone knows where in the world that lies
    geometry = scan_geometry(params.geometry["scan"], params.geometry["projections"], grid)
    log.info(
        "%d views, %.3f turns, feed %.1f mm per turn",
        geometry.views,
        geometry.views / geometry.views_per_rotation,
        geometry.feed_per_rotation_mm,
    )
    _, masks = read_masks(snakemake.input.rois, grid)
    check_rois_seen(geometry, grid, masks)
    physics = params.geometry["physics"]
    if snakemake.input.physics:
        physics, _ = read_diagnosed_physics(*snakemake.input.physics)
    pose = random_pose(**params.pose) if params.pose else IN_PLACE
    log.info("%s", pose)
    line_integrals, state = project_phantom(
        phantom,
        geometry,
        physics,
        mu_water_per_mm=params.mu_water_per_mm,
        materials=params.materials,
        sensor=params.sensor,
        threads=snakemake.threads,
        pose=pose,
    )
    log.info("effects: %s", physics or "none")
    write_line_integrals(snakemake.output[0], line_integrals, geometry, None if state is None else to_store(state))
