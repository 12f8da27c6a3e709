"""What the configuration asks of a diagnosis: which effects are tried, and on which kinds of recordings.

Apart from `ready`, whose imports take two seconds that every start of the workflow would pay.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ..base.errors import InputError
from ..base.geometry import PARALLEL
from ..physics.effect import OF_A_SPOT, acts_on_images, load, names, needs_times, require
from ..recordings.scan import has_view_times
from .fitting.declared import declared

# {kind of a recording: (which effects it does not show, and why)}
HIDDEN = {
    "projections": (acts_on_images, "acts on images, and projections do not show it"),
    "images": (lambda name: load(name).pattern, "has one unknown per detector pixel, which images mix"),
}

# Effects of one scan, which its scanner's other scans do not share; a gain pattern has no numbers to share.
OF_ONE_SCAN = ("gain_pattern", "motion", "photon_flux")


# {what a maker corrects before projections are stored: effects that this takes away}
CORRECTED = {
    "beam_hardening": ("spectrum",),
    "gain": ("gain_pattern",),
    "flat": ("gain_pattern", "heel"),
    "dark": ("dark_signal",),
    "scatter": ("scatter",),
}


# {effect: the correction that it is}: tried where the maker made it.
MADE_BY_MAKER = {"water_correction": "beam_hardening"}


def shown_by(content: Mapping) -> dict:
    """What of `candidates` a recording says.

    Parameters
    ----------
    content : mapping
        That of recording.yaml.

    Returns
    -------
    dict
        Its arguments after the settings.
    """
    kind = content["kind"]
    # Images are simulated by a protocol of the study, which may be a helix.
    helical = kind == "images" or content.get("scan", {}).get("trajectory") == "helical"
    parallel = content.get("scan", {}).get("beam") == PARALLEL
    return {
        "kind": kind,
        "timed": has_view_times(content),
        "corrected": content.get("corrected", ()),
        "helical": helical,
        "parallel": parallel,
    }


def candidates(
    settings: dict,
    kind: str = "projections",
    timed: bool = True,
    corrected: Collection[str] = (),
    helical: bool = False,
    parallel: bool = False,
) -> list[str]:
    """The effects that a recording of a kind is tried against.

    Parameters
    ----------
    settings : dict
        Of the diagnosis: `effects`, `nominal_photons`, `view_step` and `baseline`.
    kind : {"projections", "images"}, optional
    timed : bool, optional
        Whether the times of its views are known.
    corrected : collection of str, optional
        What was corrected before the recording was stored (CORRECTED).
    helical : bool, optional
        Whether the source moves along the axis.
    parallel : bool, optional
        Whether rays are parallel.

    Raises
    ------
    InputError
        For one that the library does not have, that the kind does not show, or that needs a statement which is missing.
    """
    hides, why = HIDDEN[kind]
    hidden = {name: why for name in names() if hides(name)}
    if settings.get("nominal_photons") is None:
        hidden["photon_flux"] = "needs nominal_photons, which it could differ from and which are not stated"
    hidden |= dict.fromkeys(settings.get("baseline", {}), "is declared under baseline")
    if (settings.get("view_step") or 1) % 2 == 0:
        hidden["focal_spot_wobble"] = "jumps from view to view, and every second view or fewer are fitted (view_step)"
    for name in corrected:
        words = f"was corrected by the scanner's maker (corrected: {name} in recording.yaml)"
        hidden |= dict.fromkeys(CORRECTED.get(name, ()), words)
    for name, correction in MADE_BY_MAKER.items():
        if correction not in corrected:
            hidden[name] = f"is there where the maker corrected it; state corrected: [{correction}] in recording.yaml"
    if not helical:
        hidden["current_along_z"] = "goes along the axis, where the source does not move"
    if parallel:
        hidden |= dict.fromkeys(OF_A_SPOT, "goes by the place of a focal spot, and the beam is parallel")
    if not timed:
        words = "goes by the scan's times; state scan.rotation_time_ms or scan.view_interval_ms in recording.yaml"
        hidden |= {name: words for name in names() if needs_times(name)}
    chosen = settings.get("effects") or [name for name in names() if name not in hidden]
    for name in chosen:
        require(name, "diagnosis.effects")
        if name in hidden:
            raise InputError(
                f"diagnosis.effects: {name} {hidden[name]}{'; take it out' if ';' not in hidden[name] else ''}"
            )
    return chosen


def check_accuracy(accuracy: Mapping[str, float]) -> None:
    """Check that the library has every effect under `diagnosis.model_accuracy`.

    Raises
    ------
    InputError
        For one that it does not have.
    """
    for name in accuracy:
        if name not in ("default", "numerical", *names()):
            raise InputError(
                f"diagnosis.model_accuracy: there is no effect '{name}'; there are default, numerical, "
                f"{', '.join(names())}"
            )


def check_kinds(diagnosed: Mapping, recordings: Mapping) -> None:
    """Check that every recording under `diagnosis.recordings` can be diagnosed as it is configured.

    Parameters
    ----------
    diagnosed : mapping
        The section of the configuration.
    recordings : mapping of str to Document
        By name.

    Raises
    ------
    InputError
        For a recording of features, which are diagnosed by comparison; of images without the protocol that simulates
        them, or with a disc or an object; of projections with a protocol; for one that takes its physics from one of
        another kind; and for a baseline that cannot be.
    """
    for name, settings in diagnosed.items():
        where, kind = f"diagnosis.recordings.{name}", recordings[name].content["kind"]
        if kind == "features":
            raise InputError(f"{where}: holds features; name comparisons with it under diagnosis.comparisons")
        if kind == "images" and "protocol" not in settings:
            raise InputError(f"{where}: holds images; name the protocol that simulates them as `protocol`")
        if kind == "projections" and "protocol" in settings:
            raise InputError(f"{where}.protocol: projections have their own geometry; take it out")
        other = settings.get("physics_from")
        if other is not None and (of := recordings[other].content["kind"]) != kind:
            raise InputError(
                f"{where}.physics_from is '{other}', which holds {of}, not {kind}; name one of the same kind"
            )
        if kind == "images" and {"disc", "object"} & set(settings):
            raise InputError(f"{where}: images are simulated of the study's phantom; take disc or object out")
        if kind == "images" and settings.get("location"):
            raise InputError(f"{where}.location: images have their location in the files; shift their affine instead")
        if settings.get("baseline", {}) and other is not None:
            raise InputError(f"{where}: physics_from takes all physics from {other}; take it or baseline out")
        declared(settings.get("baseline", {}), f"{where}.baseline")
