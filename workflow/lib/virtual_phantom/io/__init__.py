"""Input and output: atomic writing, checksums, and file formats of other programs."""
