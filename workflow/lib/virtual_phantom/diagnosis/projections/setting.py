"""A configured recording, made ready: what was scanned, by which geometry, with what stated."""

from __future__ import annotations

from pathlib import Path

from ...base.errors import InputError
from ...physics.chain import AIR, EVEN, Chain
from ...physics.sensors import stated as stated_sensor
from ...physics.spectra import KVP, TUNGSTEN, Anode
from ...recordings.reading import load as read
from ...recordings.scan import assumed
from ..images.setting import Protocol, ready_images
from .caveats import check_scans
from .numerical import model_and_floor
from .observed import scans
from .prepared import prepare
from .scanned import coarse_scene, scene_of


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
    anode = Anode(nominal.get("anode", TUNGSTEN.target), nominal.get("anode_angle_deg", TUNGSTEN.angle_deg))
    target, tube_kvp = anode.target, nominal.get("tube_kvp")
    if target not in KVP or (tube_kvp is not None and not KVP[target][0] <= tube_kvp <= KVP[target][1]):
        ranges = ", ".join(f"{name} {low:g} to {high:g} kV" for name, (low, high) in KVP.items())
        raise InputError(
            f"{recording.document.path}: no spectrum is known of nominal.anode {target} at {tube_kvp} kV, only {ranges}"
        )
    sensor = stated_sensor(**nominal.get("sensor", {}))
    stated = {
        "anode": anode,
        "tube_kvp": tube_kvp,
        "nominal_photons": settings.get("nominal_photons"),
        "known": settings["alignment"],
    }
    samples = settings["samples"]
    if recording.kind == "images":
        setting = Protocol(**protocol)
        chains = model_and_floor(scene, setting.geometry, samples, sensor=sensor, readout=AIR)
        return recording, ready_images(recording, setting, chains, mu_water_per_mm, seed, threads, stated)
    taken = scans(recording.repeats)
    more = {
        "sensor": sensor,
        "illumination": recording.scan.get("illumination", EVEN),
        "readout": AIR if taken.white is None else float(taken.white.mean()),
    }
    model, floor = model_and_floor(scene, recording.geometry, samples, **more)
    coarse = None
    if not {"disc", "object"} & set(settings):
        voxels = coarse_scene(phantom, mu_water_per_mm, materials, threads)
        coarse = Chain(voxels, recording.geometry, samples=samples, **more)
    further = scans(recording.held_out) if len(recording.held_out) else None
    check_scans(taken.every(settings["view_step"]), str(recording.document.path))
    return recording, prepare(
        taken,
        further,
        model,
        floor_chain=floor,
        coarse_chain=coarse,
        step=settings["view_step"],
        lacking=assumed(recording.scan),
        **stated,
    )
