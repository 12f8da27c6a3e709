"""Print a text file."""

from virtual_phantom.io.files import read_text
from virtual_phantom.study.job import job


def main(*, text_file: str) -> None:
    print(read_text(text_file), end="")


if "snakemake" in globals():
    with job(snakemake):
        main(text_file=snakemake.input.text)
