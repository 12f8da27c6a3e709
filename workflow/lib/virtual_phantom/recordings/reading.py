"""Load a recording of any kind."""

from __future__ import annotations

from pathlib import Path

from . import features, images, projections
from .document import read_document
from .features import FeaturesRecording
from .images import ImagesRecording
from .projections import ProjectionsRecording

LOADERS = {"images": images.load, "projections": projections.load, "features": features.load}


def load(folder: str | Path) -> ImagesRecording | ProjectionsRecording | FeaturesRecording:
    """Read the recording in a folder. Every file is read once and checked; images and projections again when used.

    Returns
    -------
    ImagesRecording, ProjectionsRecording or FeaturesRecording

    Raises
    ------
    InputError
        One line that names the file, for anything that is missing, broken or not what recording.yaml says.
    """
    document = read_document(folder)
    return LOADERS[document.content["kind"]](document)
