"""Noisy acquisitions of one geometry at one noise level, one file per seed."""

from virtual_phantom.job import job

with job(snakemake) as log:
    from virtual_phantom.exchange import read_line_integrals, write_counts
    from virtual_phantom.physics.noise import acquisition_seed, simulate_counts

    wildcards, params = snakemake.wildcards, snakemake.params
    line_integrals, geometry = read_line_integrals(snakemake.input.clean)
    for seed, path in zip(params.seeds, snakemake.output, strict=True):
        stream = acquisition_seed(params.study_seed, wildcards.geometry, wildcards.noise, seed)
        counts = simulate_counts(line_integrals, params.noise_level, params.model, stream)
        log.info("%s: fewest counts %d, pixels without any %d", path, counts.data.min(), (counts.data == 0).sum())
        write_counts(path, counts, geometry)
