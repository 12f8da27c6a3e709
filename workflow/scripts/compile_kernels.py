"""Compile the Numba functions of projection and reconstruction for one number of realizations.

The study runs this before the jobs that use them, so that no two jobs compile at the same time.
"""

from virtual_phantom.study.job import job


def main(*, lanes: int, output: str) -> None:
    from virtual_phantom.io.files import write_text
    from virtual_phantom.reconstruction.images import compile_functions

    compile_functions([lanes])
    write_text(f"{lanes} realisations\n", output)


if "snakemake" in globals():
    with job(snakemake):
        main(lanes=int(snakemake.wildcards.lanes), output=snakemake.output[0])
