"""Features of public scans as a recording: what stands in its recording.yaml, and a scan's rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .table import COLLECTIONS, PublicScan

if TYPE_CHECKING:  # heavy, and the workflow reads this in every job
    import pandas as pd

    from ...features.parameters import Parameters

NAME, FILE = "printed_phantom", "features.csv"
CONDITIONS = ["group", "dose_mgy", "reconstruction"]  # what tells scans apart that are no repeats of each other


def content(scans: Sequence[PublicScan]) -> dict:
    """What stands in recording.yaml.

    Parameters
    ----------
    scans : sequence of PublicScan
        One at least.

    Returns
    -------
    dict
        Without defaults.
    """
    collections = [COLLECTIONS[name] for name in dict.fromkeys(scan.collection for scan in scans)]
    return {
        "name": NAME,
        "kind": "features",
        "nominal": {"notes": "Extracted from the scans' own voxels, in the regions that were drawn on each of them."},
        "features": {"conditions": CONDITIONS},
        "origin": {
            "citation": "; ".join(f"{one.title}, The Cancer Imaging Archive, doi {one.doi}" for one in collections),
            "licence": " and ".join(dict.fromkeys(one.licence for one in collections)),
        },
        "repeats": [FILE],
    }


def rows_of(
    scan: PublicScan, folder: Path, rois: Sequence[dict], regions: Sequence[int | str], parameters: Parameters
) -> pd.DataFrame:
    """Features of one scan, a row per ROI.

    Parameters
    ----------
    scan : PublicScan
    folder : Path
        Where it lies; it has been checked.
    rois : sequence of dict
        As phantom.ct.rois of the configuration; labels count the regions from 1.
    regions : sequence of int or str
        Segments by number or name.
    parameters : Parameters
        Of the extraction.

    Returns
    -------
    DataFrame
        image, roi, tissue_class, CONDITIONS, collection, acquisition, and what features.extraction gives.

    Raises
    ------
    InputError
        For a CT or a SEG that cannot be read, and a region that is not there or lost by its margin.
    """
    from ...features import extraction
    from ...phantom.ct import draw, read_hu
    from ...phantom.rois import read_entries
    from .files import regions_file

    image, seg = read_hu(folder / "ct"), str(regions_file(folder))
    masks, classes, opened = {}, {}, {}
    for entry in read_entries(list(rois), seg):
        located = replace(entry, file=seg, label=regions[entry.label - 1])
        for name, mask in zip(entry.names, draw(located, image.grid, opened), strict=True):
            masks[name], classes[name] = mask, entry.tissue_class
    table = extraction.extract(image, masks, name=str(folder), parameters=parameters)
    known = {"image": f"scan{scan.name}", "tissue_class": table["roi"].map(classes), "group": scan.group}
    known |= {"dose_mgy": scan.dose_mgy, "reconstruction": scan.reconstruction}
    return table.assign(**known, collection=scan.collection, acquisition=scan.acquisition)
