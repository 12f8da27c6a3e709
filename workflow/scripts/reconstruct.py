"""Images of one protocol, as many acquisitions at once as the job has outputs."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    import numpy as np

    from virtual_phantom.base.errors import InputError
    from virtual_phantom.io.exchange import read_line_integrals
    from virtual_phantom.io.volumes import read_nifti, write_nifti
    from virtual_phantom.phantom import read_masks
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.reconstruction.boxes import boxes_around, voxels_over
    from virtual_phantom.simulation.acquire import acquire
    from virtual_phantom.simulation.project import read_diagnosed_physics
    from virtual_phantom.simulation.reconstruct import reconstruct, reconstruct_in_boxes
    from virtual_phantom.study.matched_noise import resolve

    params = snakemake.params
    grid = read_nifti(snakemake.input.phantom).grid
    paths = list(snakemake.input.clean)
    physics = params.physics
    if snakemake.input.physics:
        _, physics = read_diagnosed_physics(*snakemake.input.physics)
    if physics and params.voxels is not None:
        raise InputError(
            f"{snakemake.input.physics[0]}: {min(physics)} acts on whole images, and those of protocol "
            f"{snakemake.wildcards.protocol} are made in boxes; take its voxels out"
        )
    noisy, read = None, None
    for lane, (acquisition, path) in enumerate(
        zip(resolve(params.acquisitions, snakemake.input.levels), paths, strict=True)
    ):
        if path != read:
            clean, geometry = read_line_integrals(path)
            state, read = read_state(path), path
        if noisy is None:
            noisy = np.empty((len(paths), *clean.shape), dtype=np.float32)
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
            physics=physics,
            threads=snakemake.threads,
        )
    else:
        grid = voxels_over(grid, params.voxels["spacing_mm"])
        places = list(snakemake.input.rois)
        volumes = [None] * len(places)
        for place in dict.fromkeys(places):
            lanes = [lane for lane, one in enumerate(places) if one == place]
            _, masks = read_masks(place, grid)
            made = reconstruct_in_boxes(
                noisy[lanes],
                geometry,
                grid,
                boxes_around(masks.values(), grid),
                params.settings,
                thickness_mm=params.voxels["thickness_mm"],
                mu_water_per_mm=params.mu_water_per_mm,
                threads=snakemake.threads,
            )
            for lane, volume in zip(lanes, made, strict=True):
                volumes[lane] = volume
    for volume, path in zip(volumes, snakemake.output, strict=True):
        write_nifti(volume, path)
