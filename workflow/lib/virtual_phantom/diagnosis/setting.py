"""A configured recording, made ready: what was scanned, by which geometry, with what stated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..errors import InputError
from ..physics.chain import EVEN, Chain
from ..physics.effect import acts_on_images, load, names
from ..physics.spectra import KVP
from ..recordings.reading import load as read
from .caveats import check_scans
from .images.setting import Protocol, ready_images
from .observed import scans
from .prepared import prepare
from .scanned import coarse_scene, scene_of

FLOOR_SAMPLES = 1  # more rays per pixel and direction than the model's: the difference is the numerical floor


def candidates(settings: dict, kind: str = "projections") -> list[str]:
    """The effects that a recording of a kind is tried against.

    Raises InputError for one that the library does not have or that the kind does not show.
    """
    hidden = _hidden(kind)
    chosen = settings.get("effects") or [name for name in names() if name not in hidden]
    for name in chosen:
        if name not in names():
            raise InputError(f"diagnosis.effects: there is no effect '{name}'; there are {', '.join(names())}")
        if name in hidden:
            raise InputError(f"diagnosis.effects: {name} {hidden[name]}; take it out")
    if settings.get("nominal_photons") is None:
        chosen = [name for name in chosen if name != "photon_flux"]  # nothing is stated that it could differ from
    return chosen


def _hidden(kind: str) -> dict[str, str]:
    """Effects that recordings of a kind do not show, and why."""
    if kind == "images":
        return {name: "has one unknown per detector pixel, which images mix" for name in names() if load(name).pattern}
    return {name: "acts on images, and projections do not show it" for name in names() if acts_on_images(name)}


def check_kinds(diagnosed: Mapping, recordings: Mapping) -> None:
    """Raise InputError for a recording under `diagnosis.recordings` that is of features, which are diagnosed by
    comparison, or of images without the protocol that simulates them, or of projections with one.

    recordings   {name: RecordingDocument}
    """
    for name, settings in diagnosed.items():
        where, kind = f"diagnosis.recordings.{name}", recordings[name].content["kind"]
        if kind == "features":
            raise InputError(f"{where}: holds features; name comparisons with it under diagnosis.comparisons")
        if kind == "images" and "protocol" not in settings:
            raise InputError(f"{where}: holds images; name the protocol that simulates them as `protocol`")
        if kind == "projections" and "protocol" in settings:
            raise InputError(f"{where}.protocol: projections have their own geometry; take it out")
        if kind == "images" and {"disc", "object"} & set(settings):
            raise InputError(f"{where}: images are simulated of the study's phantom; take disc or object out")


def ready(
    folder: str | Path,
    settings: dict,
    phantom: str | Path | None,
    mu_water_per_mm: float,
    materials: dict,
    seed: int = 0,
    protocol: dict | None = None,
    threads: int = 1,
):
    """Read a recording and prepare it for fits: (recording, Prepared).

    folder     of the recording
    settings   diagnosis.recordings.<name> of the configuration, complete
    materials  how HU are divided, as the configuration's section
    phantom    image of the study's phantom, HU; None where `settings` has a disc or an object
    seed       of the study, for simulated noise
    protocol   of images: their scan, projections, grid, algorithm, settings and engine (images.setting.Protocol)
    Raises InputError for a recording of another kind, and a nominal anode or tube voltage that no spectrum is known of.
    """
    recording = read(folder)
    if recording.kind not in ("projections", "images"):
        raise InputError(f"{recording.document.path}: holds {recording.kind}, which are diagnosed by comparison")
    scene = scene_of(settings, phantom, mu_water_per_mm, materials, threads)
    nominal = recording.nominal
    anode, tube_kvp = nominal.get("anode", "W"), nominal.get("tube_kvp")
    if anode not in KVP or (tube_kvp is not None and not KVP[anode][0] <= tube_kvp <= KVP[anode][1]):
        ranges = ", ".join(f"{name} {low:g} to {high:g} kV" for name, (low, high) in KVP.items())
        raise InputError(
            f"{recording.document.path}: no spectrum is known of nominal.anode {anode} at {tube_kvp} kV, only {ranges}"
        )
    stated = {
        "anode": anode,
        "tube_kvp": tube_kvp,
        "nominal_photons": settings.get("nominal_photons"),
        "known": settings["alignment"],
    }
    samples = [settings["samples"] + more for more in (0, FLOOR_SAMPLES)]
    if recording.kind == "images":
        setting = Protocol(**protocol)
        chains = [Chain(scene, setting.geometry, samples=count) for count in samples]
        return recording, ready_images(recording, setting, chains, mu_water_per_mm, seed, threads, stated)
    illumination = recording.document.content["scan"].get("illumination", EVEN)
    chains = [Chain(scene, recording.geometry, samples=count, illumination=illumination) for count in samples]
    coarse = None
    if not {"disc", "object"} & set(settings):
        coarse = Chain(
            coarse_scene(phantom, mu_water_per_mm, materials, threads),
            recording.geometry,
            samples=settings["samples"],
            illumination=illumination,
        )
    further = scans(recording.held_out) if len(recording.held_out) else None
    taken = scans(recording.repeats)
    check_scans(taken, str(recording.document.path))
    return recording, prepare(
        taken,
        further,
        chains[0],
        floor_chain=chains[1],
        coarse_chain=coarse,
        step=settings["view_step"],
        **stated,
    )
