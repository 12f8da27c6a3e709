"""The user's own simulation of a recording, in place of an object.

Its line integrals become path lengths in water, which reproduce the simulation when the physics that it already models
(`baseline`) is applied to them. This physics is therefore never applied twice. Datasets path_lengths_mm/MATERIAL of the
file give path lengths through other materials, which are subtracted from those in water.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np

from ...base.errors import InputError
from ...base.geometry import OrbitGeometry
from ...base.names import enumerated, label
from ...io.exchange import opened
from ...physics.beam.material_names import COMPOUNDS, ELEMENTS, library_name
from ...physics.beam.materials import attenuation_per_mm, energy_of
from ...physics.chain import EVEN, Chain
from ...physics.effect import PER_AIR_PHOTON, acts_on_images, load
from ...physics.scenes.scene import Scene
from ...physics.scenes.simulated import SimulatedScene
from ...physics.state import AIR
from ...recordings.projections import ADVICE, Projections, ProjectionsRecording, read_acquisition
from ..fitting.priors import BASELINE_CONFIG_KEY, declared, stated_physics
from ..request import DiagnosisRequest, nominal_settings
from ..scanned_object import scene_of
from .observed import LEAST_TRANSMISSION

MOST_FINER = 8  # times the columns and rows of the recording; finer pixels only cost memory
MOST_RAYS = 4  # per pixel and direction, as for shapes
TOLERANCE = 1e-4  # largest difference of line integrals from the simulation; a tenth of a low noise
MOST_CORRECTIONS = 60  # before a simulation is refused: a factor of 0.85 each would reach the tolerance
PATH_LENGTHS = "path_lengths_mm"  # group of a simulation's file


def scene_of_scan(request: DiagnosisRequest, recording: ProjectionsRecording) -> Scene:
    """Return the scene of a recording of projections: its object, or the user's own simulation.

    Raises
    ------
    InputError
        As scene_of and simulated_scene.
    """
    return scene_of(request) if request.settings.simulation is None else simulated_scene(request, recording)


def simulated_scene(request: DiagnosisRequest, recording: ProjectionsRecording) -> SimulatedScene:
    """Return the scene of the user's own simulation.

    Raises
    ------
    InputError
        If the simulation does not fit the recording, or declared physics cannot be removed from it.
    """
    settings, path = request.settings, Path(request.settings.simulation)
    geometry, acquisition, lines = read_simulation(path, recording)
    nominal = nominal_settings(recording)
    detector = {
        "sensor": nominal.sensor,
        "illumination": recording.scan.get("illumination", EVEN),
        "readout": AIR if acquisition.log else float((acquisition.white - acquisition.dark).mean()),
    }
    energy = settings.simulation_energy_kev or energy_of("water", request.mu_water_per_mm)
    physics = _on_line_integrals(stated_physics(declared(settings.baseline, BASELINE_CONFIG_KEY)))
    materials = _path_lengths_mm(path, lines.shape)
    water, *other = (attenuation_per_mm(material, [energy])[0] for material in ("water", *materials))
    paths = [mu / water * mm for mu, mm in zip(other, materials.values(), strict=True)]
    paths = np.stack([lines / water - sum(paths), *materials.values()])
    scene = SimulatedScene(paths, geometry, energy, request.threads, ("water", *materials))
    return _without(scene, lines, physics, path, anode=nominal.anode, **detector) if physics else scene


def read_simulation(path: Path, recording: ProjectionsRecording) -> tuple[OrbitGeometry, Projections, np.ndarray]:
    """Return the geometry, the data, and the line integrals (views, rows, columns) of a simulation.

    Raises
    ------
    InputError
        If it cannot be read, does not fit the recording, or has dead pixels.
    """
    geometry = finer_geometry(path, recording.geometry)
    acquisition = read_acquisition(path, geometry)
    lines = acquisition.line_integrals(LEAST_TRANSMISSION).astype(np.float64)
    if not np.isfinite(lines).all():
        raise InputError(f"{path}: has dead pixels (white field not above dark field); a simulation has none")
    return geometry, acquisition, lines


def _path_lengths_mm(path: Path, shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return path lengths in materials other than water, which a simulation may give.

    Raises
    ------
    InputError
        For an unknown material, or values that are not finite or have another shape than the line integrals.
    """
    with opened(path, ADVICE) as file:
        given = file.get(PATH_LENGTHS, {})
        found = {library_name(name): np.asarray(data, np.float64) for name, data in given.items()}
    for material, values in found.items():
        where = f"{path}: {PATH_LENGTHS}/{material}"
        if material == "water" or material not in (*COMPOUNDS, *ELEMENTS):
            materials = ", ".join(name for name in (*COMPOUNDS, *ELEMENTS) if name != "water")
            raise InputError(f"{where}: is no material beside water; use {materials}")
        if values.shape != shape or not np.isfinite(values).all():
            raise InputError(f"{where}: is not one finite length per line integral; give shape {shape}, in mm")
    return found


def finer_geometry(path: Path, geometry: OrbitGeometry) -> OrbitGeometry:
    """Return the geometry of a simulation, whose pixels may be finer by whole numbers than in the recording."""
    with opened(path, ADVICE) as file:
        data = file.get("exchange/data")
        shape = data.shape if isinstance(data, h5py.Dataset) and len(data.shape or ()) == 3 else geometry.shape
    down, across = (
        count // stated if count % stated == 0 and 1 < count // stated <= MOST_FINER else 1
        for count, stated in zip(shape[1:], (geometry.rows, geometry.columns), strict=True)
    )
    return geometry.divided(down, across)


def rays_of_simulation(scene: Scene, shape: tuple[int, int, int]) -> int | None:
    """Return the rays per pixel and direction for a simulation: its pixels in a pixel of the recording; else None.

    Parameters
    ----------
    shape : tuple of 3 int
        Views, rows and columns of the recording.
    """
    if not isinstance(scene, SimulatedScene):
        return None
    return min(max(scene.geometry.rows // shape[1], scene.geometry.columns // shape[2]), MOST_RAYS)


def _on_line_integrals(physics: Mapping[str, Mapping[str, float]]) -> dict[str, Mapping[str, float]]:
    """Return the declared effects that a simulation of projections can contain.

    Raises
    ------
    InputError
        For effects whose size depends on the number of photons, which a simulation does not state.
    """
    for name, values in physics.items():
        for parameter in load(name).parameters:
            of_photons = parameter.reach is not None and parameter.reach.of == PER_AIR_PHOTON
            if of_photons and values[parameter.name] != parameter.neutral:
                raise InputError(
                    f"{BASELINE_CONFIG_KEY}.{name}.{parameter.name}: depends on the number of photons, so it cannot be "
                    "declared of a simulation; simulate without it"
                )
    return {name: values for name, values in physics.items() if not acts_on_images(name)}


def _without(
    scene: SimulatedScene, lines: np.ndarray, physics: Mapping, path: Path, *, anode, **detector
) -> SimulatedScene:
    """Return the scene that reproduces line integrals of a simulation with declared effects.

    Path lengths are corrected by the remaining difference over the attenuation of water until it vanishes. For blurs
    this is the iteration of P. H. van Cittert (Z. Phys. 69, 298, 1931).

    Raises
    ------
    InputError
        If the difference does not vanish.
    """
    water = scene.attenuation_per_mm[0]
    paths = scene.paths_mm
    for _ in range(MOST_CORRECTIONS):
        chain = Chain(scene, scene.geometry, samples=1, **detector)
        missed = lines - chain.state(physics, photons=1.0, anode=anode).line_integrals()
        if not np.isfinite(missed).all():
            break
        if np.abs(missed).max() < TOLERANCE:
            return scene
        paths = np.concatenate([paths[:1] + missed / water, paths[1:]])
        scene = SimulatedScene(paths, scene.geometry, scene.energy_kev, scene.threads, scene.materials)
    declares = enumerated([label(name) for name in physics])
    raise InputError(
        f"{path}: no object gives these line integrals with {declares}; declare under baseline only what the "
        "simulation models, with its values"
    )
