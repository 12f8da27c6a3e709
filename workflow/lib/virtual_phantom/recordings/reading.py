"""Load a recording of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..features.names import FEATURES
from . import features, images, projections
from .document import read_document
from .features import FeaturesRecording
from .images import ImagesRecording
from .projections import ProjectionsRecording

LOADERS = {"images": images.load, "projections": projections.load}


def load(
    folder: str | Path, wanted: Sequence[str] = FEATURES
) -> ImagesRecording | ProjectionsRecording | FeaturesRecording:
    """Read the recording in a folder. Every file is read once and checked; images and projections again when used.

    Parameters
    ----------
    wanted : sequence of str, optional
        The study's features, which are kept of a table that has more.

    Raises
    ------
    InputError
        One line that names the file, for anything that is missing, broken or not what recording.yaml says.
    """
    document = read_document(folder)
    if document.content["kind"] == "features":
        return features.load(document, tuple(wanted))
    return LOADERS[document.content["kind"]](document)
