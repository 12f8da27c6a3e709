"""Files of a diagnosis: fits as JSON, and its results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Protocol

import numpy as np
import yaml

from ...base.errors import refusing
from ...io.documents import DIAGNOSIS, write_document
from ...io.files import read_text, replacing, write_text
from ..fitting.fit import Fit
from ..fitting.linearization import Linearization, LinearizationPoint
from ..fitting.trial import Trial
from ..noise.gain_pattern import Pattern

RESIDUAL_MAPS = ("residuals before", "residuals after")  # in addition to the maps of domains


def content_of(trial: Trial) -> dict:
    """Return a trial as JSON content."""
    fit = asdict(trial.fit)
    if fit["pattern"] is not None:
        fit["pattern"] = {name: np.asarray(values).tolist() for name, values in fit["pattern"].items()}
    return {"fit": fit, "score": trial.score, "p": trial.p}


def write_trial(trial: Trial, path: str | Path, made_of: str = "") -> None:
    """Write a trial and the key of its inputs."""
    content = content_of(trial) | {"made_of": made_of}
    write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", path)


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


def read_trial(path: str | Path) -> tuple[Trial, str]:
    """Read what `write_trial` wrote.

    Raises
    ------
    InputError
        If it is missing or invalid.
    """
    kinds = (OSError, ValueError, KeyError, TypeError)
    with refusing(f"{path}: is no fit of a diagnosis", *kinds, advice="make it again"):
        content = json.loads(read_text(path))
        fit = content["fit"]
        fit["effects"], fit["parts"] = tuple(fit["effects"]), tuple(fit["parts"])
        fit["linearization"] = Linearization(
            *(LinearizationPoint(**fit["linearization"][about]) for about in ("errors", "rays"))
        )
        if fit["pattern"] is not None:
            arrays = {name: np.array(values) for name, values in fit["pattern"].items() if isinstance(values, list)}
            fit["pattern"] = Pattern(**fit["pattern"] | arrays)
        return Trial(Fit(**fit), content["score"], content["p"]), content["made_of"]
