"""The line integrals of a phantom without noise: by the baseline, or by the chain with effects of the acquisition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..base.geometry import ScanGeometry
from ..base.pose import IN_PLACE, Pose
from ..io.volumes import Volume
from ..physics.beam.materials import Segmentation
from ..physics.beam.sensors import Sensor
from ..physics.chain import Chain
from ..physics.scenes.line_integrals import check_scannable, clean_line_integrals
from ..physics.scenes.scene import VoxelScene
from ..physics.state import State


def projected(
    phantom: Volume,
    geometry: ScanGeometry,
    physics: Mapping[str, Mapping[str, float]],
    *,
    mu_water_per_mm: float,
    materials: Mapping,
    sensor: Mapping,
    threads: int = 1,
    pose: Pose = IN_PLACE,
) -> tuple[np.ndarray, State | None]:
    """Noise-free line integrals.

    Parameters
    ----------
    phantom : Volume
        HU.
    physics : mapping of str to mapping of str to float
        {effect of the acquisition: {parameter: value}}, complete; empty: the baseline.
    mu_water_per_mm : float
        Of the monochromatic beam, 1/mm.
    materials : mapping
        How HU are divided: keywords of physics.materials.Segmentation.
    sensor : mapping
        Keywords of physics.sensors.Sensor.
    pose : Pose, optional
        Of the phantom.

    Returns
    -------
    line_integrals : ndarray, shape (views, rows, columns)
    state : State or None
        What the chain made of the scene at one photon per pixel, which noise is drawn by; None: baseline.

    Raises
    ------
    InputError
        For a phantom that the scan truncates.
    """
    if not physics:
        return clean_line_integrals(phantom, geometry, mu_water_per_mm, threads, pose), None
    check_scannable(phantom, geometry, pose)
    scene = VoxelScene.of(phantom, Segmentation(**materials), mu_water_per_mm, threads)
    state = Chain(scene, geometry, photons=1.0, sensor=Sensor(**sensor)).state(physics, pose)
    # What is read out beside the photons goes by how many there are, which the noise level says.
    return replace(state, dark=None, dark_air=0.0).line_integrals(), state
