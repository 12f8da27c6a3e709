"""Images of one protocol, as many acquisitions at once as the job has outputs."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    import numpy as np

    from virtual_phantom.io.exchange import read_line_integrals
    from virtual_phantom.io.volumes import read_nifti, write_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.physics.image import reconstruct, reconstruct_in_boxes
    from virtual_phantom.physics.noise import acquire
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.reconstruction.boxes import boxes_around, voxels_over
    from virtual_phantom.study.matched_noise import resolve

    params = snakemake.params
    grid = read_nifti(snakemake.input.phantom).grid
    clean, geometry = read_line_integrals(snakemake.input.clean)
    state = read_state(snakemake.input.clean)
    noisy = np.empty((len(params.acquisitions), *clean.shape), dtype=np.float32)
    for lane, acquisition in enumerate(resolve(params.acquisitions, snakemake.input.levels)):
        counts = acquire(
            clean,
            geometry=params.geometry,
            model=params.model,
            draws=params.draws,
            study_seed=params.study_seed,
            state=state,
            **acquisition,
        )
        noisy[lane] = counts.line_integrals(params.zero_counts_as)
        log.info(
            "%s: fewest counts %d, pixels without any %d", acquisition, counts.data.min(), (counts.data == 0).sum()
        )
    del clean, counts
    if params.voxels is None:
        volumes = reconstruct(
            noisy,
            geometry,
            grid,
            params.algorithm,
            params.settings,
            engine=params.engine,
            mu_water_per_mm=params.mu_water_per_mm,
            physics=params.physics,
            threads=snakemake.threads,
        )
    else:
        grid = voxels_over(grid, params.voxels["spacing_mm"])
        _, masks = read_masks(snakemake.input.rois[0], grid)
        volumes = reconstruct_in_boxes(
            noisy,
            geometry,
            grid,
            boxes_around(masks.values(), grid),
            params.settings,
            thickness_mm=params.voxels["thickness_mm"],
            mu_water_per_mm=params.mu_water_per_mm,
            threads=snakemake.threads,
        )
    for volume, path in zip(volumes, snakemake.output, strict=True):
        write_nifti(volume, path)
