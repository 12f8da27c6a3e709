"""A file of every kind that stages exchange, and how each is damaged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import recording_folders as folders
import yaml
from scanner import SCANNER

from virtual_phantom import phantom
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.result_files import write_diagnosis
from virtual_phantom.diagnosis.selection.transfer import Physics
from virtual_phantom.io import exchange, files, volumes
from virtual_phantom.proof.scoring.example import residual_maps
from virtual_phantom.proof.scoring.real import row
from virtual_phantom.recordings.document import read_document
from virtual_phantom.simulation.acquire import simulate_counts
from virtual_phantom.study import matched_noise

GRID = Grid((4, 9, 11), (2.0, 1.5, 1.5))
GEOMETRY = circular(views=6, **SCANNER, columns=9, rows=3, column_pitch_mm=2.0, row_pitch_mm=4.0)
AMOUNT = {"value": 0.0625, "ci95": [0.05, 0.075], "unit": "1"}
WIDTH = {"value": 60.0, "ci95": [50.0, 70.0], "unit": "mm"}
DIAGNOSIS = {
    "recording": "bench",
    "sentence": "Scatter is missing.",
    "verdict": "mismatch explained",
    "effects": [
        {
            "name": "scatter",
            "physics": "",
            "parameters": {"amount": AMOUNT, "width_mm": WIDTH},
            "evidence": {"held_out_gain": 9.0, "p": 0.0},
        }
    ],
    "alignment": {"scale": {"value": 1.0, "ci95": [0.99, 1.01]}},
}


@dataclass(frozen=True)
class Artefact:
    """write(folder) returns the path; read(path) returns numbers and text for comparison with `same`."""

    name: str
    write: Callable[[Path], Path]
    read: Callable[[Path], object]


def _array() -> np.ndarray:
    return np.random.default_rng(7).normal(40, 12, GRID.shape).astype(np.float32)


def _nifti(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        volumes.write_nifti(volumes.Volume(_array(), GRID), folder / name)
        return folder / name

    return write


def _read_nifti(path: Path):
    volume = volumes.read_nifti(path)
    return volume.array, volume.grid.affine


def _rois(folder: Path) -> Path:
    masks = [phantom.Roi(name, "cyst", _array() > 40) for name in ("a", "b")]
    phantom.write_rois(masks, volumes.Volume(_array(), GRID), folder)
    return folder / "rois.csv"


def _line_integrals(folder: Path) -> Path:
    integrals = np.random.default_rng(8).random(GEOMETRY.shape).astype(np.float32)
    exchange.write_line_integrals(folder / "clean.h5", integrals, GEOMETRY)
    return folder / "clean.h5"


def _read_line_integrals(path: Path):
    integrals, geometry = exchange.read_line_integrals(path)
    return integrals, repr(geometry.key)


def _counts(folder: Path) -> Path:
    integrals = np.random.default_rng(9).random(GEOMETRY.shape)
    counts = simulate_counts(integrals, 1e-3, "astra", np.random.SeedSequence(1))
    exchange.write_counts(folder / "seed00.h5", counts, GEOMETRY)
    return folder / "seed00.h5"


def _read_counts(path: Path):
    counts, geometry = exchange.read_counts(path)
    return counts.line_integrals(0.5), repr(geometry.key)


def _table(folder: Path) -> Path:
    table = pd.DataFrame({"roi": [f"roi_{i}" for i in range(30)], "x": np.random.default_rng(3).normal(size=30)})
    files.write_csv(table, folder / "table.csv")
    return folder / "table.csv"


def _level(folder: Path) -> Path:
    matched_noise.write_level({"A": 1.24e-6, "A_standard_error": 2.5e-8, "rois": ["cyst_1"]}, folder / "dose.json")
    return folder / "dose.json"


def _diagnosis(part: str) -> Callable[[Path], Path]:
    class Output:
        pass

    def write(folder: Path) -> Path:
        output = Output()
        output.diagnosis, output.physics = folder / "diagnosis.json", folder / "physics.yaml"
        output.report, output.maps = folder / "report.html", folder / "maps"
        shown = {name: _array()[0] for name in ("residuals before", "residuals after")}
        write_diagnosis(output, DIAGNOSIS | FOUND, {"physics": {"scatter": {"amount": 0.0625}}}, "<html></html>", shown)
        return folder / part

    return write


FOUND = {
    "locations": [],
    "ambiguous_with": {},
    "ruled_out": {},
    "fit": {},
    "held_out": {},
    "excess_removed": 0.875,
    "excess_rms_removed": 0.875,
    "remainder_sd": 0.5,
    "unexplained": [],
    "next_measurement": [],
    "held_out_data": "",
    "verdict_lines": ["Missing physics: scatter (amount 0.0625)."],
}


def _overlay(path: Path):
    files.check_unchanged(path)  # as common.smk does with every file given by --configfile
    return repr(yaml.safe_load(path.read_text()))


def _recording(folder: Path) -> Path:
    where, content = folders.images_folder(folder / "scanner")
    files.write_text(yaml.safe_dump(content | {"isocentre_mm": [1.5, 2.5, 3.5]}), where / "recording.yaml")
    return where / "recording.yaml"


ARTEFACTS = [
    Artefact("NIfTI, compressed", _nifti("v.nii.gz"), _read_nifti),
    Artefact("NIfTI", _nifti("v.nii"), _read_nifti),
    Artefact("HDF5, line integrals", _line_integrals, _read_line_integrals),
    Artefact("HDF5, counts", _counts, _read_counts),
    Artefact("CSV", _table, lambda path: repr(files.read_csv(path).to_dict())),
    Artefact("CSV, ROIs", _rois, lambda path: repr(phantom.read_masks(path, GRID)[0].to_dict())),
    Artefact("JSON, noise level", _level, lambda path: repr(matched_noise.read_level(path))),
    Artefact("JSON, diagnosis taken elsewhere", _diagnosis("diagnosis.json"), lambda path: repr(Physics.read(path))),
    Artefact("JSON, diagnosis shown", _diagnosis("diagnosis.json"), lambda path: repr(row(path))),
    Artefact("YAML, physics", _diagnosis("physics.yaml"), _overlay),
    Artefact("YAML, recording", _recording, lambda path: repr(read_document(path.parent).content)),
    Artefact("NPY, map", _diagnosis("maps/residuals after.npy"), lambda path: residual_maps(path.parent)),
]


def mutations(content: bytes, count: int, random: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    """`count` damaged versions: truncated, with one changed bit, or partly overwritten with zeros, in turn."""
    for number in range(count):
        place = int(random.integers(len(content)))
        if number % 3 == 0:
            yield f"cut at byte {place}", content[:place]
        elif number % 3 == 1:
            bit = int(random.integers(8))
            damaged = bytearray(content)
            damaged[place] ^= 1 << bit
            yield f"bit {bit} of byte {place} turned", bytes(damaged)
        else:
            length = int(random.integers(1, 65))
            damaged = bytearray(content)
            damaged[place : place + length] = bytes(len(damaged[place : place + length]))
            yield f"{length} bytes from {place} on zeroed", bytes(damaged)


def same(a: object, b: object) -> bool:
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return np.array_equal(a, b)
