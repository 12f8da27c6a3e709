"""Loading of recordings of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..features.names import FEATURES
from .document import read_document
from .features import FeaturesRecording, load_features
from .images import ImagesRecording, load_images
from .projections import ProjectionsRecording, load_projections

LOADERS = {"images": load_images, "projections": load_projections}


def load_recording(
    folder: str | Path, wanted: Sequence[str] = FEATURES
) -> ImagesRecording | ProjectionsRecording | FeaturesRecording:
    """Load the recording in a folder: read and check every file. Images and projections are read again when used.

    Parameters
    ----------
    wanted : sequence of str, optional
        Features of the study, which are kept if a table has more.

    Raises
    ------
    InputError
        One line per mistake that names the file, for anything missing, broken or different from recording.yaml.
    """
    document = read_document(folder)
    if document.content["kind"] == "features":
        return load_features(document, tuple(wanted))
    return LOADERS[document.content["kind"]](document)
