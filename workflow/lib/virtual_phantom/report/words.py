"""Descriptions of the domains of residuals and of nuisance parameters, for reports."""

from ..diagnosis.verdict.object_mismatch import MOST_PIECES

# {domain: compared quantity}. Domains of ONE_SIDED are tested for an excess only.
DOMAINS = {
    "columns": "mean difference of every detector column",
    "rows": "mean difference of every detector row",
    "views": "mean difference of every view",
    "projections": "mean difference of every block of views, rows and columns",
    "path length": "mean difference of rays by line integral, in tenths",
    "edges": "squared differences where line integrals or HU change most",
    "pixels": "squared mean difference of every pixel over the views",
    "both halves": "correlation of fitted and held-out residuals, which noise does not cause",
    "noise variance": "variance over repeats in every block",
    "noise level": "variance over repeats, all data",
    "noise correlation": "correlation of the noise of neighbors",
    "white field": "recorded less modeled white field, by smooth shapes",
    "alignment": "deviation of a nuisance parameter from its prior",
    "kinds of change": "unmodeled changes: with the line integral, from view to view, along columns and others",
    "image": "mean difference of every block of voxels",
    "slices": "mean difference of every slice",
    "distance from the axis": "mean difference of every ring around the isocenter",
    "tissue": "mean difference of voxels by HU, in tenths",
}
ONE_SIDED = ("edges", "pixels", "both halves", "kinds of change")
# {nuisance parameter: (words, unit)}
NUISANCES = {
    "log_photons": ("photons per pixel in air, natural logarithm", ""),
    "scale": ("factor of all line integrals, for the density of the object", ""),
    "offset": ("added to all line integrals, for drift of the tube since the air scan", ""),
    "x_mm": ("location of the object along x", "mm"),
    "y_mm": ("location of the object along y", "mm"),
    "z_mm": ("location of the object along z", "mm"),
    "turn_deg": ("rotation of the object about z", "degrees"),
    "size": ("size of the object relative to the stated one", ""),
    "rays": ("discretization error of rays per pixel, relative to the expected one", ""),
    "voxels": ("discretization error of voxels, relative to the expected one", ""),
    **{
        f"piece_{n}": (f"corrected piece {n} of the object: attenuation beyond the stated one", "1/mm")
        for n in range(1, MOST_PIECES + 1)
    },
}
