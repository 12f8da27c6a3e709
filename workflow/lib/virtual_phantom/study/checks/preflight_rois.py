"""Whether recordings that are compared call their regions as the study's phantom does."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ...base.errors import InputError
from ...recordings.document import Document


def roi_problems(config: Mapping, documents: Mapping[str, Document]) -> Iterator[str]:
    """What would stop a comparison once everything is simulated.

    Parameters
    ----------
    config : mapping
        Complete.
    documents : mapping of str to Document
        Of the recordings that could be read, by name.

    Yields
    ------
    str
        For each region that recording.yaml has in another tissue class than the phantom, each recording of which no
        region has the name of one of the phantom's, and each comparison that does not choose those of both.
    """
    comparisons = config["analyses"].get("comparison", {})
    compared = {one["recording"] for one in comparisons.values()}
    ours = _classes_of_phantom(config["phantom"]) if compared & documents.keys() else {}
    for name in sorted(compared & documents.keys()):
        path, entries = documents[name].path, documents[name].content.get("rois", [])
        theirs = {one: entry["tissue_class"] for entry in entries for one in _names(entry)}
        if not ours or not theirs:
            continue
        common = theirs.keys() & ours.keys()
        if not common:
            yield (
                f"{path}: rois: none of {', '.join(theirs)} is an ROI of the study, so nothing could be compared; give "
                "those that are alike the study's name and tissue_class: "
                + ", ".join(f"{name} ({tissue})" for name, tissue in ours.items())
            )
        for roi in sorted(common):
            if theirs[roi] != ours[roi]:
                yield (
                    f"{path}: rois: {roi} is of tissue_class {theirs[roi]}, in the study of {ours[roi]}; if they are "
                    f"the same tissue, write tissue_class: {ours[roi]}, else give the ROI another name"
                )
        if common:
            here = {key: one for key, one in comparisons.items() if one["recording"] == name}
            yield from _not_on_both_sides(here, list(ours), list(theirs))


def _not_on_both_sides(comparisons: Mapping, ours: Sequence[str], theirs: Sequence[str]) -> Iterator[str]:
    """Of comparisons with one recording: those that would miss an ROI, after hours of simulation."""
    common = [roi for roi in ours if roi in theirs]
    for key, one in comparisons.items():
        chosen = one.get("rois")
        lacks = {
            "the recording": [roi for roi in chosen or ours if roi not in theirs],
            "the study": [roi for roi in chosen or theirs if roi not in ours],
        }
        if missing := [f"{side} has no ROI {', '.join(rois)}" for side, rois in lacks.items() if rois]:
            yield (
                f"config: analyses.comparison.{key}: {' and '.join(missing)}; to compare what both have, write "
                f"rois: [{', '.join(common)}] there"
            )


def _classes_of_phantom(phantom: Mapping) -> dict[str, str]:
    """Tissue class of every ROI; empty where the section itself is wrong, which is said elsewhere."""
    try:
        if phantom["source"] == "ct":
            from ...phantom.rois import read_roi_entries  # loads pandas, for those who get here

            ct = phantom["ct"]
            entries = read_roi_entries(ct["rois"], ct.get("labels"))
            return {name: entry.tissue_class for entry in entries for name in entry.names}
        if phantom["source"] == "object":
            from ...physics.scenes.objects import read_phantom_rois  # loads numba, for those who get here

            return {roi.name: roi.tissue_class for roi in read_phantom_rois(phantom["object"])}
        from ...phantom.layout import read_layout  # heavy, for those who get here

        return {str(one["name"]): str(one["tissue_class"]) for one in read_layout(phantom["layout"])["rois"]}
    except (InputError, KeyError, TypeError):
        return {}


def _names(entry: Mapping) -> tuple[str, ...]:
    parts = entry.get("parts", 1)
    return (entry["name"],) if parts == 1 else tuple(f"{entry['name']}_{i}" for i in range(1, parts + 1))
