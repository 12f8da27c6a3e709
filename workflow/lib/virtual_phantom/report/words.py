"""Words for readers of a diagnosis: domains in which differences are looked for, and nuisance parameters."""

from ..diagnosis.verdict.object_mismatch import MOST_PIECES

# {domain: what is compared there}. Those of ONE_SIDED are tested for too much only.
DOMAINS = {
    "columns": "mean difference of every detector column",
    "rows": "mean difference of every detector row",
    "views": "mean difference of every view",
    "projections": "mean difference of every block of views, rows and columns",
    "path length": "mean difference of rays in the order of their line integral, in ten parts",
    "edges": "squares of the differences where line integrals or HU change most",
    "pixels": "squares of every pixel's mean difference over the views",
    "both halves": "what the fitted and the other half of the data have in common: the same error in both is no noise",
    "noise variance": "variance over repeats in every block",
    "noise level": "variance over repeats, of everything",
    "noise correlation": "correlation of the noise of neighbours",
    "white field": "difference of the recorded white field from the modelled one, by smooth shapes",
    "alignment": "how far the fit has pulled a nuisance parameter off what was known of it",
    "kinds of change": "what changes without a cause explain beside the model: with the line integral, from view to "
    "view, along columns and so on",
    "image": "mean difference of every block of voxels",
    "slices": "mean difference of every slice",
    "distance from the axis": "mean difference of every ring around the isocentre",
    "tissue": "mean difference of voxels in the order of their HU, in ten parts",
}
ONE_SIDED = ("edges", "pixels", "both halves", "kinds of change")
# {nuisance parameter: (words, unit)}
NUISANCES = {
    "log_photons": ("photons per pixel in air, natural logarithm", ""),
    "scale": ("factor of all line integrals: the object's density", ""),
    "offset": ("added to all line integrals: drift of the tube since the air scan", ""),
    "x_mm": ("place of the object along x", "mm"),
    "y_mm": ("place of the object along y", "mm"),
    "z_mm": ("place of the object along z", "mm"),
    "turn_deg": ("turn of the object about z", "degrees"),
    "size": ("size of the object over the stated one", ""),
    "rays": ("error of one ray per pixel, over the expected one", ""),
    "voxels": ("error of the phantom's voxels, over the expected one", ""),
    **{
        f"piece_{n}": (f"piece {n} of the object that was mended: attenuation over the stated one", "1/mm")
        for n in range(1, MOST_PIECES + 1)
    },
}
