"""Extract the features of public scans and describe them in a recording.yaml, so that they can be used as a recording.

Features are extracted in two modes: in three dimensions and HU, like the study's images; and as in the published table
(CT-Phantom4Radiomics: largest section of each region, stored values).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from .table import COLLECTIONS, PublicScan

if TYPE_CHECKING:  # slow imports, and the workflow reads this module in every job
    import pandas as pd

    from ...features.parameters import Parameters

NAME, FILE = "printed_phantom", "features.csv"
FLAT = "_2d"  # suffix of the second mode
STORED_OFFSET_HU = 1024  # added to HU in the scanners' stored values
EXTRACTION_MODES = {  # {suffix of folders and recordings: notes in recording.yaml}
    "": "Extracted from the scans' own voxels, in the regions that were drawn on each of them.",
    FLAT: "Extracted from the largest section of each region that was drawn on a scan, pixels of 1 mm, stored values.",
}
CONDITIONS = ["group", "dose_mgy", "reconstruction"]  # columns that distinguish scans that are not repeats


def recording_content(scans: Sequence[PublicScan], mode: str = "") -> dict:
    """Return the content of recording.yaml, without defaults.

    Parameters
    ----------
    scans : sequence of PublicScan
        At least one.
    mode : {"", FLAT}, optional
        Extraction mode.
    """
    collections = [COLLECTIONS[name] for name in dict.fromkeys(scan.collection for scan in scans)]
    return {
        "name": NAME + mode,
        "kind": "features",
        "nominal": {"notes": EXTRACTION_MODES[mode]},
        "features": {"conditions": CONDITIONS}
        | ({"stored_offset_hu": STORED_OFFSET_HU, "dimensions": 2} if mode == FLAT else {}),
        "origin": {
            "citation": "; ".join(f"{part.title}, The Cancer Imaging Archive, doi {part.doi}" for part in collections),
            "licence": " and ".join(dict.fromkeys(part.licence for part in collections)),
        },
        "repeats": [FILE],
    }


def scan_features(
    scan: PublicScan, folder: Path, rois: Sequence[dict], regions: Sequence[int | str], parameters: Parameters
) -> dict[str, pd.DataFrame]:
    """Return the features of one scan by extraction mode (keys of EXTRACTION_MODES), one row per ROI.

    Parameters
    ----------
    folder : Path
        Folder of the scan, already checked.
    rois : sequence of dict
        As phantom.ct.rois of the configuration; labels count the regions from 1.
    regions : sequence of int or str
        Segments by number or name.
    parameters : Parameters
        Extraction parameters; section and stored offset are replaced.

    Returns
    -------
    dict of str to DataFrame
        Columns image, roi, tissue_class, CONDITIONS, collection, acquisition, and the columns of features.extraction.

    Raises
    ------
    InputError
        For an unreadable CT or SEG, and a region that is missing or removed by its margin.
    """
    import numpy as np

    from ...features import extraction
    from ...features.parameters import LARGEST, WHOLE
    from ...io.volumes import Volume
    from ...phantom.ct import draw_entry, read_hu
    from ...phantom.rois import read_roi_entries
    from .files import regions_file

    image, seg = read_hu(folder / "ct"), str(regions_file(folder))
    masks, classes, opened = {}, {}, {}
    for entry in read_roi_entries(list(rois), seg):
        located = replace(entry, file=seg, label=regions[entry.label - 1])
        for name, mask in zip(entry.names, draw_entry(located, image.grid, opened), strict=True):
            masks[name], classes[name] = mask, entry.tissue_class
    # Independent of how the study's features are extracted.
    whole = replace(parameters, section=WHOLE, stored_offset_hu=0.0)
    stored = Volume(image.array.astype(np.float32) + np.float32(STORED_OFFSET_HU), image.grid)
    tables = {
        "": extraction.extract(image, masks, str(folder), whole),
        FLAT: extraction.extract(stored, masks, f"{folder}, section", replace(whole, section=LARGEST)),
    }
    known = {"image": f"scan{scan.name}", "group": scan.group, "dose_mgy": scan.dose_mgy}
    known |= {"reconstruction": scan.reconstruction, "collection": scan.collection, "acquisition": scan.acquisition}
    return {mode: table.assign(tissue_class=table["roi"].map(classes), **known) for mode, table in tables.items()}
