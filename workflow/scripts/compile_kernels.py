"""Compile every projector kernel for one number of realisations."""

from virtual_phantom.study.job import job

with job(snakemake) as log:
    from virtual_phantom.io.files import write_text
    from virtual_phantom.reconstruction.images import compile_kernels

    compile_kernels([int(snakemake.wildcards.lanes)])
    write_text(f"{snakemake.wildcards.lanes} realisations\n", snakemake.output[0])
