"""Files of the results of a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
import yaml

from ..io.documents import DIAGNOSIS, write_document
from ..io.files import replacing, write_text

RESIDUAL_MAPS = ("residuals before", "residuals after")  # in addition to the maps of domains


class DiagnosisFiles(Protocol):
    """Paths of the files that every diagnosis writes; `maps` is a folder."""

    diagnosis: str
    physics: str
    report: str
    maps: str


def write_diagnosis(
    output: DiagnosisFiles, content: dict, overlay: dict, page: str, maps: Mapping[str, np.ndarray]
) -> None:
    """Write the files of a diagnosis: diagnosis.json, physics.yaml, the report and maps by domain.

    Parameters
    ----------
    overlay : dict
        Content of physics.yaml, a configuration of the study.
    """
    folder = Path(output.maps)
    folder.mkdir(parents=True, exist_ok=True)
    for domain, values in maps.items():
        with replacing(folder / f"{domain}.npy") as temporary, temporary.open("wb") as file:
            np.save(file, values)
    write_overlay(content, overlay, output.physics)
    write_text(page, output.report)
    write_document(content, output.diagnosis, DIAGNOSIS)


def write_overlay(content: Mapping, overlay: dict, path: str | Path, remarks: Sequence[str] = ()) -> None:
    """Write a configuration of the study below the lines of the verdict and remarks as comments."""
    usage = "Overlay of the study's configuration: snakemake --configfile physics.yaml"
    text = "".join(f"# {line}\n" for line in (*content["verdict_lines"], usage, *remarks))
    write_text(text + yaml.safe_dump(overlay, sort_keys=False), path)
