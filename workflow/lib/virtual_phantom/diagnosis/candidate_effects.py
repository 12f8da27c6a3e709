"""Select the effects that a diagnosis tries on a recording, and check the settings of diagnoses against recordings."""

# Imports stay light: every start of the workflow reads this module, and `preparation` takes seconds to load.

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path

from ..base.errors import InputError
from ..base.geometry import PARALLEL
from ..physics.effect import (
    CLOSE_VIEWS,
    DIFFERENT_SLICES,
    DIVERGENT_BEAM,
    HELIX,
    NEEDS,
    NOISE_LEVEL,
    NOMINAL_PHOTONS,
    SUCCESSIVE_VIEWS,
    acts_on_images,
    load,
    names,
    needs_lengths,
    needs_times,
    require,
)
from ..recordings.scan import ELEMENT, UNKNOWN, has_view_times
from .fitting.priors import declared
from .settings import RecordingSettings

IMAGE_SUFFIXES = (".nii", ".gz", ".nrrd", ".mha", ".mhd", ".dcm")
# {kind of a recording: (test for effects that it does not show, reason)}
HIDDEN = {
    "projections": (acts_on_images, "acts on images, and projections do not show it"),
    "images": (
        lambda name: load(name).pattern and not acts_on_images(name),
        "has one unknown per detector pixel, which images mix",
    ),
}


def is_of_images(simulation: str | Path) -> bool:
    """Return whether a user's own simulation has images, by its name: a folder or an image file."""
    return Path(simulation).is_dir() or Path(simulation).suffix.lower() in IMAGE_SUFFIXES


def candidate_conditions(content: Mapping) -> dict:
    """Return the conditions of a scan that decide which effects are tried, as arguments of `candidates`."""
    kind = content["kind"]
    # A protocol of the study simulates images, and its scan may be a helix.
    scan = content.get("scan", {})
    helical = kind == "images" or scan.get("trajectory") == "helical"
    parallel = scan.get("beam") == PARALLEL
    return {
        "kind": kind,
        "timed": has_view_times(content),
        "corrected": content.get("corrected", ()),
        "helical": helical,
        "parallel": parallel,
        "scaled": scan.get("length_unit") != ELEMENT,
        "sparse": scan.get("views_per_rotation", math.inf) < math.pi / 2 * scan.get("columns", 0),
        "stated_times": bool({"rotation_time_ms", "view_interval_ms"} & scan.keys()),
        "photons": "photons" in content.get("nominal", {}),
    }


def candidates(
    settings: RecordingSettings,
    kind: str = "projections",
    timed: bool = True,
    corrected: Collection[str] = (),
    helical: bool = False,
    parallel: bool = False,
    scaled: bool = True,
    sparse: bool = False,
    stated_times: bool = True,
    photons: bool = False,
) -> list[str]:
    """Return the effects that a diagnosis tries on a recording.

    Parameters
    ----------
    settings : RecordingSettings
        Only `effects`, `nominal_photons`, `view_step`, `simulation` and `baseline` are used.
    kind : {"projections", "images"}, optional
    timed : bool, optional
        Whether the times of the views are known.
    scaled : bool, optional
        Whether lengths are known in mm.
    sparse : bool, optional
        Whether views are too far apart to interpolate between them: fewer per turn than pi / 2 times the columns (A. C.
        Kak and M. Slaney, Principles of Computerized Tomographic Imaging, 1988, section 5.1).
    stated_times : bool, optional
        Whether recording.yaml states them, which counts for images of an object.
    photons : bool, optional
        Whether recording.yaml states the photons.

    Raises
    ------
    InputError
        For an unknown effect, an effect that the recording cannot show, or an effect that needs a key of recording.yaml
        that is not stated.
    """
    hides, why = HIDDEN[kind]
    of_object = kind == "images" and not settings.of_phantom
    timed, helical = timed and (stated_times or not of_object), helical and not of_object
    unmet = {
        NOMINAL_PHOTONS: settings.nominal_photons is None and not photons,
        SUCCESSIVE_VIEWS: (settings.view_step or 1) % 2 == 0,
        HELIX: not helical,
        DIVERGENT_BEAM: parallel,
        CLOSE_VIEWS: settings.simulation is not None and sparse,
        DIFFERENT_SLICES: of_object,
        NOISE_LEVEL: of_object,
    }
    hidden = {name: why for name in names() if hides(name)}
    hidden |= dict.fromkeys(settings.baseline, "is declared under baseline")
    for name in names():
        effect = load(name)
        for correction in set(effect.removed_by) & set(corrected):
            hidden[name] = f"was corrected by the scanner's maker (corrected: {correction} in recording.yaml)"
        if effect.correction and effect.correction not in corrected:
            hidden[name] = (
                f"models a correction by the scanner's maker; state corrected: [{effect.correction}] in recording.yaml"
            )
        for need in effect.needs:
            if unmet[need]:
                hidden[name] = NEEDS[need]
        if not scaled and needs_lengths(name):
            hidden[name] = "depends on lengths in mm; state scan.length_unit: mm in recording.yaml"
        if not timed and needs_times(name):
            hidden[name] = (
                "needs the scan's times; state scan.rotation_time_ms or scan.view_interval_ms in recording.yaml"
            )
    chosen = settings.effects or [name for name in names() if name not in hidden]
    for name in chosen:
        require(name, "diagnosis.effects")
        if name in hidden:
            raise InputError(
                f"diagnosis.effects: {name} {hidden[name]}{'; remove it' if ';' not in hidden[name] else ''}"
            )
    return list(chosen)


def check_accuracy(accuracy: Mapping[str, float]) -> None:
    """Check the names of effects under `diagnosis.model_accuracy`.

    Raises
    ------
    InputError
        For an unknown effect.
    """
    for name in accuracy:
        if name not in ("default", "numerical", *names()):
            raise InputError(
                f"diagnosis.model_accuracy: there is no effect '{name}'; there are default, numerical, "
                f"{', '.join(names())}"
            )


def require_angles(content: Mapping, source: str) -> None:
    """Check that recording.yaml states the view angles, or how they follow.

    Raises
    ------
    InputError
        If they are unknown.
    """
    if content.get("scan", {}).get("angles_deg") == UNKNOWN:
        raise InputError(
            f"{source}: the view angles are not known (scan.angles_deg); state them, or object: {{unknown: true}}"
        )


def check_kinds(diagnosed: Mapping[str, RecordingSettings], recordings: Mapping) -> None:
    """Check that settings under `diagnosis.recordings` fit the kinds of the recordings.

    Raises
    ------
    InputError
        For settings of another kind of recording, for physics from a recording of another kind, and for a baseline that
        is invalid.
    """
    for name, settings in diagnosed.items():
        where, kind = f"diagnosis.recordings.{name}", recordings[name].content["kind"]
        if kind == "features":
            raise InputError(f"{where}: holds features; name comparisons with it under diagnosis.comparisons")
        if kind == "images" and settings.of_phantom and settings.protocol is None:
            raise InputError(
                f"{where}: holds images; name the scanned object (disc, object), or the protocol that simulates the "
                "study's phantom (protocol)"
            )
        if kind == "projections" and settings.protocol is not None:
            raise InputError(f"{where}.protocol: projections have their own geometry; remove this key")
        if not settings.of_unknown:
            require_angles(recordings[name].content, where)
        scan = recordings[name].content.get("scan", {})
        source = scan.get("source_to_isocentre_mm") if scan.get("length_unit") != ELEMENT else None
        if settings.disc is not None and source is not None and settings.disc.diameter_mm >= 2 * source:
            raise InputError(
                f"{where}.disc.diameter_mm is {settings.disc.diameter_mm:g}, but the source is {source:g} mm from the "
                "isocenter, within the disc; give the diameter in mm"
            )
        other = settings.physics_from
        if other is not None and (of := recordings[other].content["kind"]) != kind:
            raise InputError(
                f"{where}.physics_from is '{other}', which holds {of}, not {kind}; name one of the same kind"
            )
        if settings.of_scan and kind != "images":
            raise InputError(
                f"{where}.object.scan: is for recordings of images; make the scan the phantom of the study (phantom.ct)"
            )
        if settings.simulation is not None and (kind == "images") != is_of_images(settings.simulation):
            raise InputError(f"{where}.simulation: the recording holds {kind}; give a simulation of {kind}")
        if kind == "projections" and settings.location.get("turn_deg"):
            raise InputError(f"{where}.location.turn_deg: is for images; change scan.start_angle_deg of recording.yaml")
        if settings.slices is not None and (kind != "images" or settings.of_phantom):
            raise InputError(f"{where}.slices: are for images of an object; remove this key")
        if kind == "images" and not settings.of_phantom and settings.protocol is not None:
            raise InputError(f"{where}.protocol: is for images of the study's phantom; remove it, or disc or object")
        if kind == "images" and settings.of_phantom and settings.location:
            raise InputError(f"{where}.location: images have their location in the files; shift their affine instead")
        if settings.baseline and other is not None:
            raise InputError(f"{where}: physics_from takes all physics from {other}; take it or baseline out")
        declared(settings.baseline, f"{where}.baseline")
