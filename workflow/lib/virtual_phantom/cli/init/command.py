"""Steps of `virtual-phantom init`: read, propose, draw, write, and print a summary."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from ...base import commands
from ...base.commands import command_line
from ...base.errors import InputError
from ...figures import axial, proposal, style
from ...io import files
from .configuration_file import configuration_text, duration_text
from .options import format_list
from .propose import Proposal, propose
from .regions import Region
from .rois import outline_warning

FEWEST_SLICES, MOST_SLICES = 4, 6  # in the picture
SLICE_POSITIONS = (0.1, 0.9, 0.5)  # fractions of the range of slices with a region


def initialize(
    image: str | Path,
    labels: str | Path,
    out: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    rois: Sequence[str] = (),
    size: str = "normal",
    force: bool = False,
    not_checked: Sequence[str] = (),
    fill_gaps: bool = False,
) -> Proposal:
    """Write a configuration for a CT and its regions, and a picture of the regions.

    Parameters
    ----------
    image, labels, names, rois, size, not_checked, fill_gaps
        See `propose.propose`.
    out : str or Path
        Configuration file. The picture has the same name with the suffix .png.
    force : bool, optional
        Overwrite existing files.

    Raises
    ------
    InputError
        As `propose.propose`, and for existing files.
    """
    for option, path in (("image", image), ("--labels", labels)):
        if not str(path):
            raise InputError(f"{option}: is empty; give a path (is a shell variable not set?)")
    out = Path(out)
    if out.suffix not in (".yaml", ".yml"):
        raise InputError(f"--out: {out} must end in .yaml")
    picture = out.with_suffix(".png")
    for path in (out, picture):
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give another --out")
        if path.exists() and not force:
            raise InputError(f"{path}: already exists; give another --out, or --force to overwrite it")
    proposed = propose(
        image,
        labels,
        names=names,
        rois=rois,
        size=size,
        results_dir=f"results-{out.stem}",
        instead=normal_command(image, labels, out, names or {}, rois, not_checked, fill_gaps),
        not_checked=not_checked,
        fill_gaps=fill_gaps,
    )
    style.save(preview(proposed), [picture])
    with files.replacing(out, checksum=False) as temporary:  # no checksum, because users edit the file
        temporary.write_text(configuration_text(proposed, picture.name, str(out)), encoding="utf-8")
    return proposed


def normal_command(
    image: str | Path,
    labels: str | Path,
    out: Path,
    names: Mapping[str, str],
    rois: Sequence[str],
    not_checked: Sequence[str] = (),
    fill_gaps: bool = False,
) -> str:
    """Return the command that writes the configuration of a normal study for the same CT and regions."""
    words = ["virtual-phantom", "init", image, "--labels", labels]
    if names:
        words += ["--names", format_list(names)]
    if rois:
        words += ["--rois", format_list(rois)]
    if not_checked:
        words += ["--not-checked", ",".join(not_checked)]
    if fill_gaps:
        words += ["--fill-gaps"]
    return command_line(*words, "--size", "normal", "--out", out.with_stem(f"{out.stem}-normal"))


def preview(proposed: Proposal):
    """Return the picture: slices that show every ROI well, with outlines and the scanned box."""
    selected = [roi.region for roi in proposed.selected]
    slices = _slices(selected)
    return proposal.draw(
        proposed.image,
        slices,
        [_in_slice(selected, z) for z in slices],
        [_in_slice([region for region, _ in proposed.rejected], z) for z in slices],
        {region.name: region.tissue_class for region in selected},
        proposed.box_mm,
    )


def _slices(regions: Sequence[Region]) -> list[int]:
    """Return slices that show every region well and slices near both ends, from the top down."""
    first, last = min(region.box[0].start for region in regions), max(region.box[0].stop for region in regions) - 1
    chosen = axial.choose_slices({region.name: _full_height(region) for region in regions})
    for position in SLICE_POSITIONS:
        z = round(first + position * (last - first))
        if z not in chosen and len(chosen) < FEWEST_SLICES:
            chosen.append(z)
    return sorted(chosen[:MOST_SLICES], reverse=True)


def _full_height(region: Region) -> np.ndarray:
    """Return the mask on all slices of the CT, in-plane cropped to its box."""
    z = region.box[0]
    return np.pad(region.mask, ((z.start, region.grid.shape[0] - z.stop), (0, 0), (0, 0)))


def _in_slice(regions: Sequence[Region], z: int) -> dict[str, np.ndarray]:
    return {region.name: mask for region in regions if (mask := region.slice(z)).any()}


def table(proposed: Proposal) -> str:
    """Return one line per region: label, name, sizes, CT numbers, and its ROIs or why it has none, which are last."""
    selected = {roi.region.name: ", ".join(roi.names) for roi in proposed.selected}
    rejected = {region.name: reason for region, reason in proposed.rejected}
    regions = sorted(
        [roi.region for roi in proposed.selected] + [region for region, _ in proposed.rejected],
        key=lambda region: (
            region.name not in selected,
            isinstance(region.label, str),
            region.label if region.label is not None else region.name,
        ),
    )
    lines = [f"{'label':>8}  {'name':<24}{'voxels':>9}{'ml':>8}{'HU':>7}{'SD':>6}  {'x, y, z (mm)':<16}  ROI"]
    for region in regions:
        z, y, x = region.extent_mm
        rois = selected[region.name] if region.name in selected else f"- {rejected[region.name]}"
        label = "" if region.label is None else str(region.label)
        lines.append(
            f"{label:>8}  {region.name:<24}{region.voxels:>9}{region.volume_ml:>8.1f}{region.mean_hu:>7.0f}"
            f"{region.sd_hu:>6.0f}  {f'{x:.0f}, {y:.0f}, {z:.0f}':<16}  {rois}"
        )
    return "\n".join(lines)


def summary_text(proposed: Proposal, out: str | Path, names: Collection[str] = ()) -> str:
    """Return the printed summary, with the names from --names: regions, files, cost and the next commands."""
    grid, cost, trial = proposed.config["grid"], proposed.cost, proposed.config.get("trial")
    warnings = [f"{roi.region.name}: {text}" for roi in proposed.selected if (text := outline_warning(roi.region))]
    if warnings:
        warnings.append("To exclude such voxels, increase margin_mm, or use other regions by --rois.")
    chosen = [roi.region.name for roi in proposed.selected]
    named = [name for name in chosen if name in names]
    if named and named != chosen:
        only = format_list(named)
        warnings.append(f"Regions without a name in --names are used too. To use only the named ones: --rois {only}")
    shape, spacing = (" x ".join(f"{number:g}" for number in grid[key]) for key in ("shape", "spacing_mm"))
    return "\n".join(
        [
            table(proposed),
            *warnings,
            "",
            f"{out}: {len(proposed.voxels)} ROIs on {shape} voxels of {spacing} mm (z, y, x)",
            f"{Path(out).with_suffix('.png')}: check the outlines and the box",
            f"{cost['acquisitions']} scans in {cost['jobs']} jobs: "
            f"{duration_text(cost['core_hours'])} on two idle cores",
            "",
            f"Next: {command_line('virtual-phantom', 'check', out)}",
            f"      {commands.snakemake('--cores', '2', '--configfile', out)}",
            *([needed] if (needed := commands.missing_for_snakemake()) else []),
            *([f"Then, for real results: {trial}"] if isinstance(trial, str) else []),
        ]
    )
