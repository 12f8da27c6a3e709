"""Check that compared recordings and the phantom use the same names and tissue classes of ROIs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ...base.errors import InputError
from ...base.settings import PhantomSettings, RoiEntry
from ...config.settings import Comparison, Study
from ...recordings.document import Document


def roi_problems(study: Study, documents: Mapping[str, Document]) -> Iterator[str]:
    """Yield errors that would otherwise stop a comparison after the simulation.

    These are ROIs with different tissue classes, recordings without any ROI of the phantom, and comparisons with an ROI
    that one side lacks.

    Parameters
    ----------
    documents : mapping of str to Document
        Documents of the recordings that could be read, by name.
    """
    comparisons = study.analyses.comparison
    compared = {comparison.recording for comparison in comparisons.values()}
    of_study = _classes_of_phantom(study.phantom) if compared & documents.keys() else {}
    for name in sorted(compared & documents.keys()):
        path, entries = documents[name].path, documents[name].content.get("rois", [])
        described = [RoiEntry(entry["name"], entry["tissue_class"], parts=entry.get("parts", 1)) for entry in entries]
        recorded = {roi: entry.tissue_class for entry in described for roi in entry.names}
        if not of_study or not recorded:
            continue
        common = recorded.keys() & of_study.keys()
        if not common:
            yield (
                f"{path}: rois: none of {', '.join(recorded)} is an ROI of the study, so no ROI can be compared; give "
                "matching ROIs the name and tissue_class of the study: "
                + ", ".join(f"{name} ({tissue})" for name, tissue in of_study.items())
            )
        for roi in sorted(common):
            if recorded[roi] != of_study[roi]:
                yield (
                    f"{path}: rois: {roi} has tissue_class {recorded[roi]}, in the study {of_study[roi]}; if they are "
                    f"the same tissue, write tissue_class: {of_study[roi]}, otherwise rename the ROI"
                )
        if common:
            with_recording = {key: entry for key, entry in comparisons.items() if entry.recording == name}
            yield from _not_on_both_sides(with_recording, list(of_study), list(recorded))


def _not_on_both_sides(
    comparisons: Mapping[str, Comparison], of_study: Sequence[str], recorded: Sequence[str]
) -> Iterator[str]:
    """Yield a line for each comparison with one recording in which one side lacks an ROI."""
    common = [roi for roi in of_study if roi in recorded]
    for key, comparison in comparisons.items():
        chosen = comparison.rois
        lacks = {
            "the recording": [roi for roi in chosen or of_study if roi not in recorded],
            "the study": [roi for roi in chosen or recorded if roi not in of_study],
        }
        if missing := [f"{side} has no ROI {', '.join(rois)}" for side, rois in lacks.items() if rois]:
            yield (
                f"config: analyses.comparison.{key}: {' and '.join(missing)}; to compare the common ROIs, add "
                f"rois: [{', '.join(common)}]"
            )


def _classes_of_phantom(phantom: PhantomSettings) -> dict[str, str]:
    """Return {ROI: tissue class}; empty if the section has an error, which another check reports."""
    try:
        if phantom.source == "ct":
            from ...phantom.rois import read_roi_entries  # slow import (pandas)

            entries = read_roi_entries(phantom.ct.rois, phantom.ct.labels)
            return {name: entry.tissue_class for entry in entries for name in entry.names}
        if phantom.source == "object":
            from ...physics.scenes.objects import read_phantom_object  # slow import (numba)

            return {roi.name: roi.tissue_class for roi in read_phantom_object(phantom.object)[1]}
        from ...phantom.layout import read_layout  # slow import

        return {str(roi["name"]): str(roi["tissue_class"]) for roi in read_layout(phantom.layout)["rois"]}
    except (InputError, AttributeError, KeyError, TypeError):
        return {}
