"""The configuration as a file: YAML with comments that say what each value means."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

import yaml

from ...base.commands import snakemake, typed
from ...study.progress.status import duration_range
from .entries import doubtful
from .propose import Proposal

WIDTH = 110  # of a comment
RATES_WITHIN = 2.0  # factor within which estimates by measured rates were right (docs/how-to/cluster.md)


def text(proposal: Proposal, picture: str, name: str) -> str:
    """The whole file.

    Parameters
    ----------
    picture : str
        Name of the picture beside it.
    name : str
        Path of the file, as it is called in commands.
    """
    parts = [_head(proposal, picture, name)]
    if "trial" in proposal.config:
        parts.append(_trial(proposal.config["trial"]))
    parts += [_phantom(proposal), _grid(proposal), _scan(proposal), _rest(proposal)]
    return "\n".join(parts)


def _comment(words: str, indent: int = 0) -> str:
    lines = textwrap.wrap(words, WIDTH - indent, break_long_words=False, break_on_hyphens=False)
    return "".join(f"{' ' * indent}# {line}\n" for line in lines)


def _flow(value) -> str:
    """A value on one line, as YAML reads it."""
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True).strip()


def _scalar(value) -> str:
    return yaml.safe_dump(value, width=10_000, allow_unicode=True).removesuffix("\n...\n").strip()


def _numbers(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{value:g}" for value in values) + "]"


def _head(proposal: Proposal, picture: str, name: str) -> str:
    hours, grid = proposal.cost["core_hours"], proposal.image.grid
    nz, ny, nx = grid.shape
    dz, dy, dx = grid.spacing
    return (
        _comment(f"A {proposal.size} study of your CT, proposed by `virtual-phantom init`. Change what you like.")
        + _comment(f"Look first at {picture}: does every outline lie on its organ, and the dashed box hold the body?")
        + "#\n"
        + f"#   {typed('virtual-phantom', 'check', name)}\n"
        + f"#   {snakemake('--cores', '2', '--configfile', name)}\n"
        + "#\n"
        + _comment(
            f"It makes {proposal.cost['acquisitions']} scans in {proposal.cost['jobs']} jobs: "
            f"{minutes(hours)} on two idle cores, and {proposal.cost['bytes_kept'] / 1e9:.2g} GB of disk, by what such "
            "jobs took on the machine of docs/how-to/cluster.md."
        )
        + _comment("All keys with units and defaults: see config/README.md.")
        + _comment(f"The CT: {nx} x {ny} x {nz} voxels (x, y, z) of {dx:.4g} x {dy:.4g} x {dz:.4g} mm.")
    )


def _trial(trial: str | bool) -> str:
    words = "A quick run shows that everything is as you mean it, and its pages say that it is a trial."
    if isinstance(trial, str):
        words += " For an answer run this command:"
    return _comment(words) + f"trial: {_scalar(trial)}\n"


def minutes(hours: float) -> str:
    """The range of time in which two idle cores do so many core-hours, in words."""
    seconds = hours * 3600 / 2
    return duration_range(seconds / RATES_WITHIN, seconds * RATES_WITHIN)


def _phantom(proposal: Proposal) -> str:
    ct = proposal.config["phantom"]["ct"]
    lines = ["phantom:\n", "  source: ct # your CT is scanned, in place of the synthetic phantom\n", "  ct:\n"]
    lines += [f"    image: {_scalar(ct['image'])} # HU; paths begin where snakemake is called\n"]
    if "labels" in ct:
        lines += [f"    labels: {_scalar(ct['labels'])} # regions drawn on the CT's own voxels\n"]
    if "not_checked" in ct:
        lines += [f"    not_checked: {_flow(ct['not_checked'])} # checks of the CT that are left out\n"]
    lines += [
        f"    centre_mm: {_numbers(ct['centre_mm'])} # world point (x, y, z) at the isocentre: the box's middle\n",
        f"    keep_mm: {_flow(ct['keep_mm'])} # [x from, to], [y from, to]; outside becomes air: arms, table\n"
        if "keep_mm" in ct
        else "    # keep_mm is not needed: there is nothing beside the body that would be scanned.\n",
        _comment("name: in files and tables. tissue_class: ROIs of one class count as the same tissue.", 4),
        _comment("label: number or name in the file. margin_mm: shrunk by so much, to lie well inside the organ.", 4),
        _comment("parts: cut into so many, called name_1, name_2, ...", 4),
        "    rois:\n",
    ]
    for one, entry in zip(proposal.taken, ct["rois"], strict=True):
        region = one.region
        voxels = ", ".join(str(proposal.voxels[name]) for name in one.names)
        lines.append(
            f"      - {_flow(entry)} # {region.volume_ml:.3g} ml, {region.mean_hu:.0f} HU "
            f"({doubtful(region) or f'SD {region.sd_hu:.0f}'}); "
            f"{voxels} voxels\n"
        )
    if proposal.left:
        lines.append(_comment("Left out (take one by --rois, or add a line like those above):", 6))
        lines += [_comment(f"{region.name}: {reason}", 6) for region, reason in proposal.left]
    return "".join(lines)


def _grid(proposal: Proposal) -> str:
    grid = proposal.config["grid"]
    nz, ny, nx = (n * wide for n, wide in zip(grid["shape"], grid["spacing_mm"], strict=True))
    return (
        "grid: # voxels that images are reconstructed on\n"
        f"  shape: {_flow(grid['shape'])} # z, y, x: in this order {nz:.0f}, {ny:.0f} and {nx:.0f} mm\n"
        f"  spacing_mm: {_numbers(grid['spacing_mm'])} # z, y, x\n"
        f"  oversampling: {grid['oversampling']} # so many times finer is what is scanned: near the CT's pixels\n"
    )


def _scan(proposal: Proposal) -> str:
    scan = proposal.config["scan"]
    return (
        "scan: # a helix; the detector is as wide as the body needs and as high as the grid\n"
        f"  source_to_isocentre_mm: {scan['source_to_isocentre_mm']}\n"
        f"  source_to_detector_mm: {scan['source_to_detector_mm']}\n"
        f"  columns: {scan['columns']} # the body reaches {proposal.reach_mm:.0f} mm from the isocentre\n"
        f"  column_pitch_mm: {scan['column_pitch_mm']:g} # half of it at the isocentre: a voxel or less\n"
        f"  rows: {scan['rows']} # every ROI is seen from all directions\n"
        f"  row_pitch_mm: {scan['row_pitch_mm']:g}\n"
    )


NOTES = {
    "reconstruction": "terms: operator pairs that give the image of so many SIRT iterations.",
    "noise": (
        "A is one over the photons per detector pixel in air; repeats are scans with other noise. Values are those of "
        "{study}, for its phantom; the variance that they give here is in figures/noise_calibration. null takes away "
        "what config/config.yaml has."
    ),
    "protocols": (
        "projections: views of the whole scan. group: the stability of features is measured between protocols that "
        "have a group number, one each. null takes away what config/config.yaml has."
    ),
    "analyses": "What is made of the scans; null in place of a section leaves it out.",
}


def _rest(proposal: Proposal) -> str:
    config = proposal.config
    study = "config/config.yaml" if proposal.size == "normal" else "config/tiny.yaml"
    parts = []
    for section, note in NOTES.items():
        parts.append(_comment(note.format(study=study)) + f"{section}:\n{_nested(config[section], 1)}")
    parts.append("measured: {overlay: false} # measurements of the printed phantom mean nothing for this body\n")
    parts.append(f"results_dir: {_scalar(config['results_dir'])}\n")
    return "\n".join(parts)


def _nested(section: dict, depth: int) -> str:
    """A section of sections, a line for each value or for each innermost section."""
    lines = []
    for key, value in section.items():
        lead = "  " * depth + f"{_scalar(key)}:"
        deeper = isinstance(value, dict) and any(isinstance(one, dict | None.__class__) for one in value.values())
        lines.append(f"{lead}\n{_nested(value, depth + 1)}" if deeper else f"{lead} {_flow_of(value)}\n")
    return "".join(lines)


def _flow_of(value) -> str:
    return _scalar(value) if not isinstance(value, dict | list) else _flow(value)
