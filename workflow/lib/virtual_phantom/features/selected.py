"""Parameter file of pyradiomics that enables chosen features only, with the settings of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import yaml

from .settings import Extraction


def selected_parameters(features: Sequence[str], extraction: Extraction, parameters: Mapping) -> str:
    """Return the text of a parameter file.

    pyradiomics enables a feature for all image types, so that a feature is enabled if it is chosen for one of them. An
    empty list would enable all features. The text without features is therefore a comment, which pyradiomics rejects.

    Parameters
    ----------
    features : sequence of str
        Names as in feature tables.
    parameters : mapping
        Settings of the study that a parameter file cannot hold: section, stored_offset_hu.
    """
    head = "# Robust features of tables/trust.csv, with the settings of the study.\n"
    if parameters["section"] != "whole":
        head += "# Extract from the largest axial section of each region, as the study did.\n"
    if parameters["stored_offset_hu"]:
        head += (
            f"# Add {parameters['stored_offset_hu']:g} to the image in HU before the extraction, as the study did.\n"
        )
    if not features:
        return head + "# No feature is robust for every change.\n"
    classes: dict[str, list[str]] = {}
    for feature in features:
        _, family, name = feature.split("_", 2)
        if name not in classes.setdefault(family, []):
            classes[family].append(name)
    content = {
        "imageType": {name: dict(settings) for name, settings in extraction.image_types.items()},
        "featureClass": classes,
        "setting": dict(extraction.settings),
    }
    return head + yaml.safe_dump(content, sort_keys=False)
