"""Images in HU from line integrals: FBP and SIRT."""
