"""Write the library's list of public scans of the printed phantom; run it if the collections change (seconds).

TANDEM lists the series of CT-Phantom4Radiomics (ct_phantom4radiomics.csv), MULTICENTRE those of
CT4Harmonization-Multicentric (ct4harmonization_multicentric.csv). Both are tables of the package idc-index-data, with a
row per series: StudyInstanceUID, SeriesInstanceUID, crdc_series_uuid, Modality, SeriesNumber, SeriesDescription,
ManufacturerModelName, instanceCount and series_size_MB.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from virtual_phantom.base.data import RESOURCES
from virtual_phantom.io.files import read_csv, replacing
from virtual_phantom.statistics.measured import true_acquisition

TANDEM = r"^Harmonized b (?P<dose_mgy>\d+) mGy (?P<slice_mm>[\d.]+)  (?P<kernel>\w+)  ?(?P<strength>\d )?axial - #\d+$"
MULTICENTRE = r"^(?P<group>\w+)_Harmonized_(?P<dose_mgy>\d+)mGy_(?P<reconstruction>\w+) - #(?P<acquisition>\d+)$"


def pairs(path: Path) -> pd.DataFrame:
    """A row per study: its CT and its SEG side by side."""
    table = read_csv(path).astype({"SeriesNumber": str})
    columns = {
        "SeriesInstanceUID": "",
        "crdc_series_uuid": "_folder",
        "instanceCount": "_files",
        "series_size_MB": "_mb",
    }
    ct, seg = (
        table[table["Modality"] == side].rename(columns={key: side.lower() + end for key, end in columns.items()})
        for side in ("CT", "SEG")
    )
    seg = seg.drop(columns=["SeriesNumber", "SeriesDescription", "ManufacturerModelName"])
    both = ct.merge(seg, on="StudyInstanceUID", validate="one_to_one")
    if 2 * len(both) != len(table) or (both["seg_files"] != 1).any():
        raise SystemExit(f"{path}: is not one CT and one SEG of one file to a study")
    named = {"StudyInstanceUID": "study", "SeriesDescription": "description", "ManufacturerModelName": "model"}
    return both.rename(columns=named)


def tandem(path: Path) -> pd.DataFrame:
    """CT-Phantom4Radiomics: groups by number, acquisitions by their true number."""
    table = pairs(path)
    facts = table["description"].str.extract(TANDEM)
    number = table["SeriesNumber"].astype(int)
    return table.assign(
        collection="ct_phantom4radiomics",
        scan=table["SeriesNumber"],
        group=number // 100,
        acquisition=true_acquisition(number // 100, number % 100),
        dose_mgy=facts["dose_mgy"].astype(int),
        reconstruction=facts["strength"].notna().map({True: "ADMIRE3", False: "FBP"}),
        kernel=facts["kernel"],
        slice_mm=facts["slice_mm"],
    )


def multicentre(path: Path) -> pd.DataFrame:
    """CT4Harmonization-Multicentric: groups are scanners."""
    table = pairs(path)
    table = table.join(table["description"].str.extract(MULTICENTRE))
    scan = table["group"] + "_" + table["dose_mgy"] + "mGy_" + table["reconstruction"] + "_"
    return table.assign(
        collection="ct4harmonization_multicentric",
        scan=scan + table["acquisition"].str.zfill(2),
        kernel="",
        slice_mm="",
    )


COLUMNS = """collection scan group acquisition dose_mgy reconstruction kernel slice_mm model description study
ct ct_folder ct_files ct_mb seg seg_folder seg_mb""".split()


def add_arguments(parser):
    parser.add_argument("tandem", type=Path)
    parser.add_argument("multicentre", type=Path)


def run(options):
    parts = [tandem(options.tandem), multicentre(options.multicentre)]
    table = pd.concat([part[COLUMNS].astype(str) for part in parts]).sort_values(["collection", "scan"])
    if table["scan"].duplicated().any():
        raise SystemExit("two scans have one name")
    with replacing(RESOURCES / "public_scans.csv", checksum=False) as temporary:
        table.to_csv(temporary, index=False, lineterminator="\n")
