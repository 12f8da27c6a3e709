"""Compile every projector kernel for one number of realisations."""

from virtual_phantom.job import job

with job(snakemake) as log:
    from virtual_phantom.files import write_text
    from virtual_phantom.reconstruct import compile_kernels

    compile_kernels([int(snakemake.wildcards.lanes)])
    write_text(f"{snakemake.wildcards.lanes} realisations\n", snakemake.output[0])
