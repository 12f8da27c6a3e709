"""One noisy acquisition, written to a file."""

from virtual_phantom.job import job

with job(snakemake) as log:
    from virtual_phantom.exchange import read_line_integrals, read_state, write_counts
    from virtual_phantom.matched_noise import resolve
    from virtual_phantom.physics.noise import acquire

    params = snakemake.params
    clean, geometry = read_line_integrals(snakemake.input.clean)
    (acquisition,) = resolve([params.acquisition], snakemake.input.levels)
    counts = acquire(
        clean,
        geometry=snakemake.wildcards.geometry,
        model=params.model,
        draws=params.draws,
        study_seed=params.study_seed,
        state=read_state(snakemake.input.clean),
        **acquisition,
    )
    log.info("fewest counts %d, pixels without any %d", counts.data.min(), (counts.data == 0).sum())
    write_counts(snakemake.output[0], counts, geometry)
