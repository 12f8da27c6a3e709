"""The acquisition chain: what happens to the line integrals between the phantom and the reconstruction."""
