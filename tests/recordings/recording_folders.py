"""Small recording folders of every kind, to which tests make one change at a time."""

import copy
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import phantom_files
import pytest
import yaml

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.features.extraction import FEATURES, extract
from virtual_phantom.io.volumes import Volume
from virtual_phantom.recordings.features import KEYS
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.statistics.measured import TISSUE_CLASSES

SCAN = {
    "trajectory": "circular",
    "source_to_isocentre_mm": 500,
    "source_to_detector_mm": 1000,
    "columns": 40,
    "rows": 4,
    "column_pitch_mm": 8.0,
    "row_pitch_mm": 8.0,
    "views": 24,
    "views_per_rotation": 24,
    "start_angle_deg": 30,
    "direction": -1,
    "rotation_time_ms": 480,
}
WHITE, DARK = 1000.0, 50.0


def write_yaml(folder: Path, content: dict) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "recording.yaml").write_text(yaml.safe_dump(content))
    return folder


def changed(content: dict, path: str, value) -> dict:
    """Copy with the key at a dotted path set; None removes the key."""
    content = copy.deepcopy(content)
    section = content
    *parents, last = path.split(".")
    for key in parents:
        section = section.setdefault(key, {})
    if value is None:
        del section[last]
    else:
        section[last] = value
    return content


def refused(folder, message: str) -> None:
    """Check that loading fails with one line that contains `message`."""
    with pytest.raises(InputError) as error:
        load_recording(folder)
    assert message in str(error.value), str(error.value)
    assert "\n" not in str(error.value)


def line_integrals(scan=SCAN) -> np.ndarray:
    """A slab that is thicker in the middle columns: [view, row, column]."""
    column = np.arange(scan["columns"]) - (scan["columns"] - 1) / 2
    profile = 2 * np.exp(-((column / 8) ** 2))
    return np.broadcast_to(profile, (scan["views"], scan["rows"], scan["columns"])).astype(np.float32)


def angles_deg(scan=SCAN) -> np.ndarray:
    return scan["start_angle_deg"] + scan["direction"] * 360 * np.arange(scan["views"]) / scan["views_per_rotation"]


def write_projections(path: Path, log=False, scan=SCAN, **changes) -> None:
    """Data Exchange file; `changes` replaces datasets by name, and None omits them."""
    values = line_integrals(scan)
    frame = (3, scan["rows"], scan["columns"])
    datasets = {"data": values, "theta": angles_deg(scan)}
    if not log:
        counts = (WHITE - DARK) * np.exp(-values.astype(float)) + DARK
        datasets |= {"data": counts, "data_white": np.full(frame, WHITE), "data_dark": np.full(frame, DARK)}
    with h5py.File(path, "w") as file:
        for name, array in (datasets | changes).items():
            if array is not None:
                file[f"exchange/{name}"] = array
        if "data" in file["exchange"]:
            file["exchange/data"].attrs["log"] = log


def projections_folder(folder: Path, log=False, **changes) -> tuple[Path, dict]:
    content = {"name": "bench", "kind": "projections", "scan": SCAN, "repeats": ["a.h5", "b.h5"], "held_out": ["c.h5"]}
    write_yaml(folder, content)
    for name in "abc":
        write_projections(folder / f"{name}.h5", log)
    if changes:
        write_projections(folder / "b.h5", log, **changes)
    return folder, content


def images_folder(folder: Path) -> tuple[Path, dict]:
    """Two NIfTI repeats of the phantom's test object, and its regions."""
    content = {
        "name": "scanner",
        "kind": "images",
        "repeats": ["one.nii.gz", "two.nii.gz"],
        "labels": "labels.nii.gz",
        "rois": [
            {"name": "bright", "tissue_class": "tumour", "label": 1},
            {"name": "dark", "tissue_class": "fat", "label": 2},
        ],
    }
    write_yaml(folder, content)
    for name in ("one", "two"):
        phantom_files.write_nifti_array(phantom_files.object_hu(), folder / f"{name}.nii.gz")
    labels = phantom_files.ball("bright") + 2 * phantom_files.ball("dark").astype(np.uint8)
    phantom_files.write_nifti_array(labels.astype(np.uint8), folder / "labels.nii.gz")
    return folder, content


def features_table(images=3, start=0, mean=40.0) -> pd.DataFrame:
    """Features of two ROIs per image in noise, as by pyradiomics."""
    rows = [noise_features(image, mean) for image in range(start, start + images)]
    table = pd.concat(rows, ignore_index=True)
    return table.assign(tissue_class=table["roi"].map(TISSUE_CLASSES), dose_mgy=10)[[*KEYS, "dose_mgy", *FEATURES]]


@cache
def noise_features(seed: int, mean: float) -> pd.DataFrame:
    noise = np.random.default_rng(seed).normal(mean, 30, (6, 10, 12))
    masks = {name: np.zeros(noise.shape, bool) for name in ("cyst_1", "normal_1")}
    masks["cyst_1"][..., :6], masks["normal_1"][..., 6:] = True, True
    return extract(Volume(noise, Grid(noise.shape, (1, 1, 1))), masks).assign(image=f"i{seed}")


def features_folder(folder: Path) -> tuple[Path, dict]:
    content = {
        "name": "table",
        "kind": "features",
        "repeats": ["a.csv", "b.csv"],
        "features": {"conditions": ["dose_mgy"]},
    }
    write_yaml(folder, content)
    features_table().to_csv(folder / "a.csv", index=False)
    features_table(start=3).to_csv(folder / "b.csv", index=False)
    return folder, content
