"""A first configuration for a CT and its regions: what is scanned, on which voxels, by which detector, at what cost."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...base.data import RESOURCES
from ...base.errors import InputError, meant
from ...base.geometry import Grid
from ...base.units import HU_AIR
from ...config.config import complete
from ...config.plan import Plan
from ...features.extraction import MINIMUM_VOXELS
from ...io.default_study import sizes
from ...io.schema import defaults_of
from ...io.volumes import Volume
from ...phantom.ct import kept_columns, read_hu, rois_of, trimmed
from ...phantom.masks import report_other_frame
from ...phantom.plausible import known_checks, note_without_air
from ...phantom.rois import read_entries
from ...study.checks.coverage import points_of, reach_mm, rows_for, worst_share
from ...study.costs.rates import read_rates
from ...study.costs.table import summary
from .entries import Chosen, choose, largest
from .regions import Region, read_regions
from .sampling import SPARE_ROWS, propose_grid, propose_scan, scanned_slices
from .trunk import is_needed, keep_box, widened

SIZES = ("quick", "normal")


@dataclass(frozen=True)
class Proposal:
    """A configuration, and what it was made of.

    Attributes
    ----------
    image : Volume
        The CT, HU.
    labels : str
        The file of the regions, or the folder of their masks.
    size : str
        Of SIZES.
    taken : tuple of Chosen
        Regions that become ROIs.
    left : tuple of (Region, str)
        The others, each with the reason.
    voxels : dict of str to int
        Of each ROI on the study's grid.
    reach_mm : float
        How far the body reaches from the isocentre.
    box_mm : list
        The body's box, [[x, x], [y, y]], NIfTI world mm: what is scanned.
    config : dict
        What is written.
    cost : dict
        As costs.table.summary gives it.
    """

    image: Volume
    labels: str
    size: str
    taken: tuple[Chosen, ...]
    left: tuple[tuple[Region, str], ...]
    voxels: dict[str, int]
    reach_mm: float
    box_mm: list[list[float]]
    config: dict
    cost: dict


def propose(
    image: str | Path,
    labels: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    rois: Sequence[str] = (),
    size: str = "normal",
    results_dir: str = "results",
    instead: str | None = None,
    not_checked: Sequence[str] = (),
    fill_gaps: bool = False,
) -> Proposal:
    """Propose a configuration for a CT and the regions drawn on it.

    Parameters
    ----------
    image : str or Path
        NIfTI file, or folder with one DICOM series; HU.
    labels : str or Path
        Label map, DICOM SEG, RTSTRUCT or mask, or a folder of masks.
    names : mapping of str to str, optional
        {label: name}; these regions go before larger ones.
    rois : sequence of str, optional
        Labels or names of the regions to take; by default the largest that are suitable.
    size : {"normal", "quick"}, optional
        quick: coarse voxels, few protocols and repeats; its pages say that it is a trial.
    instead : str, optional
        The command that begins a normal study of the same, which the pages of a quick one then name.
    not_checked : sequence of str, optional
        Checks of the CT to leave out, as phantom.ct.not_checked, where it is written.
    fill_gaps : bool, optional
        Interpolate slices of regions that are not drawn, between two that are.

    Raises
    ------
    InputError
        For what cannot be read, a region that is not there or that cannot be an ROI though it is asked for, and fewer
        than two tissue classes.
    """
    if size not in SIZES:
        raise InputError(f"--size: '{size}' is not known; {meant(size, SIZES)}")
    asked = sizes()[size]
    known_checks(not_checked)
    ct = read_hu(Path(image), not_checked)
    note_without_air(ct.array, image)
    ct = Volume(np.maximum(ct.array, np.float32(HU_AIR)), ct.grid)
    report_other_frame(labels, image)
    regions = wanted = read_regions(ct, labels, names or {}, rois, fill_gaps)
    box, outside = keep_box(ct, wanted, scanned_slices(ct.grid, wanted))
    if rois:
        box, outside = widened(box, outside), []
    left = [(one, "lies out of the trunk, as in an arm, and would widen what is scanned") for one in outside]
    wanted = [one for one in wanted if one not in outside]
    if not wanted:
        raise InputError(f"{labels}: no region lies in the trunk; name the ones that you mean by --rois")
    grid, _ = propose_grid(ct.grid, box, wanted, asked["voxels_across"])
    taken, unfit = _fitting(wanted, grid, fill_gaps)
    left += unfit
    if not rois:
        taken, further = largest(taken, asked["regions"], (names or {}).values())
        left += [(one.region, f"not among the {asked['regions']} largest that are suitable") for one in further]
    elif unfit:
        region, reason = unfit[0]
        raise InputError(f"--rois: {region.name} {reason}; take it out, or give --size normal or a finer CT")
    _require_classes(taken, labels)
    grid, oversampling = propose_grid(ct.grid, box, [one.region for one in taken], asked["voxels_across"])
    common = None if Path(labels).is_dir() else str(labels)
    keep = is_needed(ct, box, grid)
    body = trimmed(ct, box) if keep else ct
    taken, found, lost = _drawn(taken, common, ct.grid, grid, kept_columns(box, ct.grid))
    left += lost
    _require_classes(taken, labels)
    reach = reach_mm(body, grid)
    phantom = {
        "image": str(image),
        **({"labels": common} if common else {}),
        **({"not_checked": list(not_checked)} if not_checked else {}),
        "centre_mm": list(grid.centre_mm),
        **({"keep_mm": box} if keep else {}),
        "rois": [one.setting(common) for one in taken],
    }
    config = {
        "phantom": {"source": "ct", "ct": phantom},
        "grid": {"shape": list(grid.shape), "spacing_mm": list(grid.spacing), "oversampling": oversampling},
        "scan": propose_scan(grid, reach),
        "reconstruction": asked["reconstruction"],
        "noise": {"model": "astra", "levels": asked["levels"]},
        "protocols": asked["protocols"],
        "analyses": asked["analyses"],
        "measured": {"overlay": False},
        "results_dir": results_dir,
    }
    if size == "quick":
        config = {"trial": instead or True} | config
    config["scan"]["rows"] = _rows(config, grid, found)
    plan = Plan(complete(config))
    _, cost = summary(plan, "cpu", read_rates(RESOURCES / "rates.yaml"))
    return Proposal(
        image=ct,
        labels=str(labels),
        size=size,
        taken=tuple(taken),
        left=tuple(sorted(left, key=lambda one: [region.name for region in regions].index(one[0].name))),
        voxels={name: int(mask.sum()) for name, mask in found.items()},
        reach_mm=reach,
        box_mm=box,
        config=_with_nulls(config, size),
        cost=cost,
    )


def _fitting(regions: Sequence[Region], grid: Grid, fill_gaps: bool) -> tuple[list[Chosen], list[tuple[Region, str]]]:
    found = [(region, choose(region, grid, fill_gaps)) for region in regions]
    return (
        [one for _, one in found if isinstance(one, Chosen)],
        [(region, one) for region, one in found if isinstance(one, str)],
    )


def _require_classes(taken: Sequence[Chosen], labels: str | Path) -> None:
    """Features are told apart between tissue classes: a study of one class ends without its tables."""
    classes = sorted({one.region.tissue_class for one in taken})
    if len(classes) < 2:
        what = f"only the tissue class {classes[0]} is left" if classes else "no region is suitable"
        raise InputError(
            f"{labels}: {what}, and the study compares two classes at least; draw more regions, or tell them apart by "
            "--names LABEL=NAME"
        )


def _drawn(
    taken: Sequence[Chosen], common: str | None, ct: Grid, grid: Grid, kept: np.ndarray
) -> tuple[list[Chosen], dict[str, np.ndarray], list[tuple[Region, str]]]:
    """Regions as the study will have them: those that stay ROIs, their masks on the grid, and what is lost."""
    opened: dict = {}
    stay, masks, lost = [], {}, []
    for one in taken:
        (entry,) = read_entries([one.setting(common)], common)
        try:
            rois = rois_of(entry, ct, grid, kept, opened)
        except InputError as error:
            lost.append((one.region, str(error).removeprefix(f"ROI {one.region.name} ")))
            continue
        few = min(int(roi.mask.sum()) for roi in rois)
        if few < MINIMUM_VOXELS:
            lost.append((one.region, f"is too small: {few} voxels of this grid, texture needs {MINIMUM_VOXELS}"))
            continue
        stay.append(one)
        masks |= {roi.name: roi.mask for roi in rois}
    return stay, masks, lost


def _rows(config: dict, grid: Grid, masks: Mapping[str, np.ndarray]) -> int:
    """Detector rows that see every ROI from all directions, in every protocol, and a few to spare."""
    scan = {**defaults_of("scan"), **config["scan"]}
    points = np.concatenate(list(points_of(grid, masks).values()))
    rows = scan["rows"]
    for projections in sorted({one["projections"] for one in config["protocols"].values()}):
        if worst_share({**scan, "rows": rows}, projections, grid, points) == 1:
            continue
        least = rows_for({**scan, "rows": rows}, projections, grid, points)
        if least is None:
            raise InputError(
                f"CT: no number of detector rows sees all regions, which span {grid.extent_mm[0]:.0f} mm along z, in "
                f"{projections} projections; take fewer regions by --rois"
            )
        rows = least + SPARE_ROWS
    return rows + rows % 2


def _with_nulls(config: dict, size: str) -> dict:
    """The same, with what config/config.yaml has beyond it taken away."""
    config, default = copy.deepcopy(config), sizes()["normal"]
    if size != "normal":
        sections = ((config["protocols"], default["protocols"]), (config["noise"]["levels"], default["levels"]))
        for own, others in sections:
            own |= {name: None for name in others if name not in own}
    return config
