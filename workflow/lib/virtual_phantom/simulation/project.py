"""Noise-free line integrals of a phantom, by the baseline or by the chain with effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from ..base.errors import InputError, refusing
from ..base.geometry import ScanGeometry
from ..base.pose import IN_PLACE, Pose
from ..io.files import read_text
from ..io.volumes import Volume
from ..physics.beam.materials import Segmentation
from ..physics.beam.sensors import Sensor
from ..physics.chain import Chain
from ..physics.effect import acts_on_images, checked
from ..physics.scenes.line_integrals import check_scannable, clean_line_integrals
from ..physics.scenes.scene import VoxelScene
from ..physics.state import State


def project_phantom(
    phantom: Volume,
    geometry: ScanGeometry,
    physics: Mapping[str, Mapping[str, float]],
    *,
    mu_water_per_mm: float,
    materials: Segmentation,
    sensor: Sensor,
    threads: int = 1,
    pose: Pose = IN_PLACE,
    samples: int = 1,
) -> tuple[np.ndarray, State | None]:
    """Return the noise-free line integrals of a phantom.

    Parameters
    ----------
    phantom : Volume
        HU.
    physics : mapping of str to mapping of str to float
        {effect of the acquisition: {parameter: value}}, complete; empty: the baseline.
    mu_water_per_mm : float
        Attenuation of water for the monochromatic beam, 1/mm.
    materials : Segmentation
        Decomposition of HU.
    pose : Pose, optional
        Pose of the phantom.
    samples : int, optional
        Rays per pixel and direction; 1: rays through the centers of the pixels.

    Returns
    -------
    line_integrals : ndarray, shape (views, rows, columns)
    state : State or None
        State of the chain at one photon per pixel, from which noise is simulated; None: baseline with one sample.

    Raises
    ------
    InputError
        If the phantom extends beyond the field of view.
    """
    if not physics and samples == 1:
        return clean_line_integrals(phantom, geometry, mu_water_per_mm, threads, pose), None
    check_scannable(phantom, geometry, pose)
    scene = VoxelScene.of(phantom, materials, mu_water_per_mm, threads)
    state = Chain(scene, geometry, photons=1.0, samples=samples, sensor=sensor).state(physics, pose)
    # The dark signal is relative to the number of photons, which is not known before the noise level.
    return replace(state, dark=None, dark_air=0.0).line_integrals(), state


def read_diagnosed_physics(path: str | Path) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Read the effects in the physics.yaml of a diagnosis.

    Returns
    -------
    of_scans, of_images : dict of str to dict of str to float
        {effect: {parameter: value}}, complete: effects of the acquisition, and effects on images.

    Raises
    ------
    InputError
        If the file is missing or broken, or names no effect.
    """
    text = read_text(path, "make it again")
    with refusing(
        f"{path}: is not the physics.yaml of a diagnosis", yaml.YAMLError, ValueError, TypeError, advice="make it again"
    ):
        stated = (yaml.safe_load(text) or {}).get("physics")
        effects = checked(stated or {}, str(path))
    if not effects:
        sentence = text.partition("\n")[0].lstrip("# ").rstrip(".")
        raise InputError(f"{path}: names no effect ({sentence}); remove physics.from, which changes nothing here")
    of_images = {name: values for name, values in effects.items() if acts_on_images(name)}
    return {name: values for name, values in effects.items() if name not in of_images}, of_images
