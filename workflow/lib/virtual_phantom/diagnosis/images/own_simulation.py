"""The user's own simulation of images, in place of an object.

Its mean slice is also an object that is constant along z (scanned_object.simulated_object). Effects on raw data change
the reconstruction of this object. The model adds this change to the user's slice, and applies effects on images to the
sum. Without effects, the model is the user's slice.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...base.errors import InputError
from ...base.geometry import Grid
from ...base.names import enumerated, label
from ...io.volumes import Volume
from ...physics.effect import acts_on_images
from ...recordings.images import ImagesRecording, grid_mismatch
from ..fitting.priors import BASELINE_CONFIG_KEY
from ..request import DiagnosisRequest
from ..scanned_object import read_simulated_images


def simulated_images(request: DiagnosisRequest, recording: ImagesRecording) -> Volume:
    """Return the simulation of a recording on its grid, HU. A single slice stands for all.

    Raises
    ------
    InputError
        If the images cannot be read or are on another grid, or if effects on images are declared.
    """
    path, grid = Path(request.settings.simulation), recording.grid
    contained = [label(name) for name in request.settings.baseline if acts_on_images(name)]
    if contained:
        raise InputError(
            f"{BASELINE_CONFIG_KEY}: simulated images contain {enumerated(contained)} already; remove this entry"
        )
    volume = read_simulated_images(path)
    if len(volume.array) > 1:
        expected = grid
    else:
        middle = (*grid.centre_mm[:2], volume.grid.centre_mm[2])
        expected = Grid((1, *grid.shape[1:]), (volume.grid.spacing[0], *grid.spacing[1:]), middle)
    if mismatch := grid_mismatch(volume.grid, expected, path, "the recording"):
        raise InputError(mismatch)
    return Volume(np.broadcast_to(volume.array, grid.shape), grid)
