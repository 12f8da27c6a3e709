"""What to do with a recording that was imported: the configuration to write, and the command to run."""

from __future__ import annotations

import yaml

from ...base import commands
from ...base.errors import InputError
from ..features import FeaturesRecording
from ..projections import ProjectionsRecording
from ..recording import Recording
from .htc2022 import OBJECT

FITTED_VIEWS = 150  # of a scan of many views; config/htc2022.yaml fits and holds out 145 of 721
# Of the default study (config/config.yaml), whose phantom tables and images are compared with.
PROTOCOL, NOISE = "fbp_300", "dose10"
# How well the alignment is known, by importer. Line integrals do not say of which energy they are: without a spectrum
# their scale is free. A size is measured to a percent. The air beside the discs of the challenge is off by some 0.01.
ALIGNMENT = {"htc2022": "{scale: 1.0, size: 0.01, offset: 0.02}", "dicom-ct-pd": "{scale: 1.0, size: 0.01}"}
# What the mean of one row of a homogeneous object shows (config/htc2022.yaml).
OF_ONE_ROW = "[spectrum, scatter, veiling_glare, dark_signal, focal_spot, gain_pattern]"


def next_steps(recording: Recording) -> str:
    """The configuration to write for a recording, with capitals for what an importer cannot know, and the command.

    Parameters
    ----------
    recording : Recording
        As it was imported.

    Returns
    -------
    str
        Lines to print.

    Raises
    ------
    InputError
        If no importer made it.
    """
    importer = recording.provenance.origin.get("importer")
    if importer is None:
        raise InputError(f"{recording.document.path}: was not imported")
    name, folder = recording.name, _scalar(str(recording.document.folder))
    lines, blanks, target, condition = ["recordings:", f"  {name}: {folder}"], "", (), ""
    file = f"{name}.yaml"
    if isinstance(recording, FeaturesRecording):
        lines += ["analyses:", "  comparison:", f"    {name}: {_comparison(recording)}"]
    elif not isinstance(recording, ProjectionsRecording):
        target, condition = ("alignment",), ", if the study's phantom was scanned"
    else:
        lines += ["diagnosis:", "  recordings:", *_diagnosed(recording, importer)]
        target = ("diagnosis",)
        if importer != "study":
            blanks = ", with what was scanned in the place of capitals"
    return "\n".join(
        [
            f"Next: save this as {file}{blanks}:",
            "",
            *lines,
            "",
            f"Then run{condition}: {commands.snakemake(*target, '--cores', '2', '--configfile', file)}",
            *([needed] if (needed := commands.missing()) else []),
        ]
    )


def _comparison(recording: FeaturesRecording) -> str:
    (where,) = recording.repeats[list(recording.conditions)].head(1).to_dict("records")
    chosen = f"where: {_flow(where)}, " if where else ""
    return f"{{recording: {recording.name}, {chosen}protocol: {PROTOCOL}, noise: {NOISE}}}"


def _diagnosed(recording: ProjectionsRecording, importer: str) -> list[str]:
    """The section of one recording: of a study's acquisitions the phantom is the study's, and all is known."""
    if importer == "study":
        return [f"    {recording.name}: {{}} # the study's phantom, so run it with the study's own configuration"]
    mask = recording.document.folder / OBJECT
    lines = [f"    {recording.name}:"]
    if mask.is_file():
        lines += [f"      object: {{mask: {_scalar(str(mask))}, material: MATERIAL}} # water, acrylic, aluminium, ..."]
    else:
        lines += [
            "      disc: {diameter_mm: DIAMETER, material: MATERIAL} # water, acrylic; others: docs/how-to/diagnosis.md"
        ]
    lines += [f"      alignment: {ALIGNMENT[importer]} # how well it is known; scale 1.0: not at all"]
    if (step := round(recording.geometry.views / FITTED_VIEWS)) > 1:
        lines += [f"      view_step: {step} # one view of {step}: enough of what looks alike from everywhere"]
    if recording.geometry.rows == 1:
        lines += [f"      effects: {OF_ONE_ROW}"]
    return lines


def _scalar(value: str) -> str:
    return yaml.safe_dump(value, width=10_000, allow_unicode=True).removesuffix("\n...\n").strip()


def _flow(value: dict) -> str:
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True).strip()
