"""Compile the Numba functions of projection or of one reconstruction for one number of realizations.

The study runs this before the jobs that use them, so that no two jobs compile at the same time.
"""

from virtual_phantom.study.job import job


def main(*, step: str, lanes: int, method: str | None, output: str) -> None:
    from virtual_phantom.io.files import write_text
    from virtual_phantom.reconstruction.images import compile_functions

    compile_functions(step, lanes, method)
    write_text(f"{lanes} realizations\n", output)


if "snakemake" in globals():
    with job(snakemake):
        main(
            step=snakemake.wildcards.step,
            lanes=int(snakemake.wildcards.lanes),
            method=snakemake.params.method,
            output=snakemake.output[0],
        )
