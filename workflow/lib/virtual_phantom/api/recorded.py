"""Diagnosis of a recording from Python, with the defaults of the configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..base.settings import from_mapping
from ..diagnosis.candidate_effects import candidates, shown_by
from ..diagnosis.request import DiagnosisRequest
from ..diagnosis.run import run_diagnosis
from ..diagnosis.settings import RecordingSettings
from ..diagnosis.verdict.verdict import Diagnosis
from ..io.schema import defaults_of, fill_defaults, schema_of, validate
from ..physics.beam.material_names import library_name
from ..physics.beam.materials import Segmentation
from ..recordings.document import read_document
from ..statistics.proof_record import read_proof_record
from .arguments import mapping, pair, path, positive, public, sequence, text, whole

SECTION = schema_of("diagnosis", "recordings")["additionalProperties"]  # of one recording


@public
def diagnose(
    recording: str | Path,
    *,
    disc: tuple[float, str] | None = None,
    mask: tuple[str | Path, str] | None = None,
    labels: tuple[str | Path, Mapping[int, str | Mapping]] | None = None,
    shapes: str | tuple[str, Mapping[str, float | str]] | None = None,
    phantom: str | Path | None = None,
    effects: Sequence[str] | None = None,
    processes: int = 1,
    matters: Mapping[str, float] | None = None,
    **settings,
) -> Diagnosis:
    """Find the physics that is missing from the plain simulation of a recording of projections.

    Exactly one of `disc`, `mask`, `labels`, `shapes` and `phantom` describes the scanned object.

    Parameters
    ----------
    recording : str or Path
        Folder with a recording.yaml (docs/how-to/recordings.md).
    disc : tuple of (float, str), optional
        Homogeneous cylinder along z: diameter in mm, and material.
    mask : tuple of (str or Path, str), optional
        Homogeneous object: NIfTI image of volume fractions (0 to 1), and material.
    labels : tuple of (str or Path, mapping of int to (str or mapping)), optional
        Label map: NIfTI image of integers, and for each label the name or definition of its material
        (docs/how-to/objects.md).
    shapes : str, or tuple of (str, mapping), optional
        Object of shapes: name of a shipped object or path of a file, with values of its parameters
        (docs/how-to/objects.md).
    phantom : str or Path, optional
        NIfTI image in HU.
    effects : sequence of str, optional
        Candidate effects. Default: all that projections show.
    processes : int, optional
        Number of processes.
    matters : mapping of str to float, optional
        Relevance thresholds that replace those of `diagnosis.matters`.
    **settings
        Settings of `diagnosis.recordings` in the configuration: `samples`, `view_step`, `nominal_photons`, `alignment`,
        `location`, `check_setup`, `object_may_differ`.

    Returns
    -------
    Diagnosis
        Its `content` is that of diagnosis.json: `verdict`, `verdict_lines`, `effects`, `excess_removed` and more. If
        the scan set-up or the object is wrong, the verdict says so and no effect is fitted.

    Raises
    ------
    InputError
        For a recording that cannot be read or holds no projections, for an effect that it does not show, for an
        unknown setting, and unless exactly one object is given.
    """
    given = [scanned for scanned in (disc, mask, labels, shapes, phantom) if scanned is not None]
    if len(given) != 1:
        raise InputError(
            f"diagnose: {len(given)} of disc, mask, labels, shapes and phantom are given; give the one scanned"
        )
    recording, processes = path(recording, "recording"), whole(processes, "processes", 1)
    phantom = None if phantom is None else path(phantom, "phantom")
    if effects is not None:
        effects = [text(name, "effects") for name in sequence(effects, "effects", "names of effects")]
    section = settings | _scanned_section(disc, mask, labels, shapes)
    document = read_document(recording)
    if (kind := document.content["kind"]) != "projections":
        raise InputError(
            f"{document.path}: holds {kind}, which are compared with a study: name the recording in the study's "
            "configuration (docs/how-to/diagnosis.md) and run snakemake diagnosis"
        )
    thresholds = mapping({} if matters is None else matters, "matters", "{quantity: threshold}")
    validate(dict(thresholds), schema_of("diagnosis", "matters"), "matters")
    schema = SECTION | {"$defs": schema_of()["$defs"]}
    validate(section, schema, "diagnose")
    fill_defaults(section, schema)
    recorded, study = from_mapping(RecordingSettings, section), defaults_of()
    request = DiagnosisRequest(
        recording,
        recorded,
        study["mu_water_per_mm"],
        Segmentation(**defaults_of("materials")),
        phantom,
        study["seed"],
        threads=processes,
    )
    return run_diagnosis(
        request,
        candidates(replace(recorded, effects=effects), **shown_by(document.content)),
        defaults_of("diagnosis", "model_accuracy"),
        shape_rois=False,
        thresholds=defaults_of("diagnosis", "matters") | dict(thresholds),
        coverage=read_proof_record(RESOURCES / "proof_record.yaml"),
    )


def _scanned_section(disc, mask, labels, shapes) -> dict:
    """Return the arguments that describe the object as a section of the configuration."""
    if disc is not None:
        diameter, material = pair(disc, "disc", "diameter in mm and material")
        return {
            "disc": {"diameter_mm": positive(diameter, "disc[0]"), "material": library_name(text(material, "disc[1]"))}
        }
    if mask is not None:
        file, material = pair(mask, "mask", "a NIfTI file and a material")
        return {"object": {"mask": path(file, "mask[0]"), "material": library_name(text(material, "mask[1]"))}}
    if labels is not None:
        file, materials = pair(labels, "labels", "a NIfTI file and the material of each label")
        materials = mapping(materials, "labels[1]", "{label: material}")
        by_label = {str(label): material for label, material in materials.items()}
        return {"object": {"labels": path(file, "labels[0]"), "materials": by_label}}
    if shapes is not None:
        what = "a name or file, or a pair of it and its parameters"
        kind, parameters = (shapes, {}) if isinstance(shapes, str | Path) else pair(shapes, "shapes", what)
        parameters = mapping(parameters, "shapes[1]", "{parameter: value}")
        return {"object": {"kind": path(kind, "shapes"), "parameters": dict(parameters)}}
    return {}
