"""Next steps after an import: the configuration to write, and the command to run."""

from __future__ import annotations

from ...base import commands
from ...base.errors import InputError
from ...io.yaml_files import one_line
from ..features import FeaturesRecording
from ..projections import ProjectionsRecording
from ..recording import Recording
from .htc2022 import OBJECT

FITTED_VIEWS = 150  # of a scan with many views; config/htc2022.yaml fits and holds out 145 of 721
# Labels of the default study (config/config.yaml), with which tables are compared.
PROTOCOL, NOISE = "group_2", "mgy10"
# Study for images: the alignment and the diagnosis need whole images, which the default study makes for a figure only.
STUDY_OF_IMAGES = "config/paper_groups.yaml"
UNKNOWN = "      object: {unknown: true} # checks the data alone; state the object if it is known"
ARRAYS = ("projections", "xtekct")  # importers of data whose object is often not known
# Tolerances of the alignment, by importer. Line integrals do not state their energy: without a spectrum, the density
# scale is free. A size is measured to one percent. Air next to the discs of the challenge is off by about 0.01.
ALIGNMENT = {"htc2022": "{scale: 1.0, size: 0.01, offset: 0.02}", "dicom-ct-pd": "{scale: 1.0, size: 0.01}"}
# Effects that the mean of one row of a uniform object can show (config/htc2022.yaml).
ONE_ROW_EFFECTS = "[spectrum, scatter, veiling_glare, dark_signal, focal_spot, gain_pattern]"


def next_steps(recording: Recording) -> str:
    """Return lines to print: the configuration to write and the command; unknown values are in capitals.

    Raises
    ------
    InputError
        If no importer created the recording.
    """
    importer = recording.provenance.origin.get("importer")
    if importer is None:
        raise InputError(f"{recording.document.path}: has no origin.importer; only imported recordings have next steps")
    name, folder = recording.name, one_line(str(recording.document.folder))
    lines, blanks, target, condition = ["recordings:", f"  {name}: {folder}"], "", (), ""
    file = f"{name}.yaml"
    if isinstance(recording, FeaturesRecording):
        lines += ["analyses:", "  comparison:", f"    {name}: {_comparison(recording)}"]
    elif not isinstance(recording, ProjectionsRecording) and recording.grid.shape[0] == 1:  # too few to align
        lines += ["diagnosis:", "  recordings:", f"    {name}:", UNKNOWN]
        target = ("diagnosis",)
    elif not isinstance(recording, ProjectionsRecording):
        lines.insert(0, f"base: {STUDY_OF_IMAGES}")
        target, condition = ("alignment",), ", if the scanned object is the study's phantom"
    else:
        lines += ["diagnosis:", "  recordings:", *_diagnosed(recording, importer)]
        target = ("diagnosis",)
        if importer not in ("study", *ARRAYS):
            blanks = ", and replace the words in capitals by the properties of the scanned object"
    return "\n".join(
        [
            f"Next: save this as {file}{blanks}:",
            "",
            *lines,
            "",
            f"Then run{condition}: {commands.snakemake(*target, '--cores', '2', '--configfile', file)}",
            *([needed] if (needed := commands.missing_for_snakemake()) else []),
        ]
    )


def _comparison(recording: FeaturesRecording) -> str:
    (where,) = recording.repeats[list(recording.conditions)].head(1).to_dict("records")
    chosen = f"where: {one_line(where)}, " if where else ""
    return f"{{recording: {recording.name}, {chosen}protocol: {PROTOCOL}, noise: {NOISE}}}"


def _diagnosed(recording: ProjectionsRecording, importer: str) -> list[str]:
    """Return the section of one recording. For a study's acquisitions, the object is known."""
    if importer == "study":
        return [f"    {recording.name}: {{}} # the study's phantom: run it with the study's own configuration"]
    mask = recording.document.folder / OBJECT
    lines = [f"    {recording.name}:"]
    if importer in ARRAYS:
        return [*lines, UNKNOWN]
    if mask.is_file():
        lines += [f"      object: {{mask: {one_line(str(mask))}, material: MATERIAL}} # water, acrylic, aluminium, ..."]
    else:
        lines += [
            "      disc: {diameter_mm: DIAMETER, material: MATERIAL} # water, acrylic; others: docs/how-to/diagnosis.md"
        ]
    lines += [f"      alignment: {ALIGNMENT[importer]} # tolerances; scale 1.0: unknown"]
    if (step := round(recording.geometry.views / FITTED_VIEWS)) > 1:
        lines += [f"      view_step: {step} # 1 in {step} views is enough for objects without fine detail"]
    if recording.geometry.rows == 1:
        lines += [f"      effects: {ONE_ROW_EFFECTS}"]
    return lines
