"""Import published tables of radiomics features as recordings, with the names of ROIs and features of Virtual Phantom.

Two layouts are supported. Both tables are of the printed phantom (sources and assumptions: statistics/measured.py):

* the study CT-Phantom4Radiomics, which has a column scan_id,
* a dose series of CT4Harmonization-Multicentric on one scanner, which has a column recon_code.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from ...base.errors import InputError
from ...features.hu_offset import STORED_OFFSET_HU
from ...features.names import FEATURES
from ...features.table_files import read_table
from ...io.files import sha256, write_csv
from ...statistics import measured
from ..recording import Recording
from . import write_folder

STUDY_CITATION = (
    "CT-Phantom4Radiomics, The Cancer Imaging Archive, doi 10.7937/a1v1-rc66; features Joingl/radiomic-features"
)
DOSE_CITATION = (
    "CT4Harmonization-Multicentric, The Cancer Imaging Archive; "
    "features mariamartinasiain/radiomics_phantom_dose_analysis"
)


def import_features(csv_file: str | Path, folder: str | Path, phantom: str | None = None) -> Recording:
    """Write a recording of features with the values of a published table, and load it.

    Raises
    ------
    InputError
        If the table is missing, is in neither layout, or has errors (see `measured.load_full_table` and
        `measured.load_full_dose_series`).
    """
    csv_file = Path(csv_file)
    columns = set(read_table(csv_file).columns)
    if "scan_id" in columns:
        table, content = _group_series(csv_file)
    elif "recon_code" in columns:
        table, content = _dose_series(csv_file)
    else:
        raise InputError(
            f"{csv_file}: has neither a column scan_id (CT-Phantom4Radiomics) nor recon_code (the dose series); "
            "for other tables, write recording.yaml as docs/how-to/recordings.md shows"
        )
    content["origin"] |= {"importer": "features", "sha256": [sha256(csv_file)]}
    content["repeats"] = ["features.csv"]
    return write_folder(folder, "features", phantom, content, lambda target: write_csv(table, target / "features.csv"))


def _group_series(csv_file: Path) -> tuple[pd.DataFrame, dict]:
    table = measured.load_full_table(csv_file)
    table.insert(0, "image", "scan" + table["scan"].astype(str))
    absent = [feature for feature in FEATURES if feature not in measured.PHANTOM4RADIOMICS_FEATURES]
    content = {
        "nominal": {
            # Flouris et al., Sci. Rep. 12, 4732 (2022), methods
            "tube_kvp": 120,
            "mas": 147,
            "dose_mgy": 10,
            "pitch": 1,
            "notes": "All groups reconstruct the same 30 acquisitions: 1 to 20 without, 21 to 30 with re-positioning.",
        },
        "features": {
            "conditions": ["group"],
            "absent": absent,
            "stored_offset_hu": STORED_OFFSET_HU,
            "dimensions": 2,
        },
        "origin": {"citation": STUDY_CITATION, "licence": "scans CC BY 4.0; features without a license file"},
    }
    return table.drop(columns="scan"), content


def _dose_series(csv_file: Path) -> tuple[pd.DataFrame, dict]:
    table = measured.load_full_dose_series(csv_file)
    dose, repeat = table["dose_mgy"].map("{:g}mgy".format), table["repeat"].map("{:02d}".format)
    content = {
        "nominal": {
            "manufacturer": "Siemens",
            "model": "SOMATOM Definition Edge",
            "slice_thickness_mm": 2,
            "voxel_mm": [1, 0.684, 0.684],
            "notes": "Which reconstruction is fbp and which iterative is inferred from their noise.",
        },
        "features": {"conditions": ["dose_mgy", "reconstruction"]},
        "origin": {"citation": DOSE_CITATION, "licence": "scans CC BY 4.0; features MIT"},
    }
    table.insert(0, "image", dose + "_" + table["reconstruction"] + "_" + repeat)
    return table, content
