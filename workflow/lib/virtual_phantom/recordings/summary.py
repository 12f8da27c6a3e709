"""Summary of a recording: content, known facts about the scan, and missing information."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ..base.names import counted
from ..features.names import LARGEST, WHOLE
from ..features.settings import STUDY, Extraction, describe_differences, installed_version, section_differences
from ..statistics.comparability import SAME_VOXELS, grows_with_roi
from .features import FeaturesRecording
from .images import ImagesRecording
from .projections import ProjectionsRecording
from .recording import Recording
from .scan import ELEMENT, UNKNOWN, missing_for_geometry

COLUMNS = ("recording", "kind", "repeats", "held_out", "content", "known", "missing", "notes")
ENERGY, TOTAL_ENERGY = "original_firstorder_Energy", "original_firstorder_TotalEnergy"  # ratio: voxel volume in mm3
# Facts that a comparison with a simulation needs, in addition to the geometry.
WANTED = {
    "images": ("tube_kvp", "dose_mgy", "kernel", "slice_thickness_mm"),
    "projections": ("tube_kvp", "anode", "filtration", "sensor"),
    "features": (),
}


def summarize_recording(
    recording: Recording,
    study: Extraction = STUDY,
    voxel_sizes: Sequence[Sequence[float]] = (),
    section: str = WHOLE,
) -> dict:
    """Return the content of a recording's JSON summary.

    Parameters
    ----------
    study : Extraction, optional
        Extraction settings of the study, for comparison.
    voxel_sizes : sequence of sequence of float, optional
        Voxel sizes of the study, mm.
    section : {WHOLE, LARGEST}, optional
        Section of the regions from which the study extracts features.

    Returns
    -------
    dict
        Keys: name; kind; phantom; origin; sha256; repeats and held_out (numbers of acquisitions); content (grid, views
        or table). Also text (the content in one line); known (scan, and nominal with DICOM facts); missing (facts that
        a comparison needs); notes.
    """
    labelled = {**recording.provenance.dicom, **recording.nominal}
    repeats, held_out, content, text = DESCRIPTIONS[type(recording)](recording)
    is_table = isinstance(recording, FeaturesRecording)
    # Tables are compared by the names of ROIs, and a diagnosis of features chooses its held-out ROIs itself. For
    # projections, the configuration states the object.
    missing = ["phantom"] if recording.kind == "images" and not recording.phantom else []
    if (content["images_per_condition"][0] if is_table else repeats) < 2:
        missing.append("a second repeat (with one repeat, the noise is not known)")
    if not held_out and not is_table:
        missing.append("held_out")
    if not is_table and (keys := missing_for_geometry(recording.scan)):
        missing.append(f"scan ({', '.join(keys)})")
    missing += [f"nominal.{key}" for key in WANTED[recording.kind] if key not in labelled]
    return {
        "name": recording.name,
        "kind": recording.kind,
        "phantom": recording.phantom,
        "repeats": repeats,
        "held_out": held_out,
        "content": content,
        "text": text,
        "known": {"scan": recording.scan, "nominal": labelled},
        "missing": missing,
        "notes": [
            *recording.notes,
            *_extraction_notes(recording, study, section),
            *_size_notes(recording, voxel_sizes),
        ],
        "origin": recording.provenance.origin,
        "sha256": recording.provenance.sha256,
    }


def summary_table(summaries: dict[str, dict]) -> pd.DataFrame:
    """Return one row per recording (COLUMNS), with lists joined by semicolons, from {name: summary}."""
    rows = [
        {
            "recording": name,
            **{key: summary[key] for key in ("kind", "repeats", "held_out")},
            "content": summary["text"],
            "known": "; ".join(
                f"{key} {_short(value)}"
                for section in ("nominal", "scan")
                for key, value in summary["known"][section].items()
            ),
            "missing": "; ".join(summary["missing"]),
            "notes": "; ".join(summary["notes"]),
        }
        for name, summary in summaries.items()
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def readable(rows: pd.DataFrame) -> str:
    """Return the table as text, a block of lines per recording."""
    blocks = []
    for row in rows.to_dict("records"):
        held_out = f", {row['held_out']} held out" if row["held_out"] else ""
        lines = [f"{row['recording']}: {row['kind']}, {counted(row['repeats'], 'repeat')}{held_out}"]
        lines += [f"  {key:<8} {row[key]}" for key in ("content", "known", "missing", "notes") if row[key]]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def _short(value) -> str:
    if isinstance(value, list):
        return " x ".join(map(_short, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _images(recording: ImagesRecording) -> tuple[int, int, dict, str]:
    grid = recording.grid
    content = {"shape": list(grid.shape), "spacing_mm": list(grid.spacing), "centre_mm": list(grid.centre_mm)}
    content["rois"] = {
        roi.name: {"tissue_class": roi.tissue_class, "n_voxels": int(roi.mask.sum())} for roi in recording.rois()
    }
    rois = f"; {counted(len(content['rois']), 'ROI')}" if content["rois"] else ""
    return len(recording.repeats), len(recording.held_out), content, f"{grid}{rois}"


def _projections(recording: ProjectionsRecording) -> tuple[int, int, dict, str]:
    geometry = recording.geometry
    turns = geometry.views / geometry.views_per_rotation
    content = {
        "values": "line integrals" if recording.log else "counts",
        "shape": [geometry.views, geometry.rows, geometry.columns],
        "turns": turns,
        "field_of_view_mm": 2 * geometry.field_of_view_radius_mm,
        "feed_per_rotation_mm": geometry.feed_per_rotation_mm,
        "view_interval_ms": geometry.view_interval_ms,
        "largest_angle_step_deg": float(np.rad2deg(np.abs(np.diff(geometry.angles_rad)).max(initial=0))),
    }
    size = " x ".join(map(str, content["shape"]))
    unit = "elements" if recording.scan.get("length_unit") == ELEMENT else "mm"
    seen = f"{turns:.4g} turns, sees {content['field_of_view_mm']:.3g} {unit}"
    if recording.scan.get("angles_deg") == UNKNOWN:
        seen = "unknown angles"
    text = f"{content['values']}, {size} (views, rows, columns), {seen}"
    return len(recording.repeats), len(recording.held_out), content, text


def _extraction_notes(recording: Recording, study: Extraction, section: str) -> list[str]:
    """Return a line per setting that differs from the study, and per other version of pyradiomics."""
    if not isinstance(recording, FeaturesRecording):
        return []
    sections = section_differences(section, recording.dimensions, recording.extractions)
    differences = describe_differences(study, recording.extractions, recording.features, sections)
    lines = [f"setting: {line}" for line in differences]
    if sections:
        other = WHOLE if section == LARGEST else LARGEST
        lines.append(f"set features.section: {other} in the study, or correct features.dimensions in recording.yaml")
    versions = dict.fromkeys(extraction.version for extraction in recording.extractions if extraction.version)
    return lines + [
        f"extracted by pyradiomics {version}, but the study's features by {installed_version()}"
        for version in versions
        if version != installed_version()
    ]


def _size_notes(recording: Recording, voxel_sizes: Sequence[Sequence[float]]) -> list[str]:
    """Return a line if features depend on the voxel size, which differs from all of the study's."""
    if not isinstance(recording, FeaturesRecording) or not len(voxel_sizes) or recording.dimensions != 3:
        return []
    stated = recording.nominal.get("voxel_mm")
    if {ENERGY, TOTAL_ENERGY} <= set(recording.features):
        volume = float((recording.repeats[TOTAL_ENERGY] / recording.repeats[ENERGY]).median())
    elif stated:
        volume = float(np.prod(stated))
    else:
        return []
    study = sorted({float(np.prod(size)) for size in voxel_sizes})
    dependent = [feature for feature in recording.features if grows_with_roi(feature)]
    if not dependent or not np.isfinite(volume) or any(abs(volume / size - 1) < SAME_VOXELS for size in study):
        return []
    sizes = ", ".join(f"{size:.3g}" for size in study)
    return [
        f"voxels have {volume:.3g} mm³, the study's voxels {sizes} mm³: {len(dependent)} of the features "
        "depend on the number of voxels and cannot be compared"
    ]


def _features(recording: FeaturesRecording) -> tuple[int, int, dict, str]:
    counts = recording.images_per_condition()
    rois = list(dict.fromkeys(recording.repeats["roi"]))
    content = {
        "rows": len(recording.repeats),
        "rois": rois,
        "features": len(recording.features),
        "conditions": {name: recording.repeats[name].unique().tolist() for name in recording.conditions},
        "images_per_condition": [int(counts.min()), int(counts.max())],
        "stored_offset_hu": recording.stored_offset_hu,
        "dimensions": recording.dimensions,
        "extraction": [
            # As text, because settings may have values that JSON cannot represent.
            {"settings": str(entry.settings), "image_types": str(entry.image_types), "pyradiomics": entry.version}
            for entry in recording.extractions
        ],
    }
    low, high = content["images_per_condition"]
    images_per_condition = f"{low} to {counted(high, 'image')}" if low < high else counted(low, "image")
    conditions = f"{counted(counts.size, 'condition')} of " if recording.conditions else ""
    text = (
        f"{counted(len(recording.features), 'feature')} ({recording.dimensions}D) of {counted(len(rois), 'ROI')}, "
        f"{conditions}{images_per_condition}"
    )
    images = recording.repeats["image"].nunique()
    return images, recording.held_out["image"].nunique(), content, text


DESCRIPTIONS = {ImagesRecording: _images, ProjectionsRecording: _projections, FeaturesRecording: _features}
