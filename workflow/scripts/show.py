"""A text, printed."""

from virtual_phantom.files import read_text
from virtual_phantom.job import job

with job(snakemake):
    print(read_text(snakemake.input.text), end="")
