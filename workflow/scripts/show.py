"""A text, printed."""

from virtual_phantom.io.files import read_text
from virtual_phantom.study.job import job

with job(snakemake):
    print(read_text(snakemake.input.text), end="")
