"""Tissue classes of a study's ROIs, from the configuration alone."""

from __future__ import annotations

from ..base.data import RESOURCES
from ..base.errors import InputError
from ..base.settings import PhantomSettings
from ..io.yaml_files import read_yaml
from ..physics.scenes.object_files import object_path


def tissue_classes(phantom: PhantomSettings) -> dict[str, str]:
    """Return {ROI: tissue class}; empty if a file of the phantom has an error, which other checks report."""
    if phantom.source == "ct":
        return {name: roi.tissue_class for roi in phantom.ct.rois for name in roi.names}
    if phantom.source == "object" and phantom.object.rois:
        return {roi.name: roi.tissue_class for roi in phantom.object.rois}
    try:
        path = object_path(phantom.object.kind) if phantom.source == "object" else phantom.layout
        rois = read_yaml(path or RESOURCES / "phantom.yaml", "give a file with rois")["rois"]
        return {str(roi["name"]): str(roi["tissue_class"]) for roi in rois}
    except (InputError, AttributeError, KeyError, TypeError):
        return {}
