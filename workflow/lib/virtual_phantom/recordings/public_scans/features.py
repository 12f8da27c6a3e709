"""Features of public scans as recordings: what stands in their recording.yaml, and a scan's rows.

Two ways of extraction: in three dimensions and HU as the study's own images, and as the published table has them
(CT-Phantom4Radiomics: the largest section of each region, stored values).
"""

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
FLAT = "_2d"  # ends the names of folders and recordings of the second way
STORED_OFFSET_HU = 1024  # what the scanners store on top of HU
EXTRACTED = {
    "": "Extracted from the scans' own voxels, in the regions that were drawn on each of them.",
    FLAT: "Extracted from the largest section of each region that was drawn on a scan, pixels of 1 mm, stored values.",
}
CONDITIONS = ["group", "dose_mgy", "reconstruction"]  # what tells scans apart that are no repeats of each other


def recording_content(scans: Sequence[PublicScan], way: str = "") -> dict:
    """What stands in recording.yaml.

    Parameters
    ----------
    scans : sequence of PublicScan
        One at least.
    way : {"", FLAT}, optional
        How features were extracted.

    Returns
    -------
    dict
        Without defaults.
    """
    collections = [COLLECTIONS[name] for name in dict.fromkeys(scan.collection for scan in scans)]
    return {
        "name": NAME + way,
        "kind": "features",
        "nominal": {"notes": EXTRACTED[way]},
        "features": {"conditions": CONDITIONS}
        | ({"stored_offset_hu": STORED_OFFSET_HU, "dimensions": 2} if way == FLAT else {}),
        "origin": {
            "citation": "; ".join(f"{one.title}, The Cancer Imaging Archive, doi {one.doi}" for one in collections),
            "licence": " and ".join(dict.fromkeys(one.licence for one in collections)),
        },
        "repeats": [FILE],
    }


def rows_of(
    scan: PublicScan, folder: Path, rois: Sequence[dict], regions: Sequence[int | str], parameters: Parameters
) -> dict[str, pd.DataFrame]:
    """Features of one scan, a row per ROI, both ways.

    Parameters
    ----------
    folder : Path
        Where it lies; it has been checked.
    rois : sequence of dict
        As phantom.ct.rois of the configuration; labels count the regions from 1.
    regions : sequence of int or str
        Segments by number or name.
    parameters : Parameters
        Of the extraction; its section and its stored offset do not count.

    Returns
    -------
    dict of str to DataFrame
        By way, one of EXTRACTED: image, roi, tissue_class, CONDITIONS, collection, acquisition, and what
        features.extraction gives.

    Raises
    ------
    InputError
        For a CT or a SEG that cannot be read, and a region that is not there or lost by its margin.
    """
    import numpy as np

    from ...features import extraction
    from ...features.parameters import LARGEST, WHOLE
    from ...io.volumes import Volume
    from ...phantom.ct import draw, read_hu
    from ...phantom.rois import read_entries
    from .files import regions_file

    image, seg = read_hu(folder / "ct"), str(regions_file(folder))
    masks, classes, opened = {}, {}, {}
    for entry in read_entries(list(rois), seg):
        located = replace(entry, file=seg, label=regions[entry.label - 1])
        for name, mask in zip(entry.names, draw(located, image.grid, opened), strict=True):
            masks[name], classes[name] = mask, entry.tissue_class
    # Whichever way the study's own features are extracted.
    whole = replace(parameters, section=WHOLE, stored_offset_hu=0.0)
    stored = Volume(image.array.astype(np.float32) + np.float32(STORED_OFFSET_HU), image.grid)
    tables = {
        "": extraction.extract(image, masks, str(folder), whole),
        FLAT: extraction.extract(stored, masks, f"{folder}, section", replace(whole, section=LARGEST)),
    }
    known = {"image": f"scan{scan.name}", "group": scan.group, "dose_mgy": scan.dose_mgy}
    known |= {"reconstruction": scan.reconstruction, "collection": scan.collection, "acquisition": scan.acquisition}
    return {way: table.assign(tissue_class=table["roi"].map(classes), **known) for way, table in tables.items()}
