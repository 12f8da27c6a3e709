"""Simulate one noisy acquisition."""

from collections.abc import Mapping, Sequence

from virtual_phantom.study.job import job, log


def main(
    *,
    clean_file: str,
    levels: Sequence[str],
    output: str,
    geometry_name: str,
    settings: Mapping,
    noise: Mapping,
) -> None:
    from virtual_phantom.io.exchange import read_line_integrals, write_counts
    from virtual_phantom.physics.stored_state import read_state
    from virtual_phantom.simulation.acquire import acquire
    from virtual_phantom.study.matched_noise import resolve

    clean, geometry = read_line_integrals(clean_file)
    (acquisition,) = resolve([settings], levels)
    counts = acquire(clean, geometry=geometry_name, state=read_state(clean_file), **noise, **acquisition)
    log.info("fewest counts %d, pixels without any %d", counts.data.min(), (counts.data == 0).sum())
    write_counts(output, counts, geometry)


if "snakemake" in globals():
    with job(snakemake):
        main(
            clean_file=snakemake.input.clean,
            levels=snakemake.input.levels,
            output=snakemake.output[0],
            geometry_name=snakemake.wildcards.geometry,
            settings=snakemake.params.acquisition,
            noise=snakemake.params.noise,
        )
