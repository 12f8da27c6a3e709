"""Noise-free line integrals of the finely sampled phantom in one geometry."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    from dataclasses import replace

    from virtual_phantom.base.geometry import scan_geometry
    from virtual_phantom.io.exchange import write_line_integrals
    from virtual_phantom.io.volumes import read_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.physics.line_integrals import check_rois_seen, check_scannable, clean_line_integrals
    from virtual_phantom.physics.stored_state import to_store

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
    state = None
    if physics := params.geometry["physics"]:
        from virtual_phantom.physics.chain import Chain
        from virtual_phantom.physics.materials import Segmentation
        from virtual_phantom.physics.scene import VoxelScene
        from virtual_phantom.physics.sensors import Sensor

        check_scannable(phantom, geometry)
        scene = VoxelScene.of(phantom, Segmentation(**params.materials), params.mu_water_per_mm, snakemake.threads)
        state = Chain(scene, geometry, photons=1.0, sensor=Sensor(**params.sensor)).state(physics)
        # What is read out beside the photons goes by how many there are, which the noise level says.
        line_integrals = replace(state, dark=None, dark_air=0.0).line_integrals()
        log.info("effects: %s", physics)
    else:
        line_integrals = clean_line_integrals(phantom, geometry, params.mu_water_per_mm, snakemake.threads)
    write_line_integrals(snakemake.output[0], line_integrals, geometry, None if state is None else to_store(state))
