"""Diagnosis of a recording from Python, with the defaults of the configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..base.settings import from_mapping
from ..diagnosis.candidate_effects import candidate_conditions, candidates, check_kinds
from ..diagnosis.request import DiagnosisRequest
from ..diagnosis.run import run_diagnosis
from ..diagnosis.settings import RecordingSettings
from ..diagnosis.verdict.verdict import Diagnosis
from ..io.schema import defaults_of, fill_defaults, schema_of, validate
from ..physics.beam.material_names import library_name
from ..physics.beam.materials import Segmentation
from ..recordings.document import read_document
from ..statistics.proof_record import read_proof_record
from .arguments import (
    check_integer,
    check_mapping,
    check_pair,
    check_path,
    check_positive,
    check_sequence,
    check_text,
    plain,
    public,
)

# Settings of one recording, without keys that name parts of a study.
SECTION = schema_of("diagnosis", "recordings")["additionalProperties"]
OF_STUDY = ("protocol", "physics_from", "baseline_from")
SECTION = SECTION | {"properties": {key: rule for key, rule in SECTION["properties"].items() if key not in OF_STUDY}}


@public
def diagnose(
    recording: str | Path,
    *,
    disc: tuple[float, str] | None = None,
    mask: tuple[str | Path, str] | None = None,
    labels: tuple[str | Path, Mapping[int, str | Mapping]] | None = None,
    shapes: str | tuple[str, Mapping[str, float | str]] | None = None,
    phantom: str | Path | None = None,
    scan: str | Path | None = None,
    simulation: str | Path | None = None,
    unknown: bool = False,
    effects: Sequence[str] | None = None,
    processes: int = 1,
    matters: Mapping[str, float] | None = None,
    **settings,
) -> Diagnosis:
    """Compare a recording with its simulation, and find the physics that the simulation lacks.

    Exactly one of `disc`, `mask`, `labels`, `shapes`, `phantom`, `scan`, `simulation` and `unknown` describes the
    scanned object.

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
    scan : str or Path, optional
        For images: another scan of the object, as a folder of a recording of images or a DICOM series, or as an image
        in HU.
    simulation : str or Path, optional
        Your own simulation of the recording: HDF5 file of projections, or NIfTI file or DICOM folder of images
        (docs/getting-started/own-simulation.md).
    unknown : bool, optional
        The object is not known: no effect is fitted, and only the data are checked.
    effects : sequence of str, optional
        Effects to try. Default: all effects that the recording can show.
    processes : int, optional
        Number of processes.
    matters : mapping of str to float, optional
        Relevance thresholds that replace defaults of `diagnosis.matters`.
    **settings
        Settings of `diagnosis.recordings` in the configuration: `samples`, `view_step`, `nominal_photons`, `alignment`,
        `location`, `slices`, `check_setup`, `object_may_differ`, `object_exact`, `object_uncertainty`, `baseline`,
        `simulation_energy_kev`.

    Returns
    -------
    Diagnosis
        Its `content` is the content of diagnosis.json: `verdict`, `verdict_lines`, `effects`, `excess_removed` and
        more. If the scan set-up or the object is wrong, the verdict says so and no effect is fitted.

    Raises
    ------
    InputError
        If the recording cannot be read, has features or images of `phantom`, or cannot show an effect. Also if a
        setting is unknown, or if not exactly one object is given.
    """
    objects = (disc, mask, labels, shapes, phantom, scan, simulation, unknown or None)
    given = sum(scanned is not None for scanned in objects)
    if given != 1:
        raise InputError(
            f"diagnose: {given} of disc, mask, labels, shapes, phantom, scan, simulation and unknown are given; give "
            "one"
        )
    recording, processes = check_path(recording, "recording"), check_integer(processes, "processes", 1)
    phantom = None if phantom is None else check_path(phantom, "phantom")
    if effects is not None:
        effects = [check_text(name, "effects") for name in check_sequence(effects, "effects", "names of effects")]
    section = plain(settings | _scanned_section(disc, mask, labels, shapes))
    if unknown:
        section["object"] = {"unknown": True}
    if scan is not None:
        section["object"] = {"scan": check_path(scan, "scan")}
    if simulation is not None:
        section["simulation"] = check_path(simulation, "simulation")
    document = read_document(recording)
    kind = document.content["kind"]
    if kind == "features" or (kind == "images" and phantom is not None):
        raise InputError(
            f"{document.path}: holds {kind}, which are compared with a study: name the recording in the study's "
            "configuration (docs/how-to/diagnosis.md) and run snakemake diagnosis"
        )
    thresholds = plain(check_mapping({} if matters is None else matters, "matters", "{quantity: threshold}"))
    validate(thresholds, schema_of("diagnosis", "matters"), "matters")
    schema = SECTION | {"$defs": schema_of()["$defs"]}
    validate(section, schema, "diagnose")
    fill_defaults(section, schema)
    recorded, study = from_mapping(RecordingSettings, section), defaults_of()
    check_kinds({document.content["name"]: recorded}, {document.content["name"]: document})
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
        candidates(replace(recorded, effects=effects), **candidate_conditions(document.content)),
        defaults_of("diagnosis", "model_accuracy"),
        shape_rois=False,
        thresholds=defaults_of("diagnosis", "matters") | thresholds,
        coverage=read_proof_record(RESOURCES / "proof_record.yaml"),
    )


def _scanned_section(disc, mask, labels, shapes) -> dict:
    """Return the arguments that describe the object as a section of the configuration."""
    if disc is not None:
        diameter, material = check_pair(disc, "disc", "diameter in mm and material")
        return {
            "disc": {
                "diameter_mm": check_positive(diameter, "disc[0]"),
                "material": library_name(check_text(material, "disc[1]")),
            }
        }
    if mask is not None:
        file, material = check_pair(mask, "mask", "a NIfTI file and a material")
        return {
            "object": {"mask": check_path(file, "mask[0]"), "material": library_name(check_text(material, "mask[1]"))}
        }
    if labels is not None:
        file, materials = check_pair(labels, "labels", "a NIfTI file and the material of each label")
        materials = check_mapping(materials, "labels[1]", "{label: material}")
        by_label = {str(label): material for label, material in materials.items()}
        return {"object": {"labels": check_path(file, "labels[0]"), "materials": by_label}}
    if shapes is not None:
        what = "a name or file, or a pair of it and its parameters"
        kind, parameters = (shapes, {}) if isinstance(shapes, str | Path) else check_pair(shapes, "shapes", what)
        parameters = check_mapping(parameters, "shapes[1]", "{parameter: value}")
        return {"object": {"kind": check_path(kind, "shapes"), "parameters": dict(parameters)}}
    return {}
