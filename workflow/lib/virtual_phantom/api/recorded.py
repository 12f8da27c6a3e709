"""A recording read and diagnosed as functions, with the configuration's defaults."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..base.errors import InputError
from ..diagnosis.candidates import candidates
from ..diagnosis.core.asked import Asked, Disc, MaskedObject, Settings
from ..diagnosis.core.verdict import Diagnosis
from ..diagnosis.course import explain
from ..diagnosis.ready import ready
from ..io.schema import defaults_of, fill_defaults, schema_of
from ..recordings.document import read_document
from ..recordings.scan import timed


def diagnose(
    recording: str | Path,
    *,
    disc: tuple[float, str] | None = None,
    mask: tuple[str | Path, str] | None = None,
    phantom: str | Path | None = None,
    effects: Sequence[str] | None = None,
    nominal_photons: float | None = None,
    view_step: int = 1,
    processes: int = 1,
) -> Diagnosis:
    """Find the physics that a recording of projections has and the plain simulation lacks.

    One of `disc`, `mask` and `phantom` says what was scanned.

    Parameters
    ----------
    recording : str or Path
        Folder with a recording.yaml (docs/recordings.md).
    disc : tuple of (float, str), optional
        A homogeneous cylinder along z: diameter, mm, and material.
    mask : tuple of (str or Path, str), optional
        A homogeneous object: NIfTI image of the share of every voxel that it fills, and material.
    phantom : str or Path, optional
        NIfTI image in HU.
    effects : sequence of str, optional
        Those to try; None: all that projections show.
    nominal_photons : float, optional
        Noise-equivalent photons per pixel in air that the scan is said to have.
    view_step : int, optional
        One view of so many is fitted or held out.
    processes : int, optional
        That fit effects side by side.

    Returns
    -------
    Diagnosis
        `content` is what diagnosis.json holds: `sentence`, `verdict`, `effects`, `excess_removed`, ...

    Raises
    ------
    InputError
        For a recording that cannot be read or is of another kind, for an effect that it does not show, and if what was
        scanned is not said, or more than once.
    """
    said = [one for one in (disc, mask, phantom) if one is not None]
    if len(said) != 1:
        raise InputError(f"diagnose: {len(said)} of disc, mask and phantom are given; give the one that was scanned")
    document = read_document(recording)
    if (kind := document.content["kind"]) != "projections":
        raise InputError(
            f"{document.path}: holds {kind}, which are compared with a study: name the recording in the study's "
            "configuration (docs/diagnosis.md) and run snakemake diagnosis"
        )
    tried = candidates({"nominal_photons": nominal_photons, "effects": effects}, kind, timed(document.content))
    section: dict = {"view_step": view_step}
    fill_defaults(section, schema_of("diagnosis", "recordings")["additionalProperties"])
    settings = Settings(
        **section,
        nominal_photons=nominal_photons,
        disc=None if disc is None else Disc(*disc),
        object=None if mask is None else MaskedObject(str(mask[0]), mask[1]),
    )
    study = defaults_of()
    asked = Asked(recording, settings, study["mu_water_per_mm"], defaults_of("materials"), phantom, study["seed"])
    read, prepared = ready(asked)
    _, found = explain(read.name, prepared, tried, defaults_of("diagnosis")["model_accuracy"], processes)
    return found
