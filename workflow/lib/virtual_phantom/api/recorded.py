"""A recording read and diagnosed as functions, with the configuration's defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..base.errors import InputError
from ..base.streams import Branch
from ..diagnosis.candidate_effects import candidates, shown_by
from ..diagnosis.comparison.regions import Scanned
from ..diagnosis.comparison.relevance_thresholds import in_practice
from ..diagnosis.preparation import agreement, ready
from ..diagnosis.request import DiagnosisRequest, LabelledObject, Settings, ShapesObject
from ..diagnosis.run import explain
from ..diagnosis.scanned_object import labelled_object, shaped_object
from ..diagnosis.setup.recorded import set_up
from ..diagnosis.setup.verdict import VERDICTS, verdict, with_location
from ..diagnosis.verdict.verdict import Diagnosis
from ..io.schema import defaults_of, fill_defaults, schema_of, validate
from ..io.volumes import read_nifti
from ..physics.beam.material_names import named
from ..recordings.document import read_document
from ..recordings.reading import load_recording
from ..recordings.recording import Recording
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
    """Find the physics that a recording of projections has and the plain simulation lacks.

    One of `disc`, `mask`, `labels`, `shapes` and `phantom` says what was scanned.

    Parameters
    ----------
    recording : str or Path
        Folder with a recording.yaml (docs/how-to/recordings.md).
    disc : tuple of (float, str), optional
        A homogeneous cylinder along z: diameter, mm, and material.
    mask : tuple of (str or Path, str), optional
        A homogeneous object: NIfTI image of the share of every voxel that it fills, and material.
    labels : tuple of (str or Path, mapping of int to (str or mapping)), optional
        A label map: NIfTI image of whole numbers, and the material of each label: a name, or a definition
        (docs/how-to/objects.md).
    shapes : str, or tuple of (str, mapping), optional
        An object of shapes: the name of an object of Virtual Phantom, or the path of a file (docs/how-to/objects.md),
        and values of its parameters.
    phantom : str or Path, optional
        NIfTI image in HU.
    effects : sequence of str, optional
        Those to try; None: all that projections show.
    processes : int, optional
        That fit effects side by side.
    matters : mapping of str to float, optional
        Thresholds in the place of those under `diagnosis.matters` in the configuration.
    **settings
        As under `diagnosis.recordings` in the configuration: `samples`, `view_step`, `nominal_photons`, `alignment`,
        `location`, `check_setup`, `object_may_differ`.

    Returns
    -------
    Diagnosis
        `content` is what diagnosis.json holds: `sentence`, `verdict`, `effects`, `excess_removed`, ... Where the scan
        is described wrong, or another object was scanned, that is the verdict, and nothing was fitted.

    Raises
    ------
    InputError
        For a recording that cannot be read or is of another kind, for an effect that it does not show, for an unknown
        setting, and if what was scanned is not said, or more than once.
    """
    said = [one for one in (disc, mask, labels, shapes, phantom) if one is not None]
    if len(said) != 1:
        raise InputError(
            f"diagnose: {len(said)} of disc, mask, labels, shapes and phantom are given; give the one scanned"
        )
    recording, processes = path(recording, "recording"), whole(processes, "processes", 1)
    phantom = None if phantom is None else path(phantom, "phantom")
    if effects is not None:
        effects = [text(one, "effects") for one in sequence(effects, "effects", "names of effects")]
    scanned: dict = {}
    if disc is not None:
        diameter, material = pair(disc, "disc", "diameter in mm and material")
        scanned["disc"] = {"diameter_mm": positive(diameter, "disc[0]"), "material": named(text(material, "disc[1]"))}
    if mask is not None:
        file, material = pair(mask, "mask", "a NIfTI file and a material")
        scanned["object"] = {"mask": path(file, "mask[0]"), "material": named(text(material, "mask[1]"))}
    if labels is not None:
        file, materials = pair(labels, "labels", "a NIfTI file and the material of each label")
        materials = mapping(materials, "labels[1]", "{label: material}")
        scanned["object"] = {
            "labels": path(file, "labels[0]"),
            "materials": {str(label): material for label, material in materials.items()},
        }
    if shapes is not None:
        what = "a name or file, or a pair of it and its parameters"
        kind_of, parameters = (shapes, {}) if isinstance(shapes, str | Path) else pair(shapes, "shapes", what)
        parameters = mapping(parameters, "shapes[1]", "{parameter: value}")
        scanned["object"] = {"kind": path(kind_of, "shapes"), "parameters": dict(parameters)}
    document = read_document(recording)
    if (kind := document.content["kind"]) != "projections":
        raise InputError(
            f"{document.path}: holds {kind}, which are compared with a study: name the recording in the study's "
            "configuration (docs/how-to/diagnosis.md) and run snakemake diagnosis"
        )
    thresholds = mapping({} if matters is None else matters, "matters", "{quantity: threshold}")
    validate(dict(thresholds), schema_of("diagnosis", "matters"), "matters")
    section, schema = settings | scanned, SECTION | {"$defs": schema_of()["$defs"]}
    validate(section, schema, "diagnose")
    fill_defaults(section, schema)
    tried = candidates(section | {"effects": effects}, **shown_by(document.content))
    study = defaults_of()
    materials = defaults_of("materials")
    asked = DiagnosisRequest(
        recording, Settings.of(section), study["mu_water_per_mm"], materials, phantom, study["seed"]
    )
    setup, read = None, load_recording(recording)
    if asked.settings.check_setup:
        setup = set_up(read, asked)
        if setup.kind in VERDICTS:
            return Diagnosis(None, [], [], verdict(setup, read, asked))
    located = asked.located(setup.content["location"] if setup is not None else {})
    _, prepared = ready(located, read)
    accuracy, differ = defaults_of("diagnosis", "model_accuracy"), asked.settings.object_may_differ
    prepared, found = explain(read.name, prepared, tried, accuracy, processes, object_may_differ=differ)
    table = agreement(read, prepared, found.choice, asked, Branch.AGREEMENT, _regions(asked, read), practice=True)
    content = in_practice(found.content | {"agreement": table}, defaults_of("diagnosis", "matters") | dict(thresholds))
    if setup is not None:
        content = with_location(content, setup.content, asked.settings.location)
    return replace(found, content=content)


def _regions(asked: DiagnosisRequest, recording: Recording) -> Scanned | None:
    """What the images of a recording show; regions of interest are the study's alone."""
    if asked.settings.disc is not None:
        return None
    if isinstance(asked.settings.object, ShapesObject):
        shaped = replace(shaped_object(asked.settings.object), rois=())
        return Scanned.of_shapes(shaped, recording.geometry, asked.mu_water_per_mm)
    if isinstance(asked.settings.object, LabelledObject):
        return Scanned.of_labels(labelled_object(asked.settings.object), asked.mu_water_per_mm)
    if asked.settings.object is not None:
        return Scanned.of_mask(asked.settings.object.mask)
    fine = read_nifti(asked.phantom)
    return Scanned(fine, {}, fine.grid)
