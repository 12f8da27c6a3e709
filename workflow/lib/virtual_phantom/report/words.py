"""Descriptions of the test domains and nuisance parameters of a diagnosis, for its report."""

from ..diagnosis.projections.object_errors import DENSITY, HU, SURFACE
from ..diagnosis.verdict.object_mismatch import MOST_MISMATCHES

DOMAINS = {  # {domain: tested quantity}
    "columns": "mean difference of every detector column",
    "rows": "mean difference of every detector row",
    "views": "mean difference of every view",
    "projections": "mean difference of every block of views, rows and columns",
    "path length": "mean difference of rays, in deciles of the line integral",
    "edges": "squared differences where line integrals or HU change most",
    "pixels": "squared mean difference of every pixel over the views",
    "both halves": "correlation between the fitted and the held-out half of the data: errors in both are not noise",
    "noise variance": "variance over repeats in every block",
    "noise level": "variance over repeats, all data",
    "noise correlation": "correlation of the noise of adjacent pixels or voxels",
    "white field": "smooth components of the difference between the recorded and the modeled white field",
    "alignment": "deviation of a fitted nuisance parameter from its prior",
    "kinds of change": "generic changes beyond the model, for example with the line integral or between views",
    "image": "mean difference of every block of voxels",
    "slices": "mean difference of every slice",
    "distance from the axis": "mean difference of every ring around the isocenter",
    "tissue": "mean difference of voxels, in deciles of HU",
}
ONE_SIDED = ("edges", "pixels", "both halves", "kinds of change")  # tested for an excess only
NUISANCES = {  # {nuisance parameter: (description, unit)}
    "log_photons": ("natural logarithm of the photons per pixel in air", ""),
    "scale": ("object density scale: factor on all line integrals", ""),
    "offset": ("air offset, added to all line integrals: drift of the tube since the air scan", ""),
    "x_mm": ("object position along x", "mm"),
    "y_mm": ("object position along y", "mm"),
    "z_mm": ("object position along z", "mm"),
    "turn_deg": ("object rotation about z", "degrees"),
    "size": ("object size relative to the stated size", ""),
    "rays": ("discretization error of one ray per pixel, relative to the expected one", ""),
    "simulation": ("discretization error of your simulation, relative to the blur by a pixel", ""),
    "voxels": ("discretization error of the phantom's voxels, relative to the expected one", ""),
    **{
        f"piece_{n}": (f"local object mismatch {n}: attenuation added to the stated one", "1/mm")
        for n in range(1, MOST_MISMATCHES + 1)
    },
    "sharp_edges": ("object edges: share of the change by sharp edges within voxels", ""),
    "finer_edges": ("object edges: share of the change by sharp edges within voxels, beside surfaces of labels", ""),
    "edge_blur": ("object edges: share of the change by a blur of half a squared voxel", ""),
}
OBJECT_ERRORS = {  # {beginning of the name of a nuisance parameter: (description, unit)}
    DENSITY: ("relative error of the density of {}", ""),
    SURFACE: ("displacement of the surface of {}, outwards", "mm"),
    HU: ("error of voxels near {} HU", "HU"),
}


def describe_nuisance(name: str) -> tuple[str, str]:
    """Return the description and the unit of a nuisance parameter."""
    for beginning, (text, unit) in OBJECT_ERRORS.items():
        if name.startswith(beginning):
            return text.format(name.removeprefix(beginning)), unit
    return NUISANCES[name]
