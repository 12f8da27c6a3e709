"""A text, printed."""

from virtual_phantom.files import read_text

print(read_text(snakemake.input.text), end="")
