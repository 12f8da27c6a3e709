"""A configured recording of projections, made ready: what was scanned, by which geometry, with what stated."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError
from ..physics.chain import Chain
from ..physics.effect import acts_on_images, names
from ..physics.spectra import KVP
from ..recordings.reading import load
from .observed import scans
from .prepared import Prepared, prepare
from .scanned import scene_of

FLOOR_SAMPLES = 1  # more rays per pixel and direction than the model's: the difference is the numerical floor


def candidates(settings: dict) -> list[str]:
    """The effects that a recording is tried against. Raises InputError for one that the library does not have."""
    chosen = settings.get("effects") or [name for name in names() if not acts_on_images(name)]
    if unknown := [name for name in chosen if name not in names()]:
        raise InputError(f"diagnosis.effects: there is no effect '{unknown[0]}'; there are {', '.join(names())}")
    if on_images := [name for name in chosen if acts_on_images(name)]:
        raise InputError(
            f"diagnosis.effects: {on_images[0]} acts on images, and projections do not show it; take it out"
        )
    if settings.get("nominal_photons") is None:
        chosen = [name for name in chosen if name != "photon_flux"]  # nothing is stated that it could differ from
    return chosen


def ready(
    folder: str | Path,
    settings: dict,
    phantom: str | Path | None,
    mu_water_per_mm: float,
    materials: dict,
    threads: int = 1,
):
    """Read a recording and prepare it for fits: (recording, Prepared).

    folder     of the recording
    settings   diagnosis.recordings.<name> of the configuration, complete
    materials  how HU are divided, as the configuration's section
    phantom    image of the study's phantom, HU; None where `settings` has a disc or an object
    Raises InputError for a recording of another kind, and a nominal anode or tube voltage that no spectrum is known of.
    """
    recording = load(folder)
    if recording.kind != "projections":
        raise InputError(
            f"{recording.document.path}: holds {recording.kind}; only recordings of projections can be diagnosed"
        )
    scene = scene_of(settings, phantom, mu_water_per_mm, materials, threads)
    chains = [Chain(scene, recording.geometry, samples=settings["samples"] + more) for more in (0, FLOOR_SAMPLES)]
    nominal = recording.nominal
    anode, tube_kvp = nominal.get("anode", "W"), nominal.get("tube_kvp")
    if anode not in KVP or (tube_kvp is not None and not KVP[anode][0] <= tube_kvp <= KVP[anode][1]):
        ranges = ", ".join(f"{name} {low:g} to {high:g} kV" for name, (low, high) in KVP.items())
        raise InputError(
            f"{recording.document.path}: no spectrum is known of nominal.anode {anode} at {tube_kvp} kV, only {ranges}"
        )
    further = scans(recording.held_out) if len(recording.held_out) else None
    prepared: Prepared = prepare(
        scans(recording.repeats),
        further,
        chains[0],
        anode=anode,
        tube_kvp=tube_kvp,
        nominal_photons=settings.get("nominal_photons"),
        known=settings["alignment"],
        floor_chain=chains[1],
        step=settings["view_step"],
    )
    return recording, prepared
