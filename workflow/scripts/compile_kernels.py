"""Compile every projector kernel for every number of lanes that the study uses."""

from virtual_phantom.job import job

with job(snakemake) as log:
    from virtual_phantom.files import write_text
    from virtual_phantom.projectors.cpu import compile_kernels

    compile_kernels(snakemake.params.lanes)
    write_text(f"lanes: {snakemake.params.lanes}\n", snakemake.output[0])
