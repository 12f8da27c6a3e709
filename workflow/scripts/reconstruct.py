"""Images of one protocol at one noise level, all seeds of the batch at once."""

from virtual_phantom.job import job

with job(snakemake) as log:
    from virtual_phantom.reconstruct import reconstruct
    from virtual_phantom.volumes import read_nifti, write_nifti

    params = snakemake.params
    grid = read_nifti(snakemake.input.phantom).grid
    volumes = reconstruct(
        snakemake.input.counts,
        grid,
        params.algorithm,
        params.settings,
        engine=params.engine,
        mu_water_per_mm=params.mu_water_per_mm,
        zero_counts_as=params.zero_counts_as,
        threads=snakemake.threads,
    )
    for volume, path in zip(volumes, snakemake.output, strict=True):
        write_nifti(volume, path)
