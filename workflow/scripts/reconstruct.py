"""Images of one protocol at one noise level, all seeds of the batch at once."""

from virtual_phantom.job import job

with job(snakemake) as log:  # noqa: F821 (snakemake is put here by Snakemake)
    from virtual_phantom.reconstruct import reconstruct
    from virtual_phantom.volumes import read_nifti, write_nifti

    params = snakemake.params  # noqa: F821
    grid = read_nifti(snakemake.input.phantom).grid  # noqa: F821
    volumes = reconstruct(snakemake.input.counts, grid, params.algorithm, params.settings, engine=params.engine,  # noqa: F821
                          mu_water_per_mm=params.mu_water_per_mm, zero_counts_as=params.zero_counts_as,
                          threads=snakemake.threads)  # noqa: F821
    for volume, path in zip(volumes, snakemake.output, strict=True):  # noqa: F821
        write_nifti(volume, path)
