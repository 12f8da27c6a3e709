"""Write the configuration that `virtual-phantom init` proposes as YAML, with a comment for each value."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from ...base.commands import command_line, snakemake
from ...io.yaml_files import one_line
from ...study.progress.status import duration_range
from ...study.progress.time_left import SLOWER
from .propose import Proposal
from .rois import outline_warning

WIDTH = 110  # characters of a comment line
STARTUP_SECONDS = 6.0  # of Snakemake, before the first job
RUN_WITHIN = 1.5  # factor within which the estimates were right (docs/validation/trust-measures.md)


def configuration_text(proposal: Proposal, picture: str, name: str) -> str:
    """Return the text of the configuration that is written to path `name`; it names the file `picture`."""
    parts = [_head(proposal, picture, name)]
    if "trial" in proposal.config:
        parts.append(_trial(proposal.config["trial"]))
    parts.append(f"base: {one_line(proposal.config['base'])} # the study whose keys this file changes\n")
    parts += [_phantom(proposal), _grid(proposal), _scan(proposal), _rest(proposal)]
    return "\n".join(parts)


def _comment(words: str, indent: int = 0) -> str:
    lines = textwrap.wrap(words, WIDTH - indent, break_long_words=False, break_on_hyphens=False)
    return "".join(f"{' ' * indent}# {line}\n" for line in lines)


def _numbers(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"


def _head(proposal: Proposal, picture: str, name: str) -> str:
    hours, grid = proposal.cost["core_hours"], proposal.image.grid
    nz, ny, nx = grid.shape
    dz, dy, dx = grid.spacing
    return (
        _comment(f"A {proposal.size} study of your CT, proposed by `virtual-phantom init`. Edit it as you need.")
        + _comment(f"First check {picture}: every outline lies on its organ, and the dashed box contains the body.")
        + "#\n"
        + f"#   {command_line('virtual-phantom', 'check', name)}\n"
        + f"#   {snakemake('--cores', '2', '--configfile', name)}\n"
        + "#\n"
        + _comment(
            f"The study makes {proposal.cost['acquisitions']} scans in {proposal.cost['jobs']} jobs: "
            f"{duration_text(hours)} on two idle cores and {proposal.cost['bytes_kept'] / 1e9:.2g} GB of disk, "
            "estimated from measured rates (docs/how-to/cluster.md)."
        )
        + _comment("config/README.md lists all keys with units and defaults.")
        + _comment(f"The CT: {nx} x {ny} x {nz} voxels (x, y, z) of {dx:.4g} x {dy:.4g} x {dz:.4g} mm.")
    )


def _trial(trial: str | bool) -> str:
    words = "A quick study checks your setup. Its pages are marked as a trial."
    if isinstance(trial, str):
        words += " For real results, run this command:"
    return _comment(words) + f"trial: {one_line(trial)}\n"


def duration_text(hours: float) -> str:
    """Return the expected time on two idle cores in words, from core hours."""
    seconds = STARTUP_SECONDS + SLOWER * hours * 3600 / 2
    return duration_range(seconds / RUN_WITHIN, seconds * RUN_WITHIN)


def _phantom(proposal: Proposal) -> str:
    ct = proposal.config["phantom"]["ct"]
    lines = ["phantom:\n", "  source: ct # scan your CT instead of the synthetic phantom\n", "  ct:\n"]
    lines += [f"    image: {one_line(ct['image'])} # HU; paths are relative to the working folder\n"]
    if "labels" in ct:
        lines += [f"    labels: {one_line(ct['labels'])} # regions on the voxels of the CT\n"]
    if "not_checked" in ct:
        lines += [f"    not_checked: {one_line(ct['not_checked'])} # skipped checks of the CT\n"]
    lines += [
        f"    centre_mm: {_numbers(ct['centre_mm'])} # world point (x, y, z) at the isocenter: the center of the box\n",
        f"    keep_mm: {one_line(ct['keep_mm'])} # [x min, max], [y min, max]; arms and table outside become air\n"
        if "keep_mm" in ct
        else "    # keep_mm is not needed: nothing lies next to the body.\n",
        _comment("name: name in files and tables. tissue_class: ROIs of one class count as the same tissue.", 4),
        _comment("label: number or name in the file. margin_mm: erosion of the mask, away from the organ's edge.", 4),
        _comment("parts: number of ROIs that the region is divided into, called name_1, name_2, ...", 4),
        "    rois:\n",
    ]
    for chosen, entry in zip(proposal.selected, ct["rois"], strict=True):
        region = chosen.region
        voxels = ", ".join(str(proposal.voxels[name]) for name in chosen.names)
        lines.append(
            f"      - {one_line(entry)} # {region.volume_ml:.3g} ml, {region.mean_hu:.0f} HU "
            f"({outline_warning(region) or f'SD {region.sd_hu:.0f}'}); "
            f"{voxels} voxels\n"
        )
    if proposal.rejected:
        lines.append(_comment("Not used (to use a region, name it by --rois or add a line as above):", 6))
        lines += [_comment(f"{region.name}: {reason}", 6) for region, reason in proposal.rejected]
    return "".join(lines)


def _grid(proposal: Proposal) -> str:
    grid = proposal.config["grid"]
    nz, ny, nx = (n * wide for n, wide in zip(grid["shape"], grid["spacing_mm"], strict=True))
    lines = [
        "grid: # voxels of the reconstructed images",
        f"  shape: {one_line(grid['shape'])} # z, y, x: {nz:.0f}, {ny:.0f} and {nx:.0f} mm",
        f"  spacing_mm: {_numbers(grid['spacing_mm'])} # z, y, x",
        f"  oversampling: {grid['oversampling']} # the scanned phantom is finer by this factor, near the CT's pixels",
    ]
    return "".join(f"{line}\n" for line in lines)


def _scan(proposal: Proposal) -> str:
    scan = proposal.config["scan"]
    lines = [
        "scan: # a helical scan; the detector covers the width of the body and the height of the grid",
        f"  source_to_isocentre_mm: {scan['source_to_isocentre_mm']}",
        f"  source_to_detector_mm: {scan['source_to_detector_mm']}",
        f"  columns: {scan['columns']} # the body reaches {proposal.reach_mm:.0f} mm from the isocenter",
        f"  column_pitch_mm: {scan['column_pitch_mm']:g} # at the isocenter about half of it, at most one voxel",
        f"  rows: {scan['rows']} # enough to see every ROI from all directions",
        f"  row_pitch_mm: {scan['row_pitch_mm']:g}",
    ]
    return "".join(f"{line}\n" for line in lines)


NOTES = {
    "reconstruction": "The image is that of SIRT after `iterations`, computed with at most `terms` projections.",
    "noise": (
        "A is the inverse of the photons per detector pixel in air; repeats are scans with different noise. The values "
        "are taken from {study}; figures/noise_calibration shows the variance that they give for your CT. null removes "
        "an entry of {base}."
    ),
    "protocols": (
        "projections: views of the whole scan. group: a different number for each; feature stability is measured "
        "between protocols that have one. null removes an entry of {base}."
    ),
    "analyses": "Analyses of the scans; null instead of a section removes it.",
}


def _rest(proposal: Proposal) -> str:
    config, base = proposal.config, proposal.config["base"]
    study = base if proposal.size == "normal" else "config/tiny.yaml"
    parts = []
    for section, note in NOTES.items():
        parts.append(_comment(note.format(study=study, base=base)) + f"{section}:\n{_nested(config[section], 1)}")
    parts.append("measured: {overlay: false} # measurements of the printed phantom do not apply to this body\n")
    parts.append(f"results_dir: {one_line(config['results_dir'])}\n")
    return "\n".join(parts)


def _nested(section: dict, depth: int) -> str:
    """Return a nested section as YAML, with one line for each value or innermost section."""
    lines = []
    for key, value in section.items():
        lead = "  " * depth + f"{one_line(key)}:"
        deeper = isinstance(value, dict) and any(isinstance(entry, dict | None.__class__) for entry in value.values())
        lines.append(f"{lead}\n{_nested(value, depth + 1)}" if deeper else f"{lead} {one_line(value)}\n")
    return "".join(lines)
