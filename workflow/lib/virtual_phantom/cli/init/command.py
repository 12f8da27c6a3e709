"""What `virtual-phantom init` does: read, propose, draw, write, and say what was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...base import commands
from ...base.commands import typed
from ...base.errors import InputError
from ...figures import axial, proposal, style
from ...io import files
from .entries import doubtful
from .options import joined
from .propose import Proposal, propose
from .regions import Region
from .written import minutes, text

FEWEST_SLICES, MOST_SLICES = 4, 6  # of the picture
SHARES = (0.1, 0.9, 0.5)  # of the way from the lowest slice with a region to the highest


def initialise(
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
    """Write a configuration for a CT and its regions, and a picture of them beside it.

    Parameters
    ----------
    image, labels : str or Path
        As `propose.propose` takes them.
    out : str or Path
        The configuration. The picture has its name and the suffix .png.
    names, rois, size, not_checked
        As `propose.propose` takes them.
    force : bool, optional
        Overwrite files that are there.
    fill_gaps : bool, optional
        As `propose.propose` takes it.

    Raises
    ------
    InputError
        As `propose.propose`, and for files that are there already.
    """
    for option, given in (("image", image), ("--labels", labels)):
        if not str(given):
            raise InputError(f"{option}: is empty; give a path (is a variable of the shell not set?)")
    out = Path(out)
    if out.suffix not in (".yaml", ".yml"):
        raise InputError(f"--out: {out} must end in .yaml")
    picture = out.with_suffix(".png")
    for path in (out, picture):
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give another --out")
        if path.exists() and not force:
            raise InputError(f"{path}: is there already; give another --out, or --force to overwrite it")
    proposed = propose(
        image,
        labels,
        names=names,
        rois=rois,
        size=size,
        results_dir=f"results-{out.stem}",
        instead=normal(image, labels, out, names or {}, rois, not_checked, fill_gaps),
        not_checked=not_checked,
        fill_gaps=fill_gaps,
    )
    style.save(drawn(proposed), [picture])
    with files.replacing(out, checksum=False) as temporary:  # it is the user's, who changes it
        temporary.write_text(text(proposed, picture.name, str(out)), encoding="utf-8")
    return proposed


def normal(
    image: str | Path,
    labels: str | Path,
    out: Path,
    names: Mapping[str, str],
    rois: Sequence[str],
    not_checked: Sequence[str] = (),
    fill_gaps: bool = False,
) -> str:
    """The command that proposes a normal study of the same CT and regions, beside the quick one."""
    words = ["virtual-phantom", "init", image, "--labels", labels]
    if names:
        words += ["--names", joined(names)]
    if rois:
        words += ["--rois", joined(rois)]
    if not_checked:
        words += ["--not-checked", ",".join(not_checked)]
    if fill_gaps:
        words += ["--fill-gaps"]
    return typed(*words, "--size", "normal", "--out", out.with_stem(f"{out.stem}-normal"))


def drawn(proposed: Proposal):
    """The picture: slices in which every ROI is seen well, with outlines and the box that is scanned."""
    taken = [one.region for one in proposed.taken]
    slices = _slices(taken)
    return proposal.draw(
        proposed.image,
        slices,
        [_in_slice(taken, z) for z in slices],
        [_in_slice([region for region, _ in proposed.left], z) for z in slices],
        {one.name: one.tissue_class for one in taken},
        proposed.box_mm,
    )


def _slices(regions: Sequence[Region]) -> list[int]:
    """Those in which every region is seen well, then others near the ends of them all, from the top down."""
    first, last = min(one.box[0].start for one in regions), max(one.box[0].stop for one in regions) - 1
    chosen = axial.choose_slices({one.name: _along(one) for one in regions})
    for share in SHARES:
        z = round(first + share * (last - first))
        if z not in chosen and len(chosen) < FEWEST_SLICES:
            chosen.append(z)
    return sorted(chosen[:MOST_SLICES], reverse=True)


def _along(region: Region) -> np.ndarray:
    """The mask with all slices of the CT, but in-plane its box alone."""
    z = region.box[0]
    return np.pad(region.mask, ((z.start, region.grid.shape[0] - z.stop), (0, 0), (0, 0)))


def _in_slice(regions: Sequence[Region], z: int) -> dict[str, np.ndarray]:
    return {region.name: mask for region in regions if (mask := region.slice(z)).any()}


def table(proposed: Proposal) -> str:
    """All regions, a line each: label, name, sizes, CT numbers, and what became of it."""
    taken = {one.region.name: ", ".join(one.names) for one in proposed.taken}
    left = {region.name: reason for region, reason in proposed.left}
    regions = sorted(
        [one.region for one in proposed.taken] + [region for region, _ in proposed.left],
        key=lambda region: (isinstance(region.label, str), region.label if region.label is not None else region.name),
    )
    lines = [f"{'label':>8}  {'name':<24}{'voxels':>9}{'ml':>8}{'HU':>7}{'SD':>6}  {'x, y, z (mm)':<16}  ROI"]
    for region in regions:
        z, y, x = region.extent_mm
        what = taken[region.name] if region.name in taken else f"- {left[region.name]}"
        label = "" if region.label is None else str(region.label)
        lines.append(
            f"{label:>8}  {region.name:<24}{region.voxels:>9}{region.volume_ml:>8.1f}{region.mean_hu:>7.0f}"
            f"{region.sd_hu:>6.0f}  {f'{x:.0f}, {y:.0f}, {z:.0f}':<16}  {what}"
        )
    return "\n".join(lines)


def told(proposed: Proposal, out: str | Path) -> str:
    """What is printed: the table, what was written, what it costs and what comes next."""
    grid, cost, trial = proposed.config["grid"], proposed.cost, proposed.config.get("trial")
    doubts = [f"{one.region.name}: {doubt}" for one in proposed.taken if (doubt := doubtful(one.region))]
    shape, spacing = (" x ".join(f"{one:g}" for one in grid[key]) for key in ("shape", "spacing_mm"))
    return "\n".join(
        [
            table(proposed),
            *doubts,
            "",
            f"{out}: {len(proposed.voxels)} ROIs on {shape} voxels of {spacing} mm (z, y, x)",
            f"{Path(out).with_suffix('.png')}: look at the outlines and the box",
            f"{cost['acquisitions']} scans in {cost['jobs']} jobs: {minutes(cost['core_hours'])} on two idle cores",
            "",
            f"Next: {typed('virtual-phantom', 'check', out)}",
            f"      {commands.snakemake('--cores', '2', '--configfile', out)}",
            *([needed] if (needed := commands.missing()) else []),
            *([f"Then, for an answer: {trial}"] if isinstance(trial, str) else []),
        ]
    )
