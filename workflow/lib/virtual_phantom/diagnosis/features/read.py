"""Input of a feature diagnosis, from the tables of the study and of the recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ...features.settings import read_extraction
from ...io.files import read_csv
from ...io.volumes import read_nifti
from ...recordings.reference import select_rows
from .responses import Responses, compared, responses


def read_responses(
    properties: str | Path,
    recorded: str | Path,
    image: str | Path,
    *,
    recording: str,
    conditions: Mapping,
    dimensions: int,
    stored_offset_hu: float,
    parameter_file: str | None,
    rois: Sequence[str] | None,
) -> tuple[Responses, dict[str, str]]:
    """Read the responses of features to image properties for one comparison.

    Parameters
    ----------
    properties, recorded : str or Path
        CSV files: features of the changed images (`changes.property_tables`), and features of the recording.
    image : str or Path
        NIfTI file of a simulated image, for the voxel size.
    recording : str
        Name for messages.
    conditions : mapping
        {column: value} of the compared rows of the recording.
    dimensions, stored_offset_hu
        See comparability.comparable.
    parameter_file : str or None
        Parameter file of pyradiomics of the study.
    rois : sequence of str or None
        Compared ROIs; None: all common ROIs.

    Returns
    -------
    responses : Responses
        Responses of the compared features.
    not_compared : dict of str to str
        {feature: reason}.

    Raises
    ------
    InputError
        If a file cannot be read or no feature can be compared.
    """
    rows = select_rows(read_csv(recorded), dict(conditions), f"recording {recording}")
    table = read_csv(properties)
    features, not_compared = compared(table, rows, dimensions, stored_offset_hu, read_extraction(parameter_file))
    return responses(table, rows, features, read_nifti(image).grid, rois), not_compared
