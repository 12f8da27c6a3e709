"""Compile all projector kernels for one number of realizations."""

from virtual_phantom.study.job import job


def main(*, lanes: int, output: str) -> None:
    from virtual_phantom.io.files import write_text
    from virtual_phantom.reconstruction.images import compile_kernels

    compile_kernels([lanes])
    write_text(f"{lanes} realisations\n", output)


if "snakemake" in globals():
    with job(snakemake):
        main(lanes=int(snakemake.wildcards.lanes), output=snakemake.output[0])
