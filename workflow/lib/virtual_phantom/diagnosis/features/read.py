"""A recording's features and the changed properties of simulated images, read from the study's tables."""

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
    parameters: str | None,
    rois: Sequence[str] | None,
) -> tuple[Responses, dict[str, str]]:
    """What every property does to every feature of one comparison.

    Parameters
    ----------
    properties, recorded : str or Path
        CSV files: of `properties.property_tables`, and of the recording's features.
    image : str or Path
        One of the simulated images, NIfTI: whose voxels they have.
    recording : str
        Its name, for messages.
    conditions : mapping
        {column: value} of the recording's rows that are compared.
    dimensions : {2, 3}
    stored_offset_hu : float
        Both of the recording's features, as comparability.comparable takes them.
    parameters : str or None
        The study's parameter file of pyradiomics.
    rois : sequence of str or None
        That are compared; None for all that both have.

    Returns
    -------
    not_compared : dict of str to str
        {feature: why}.

    Raises
    ------
    InputError
        For a file that cannot be read, and where nothing can be compared.
    """
    rows = select_rows(read_csv(recorded), dict(conditions), f"recording {recording}")
    table = read_csv(properties)
    features, not_compared = compared(table, rows, dimensions, stored_offset_hu, read_extraction(parameters))
    return responses(table, rows, features, read_nifti(image).grid, rois), not_compared
