"""One noisy acquisition, written to a file."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    from virtual_phantom.io.exchange import read_line_integrals, write_counts
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.simulation.acquire import acquire
    from virtual_phantom.study.matched_noise import resolve

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
