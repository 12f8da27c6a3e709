"""Propose a first configuration for a CT and its regions: scanned box, ROIs, grid, detector and cost."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...base.data import RESOURCES
from ...base.errors import InputError, did_you_mean
from ...base.geometry import Grid
from ...base.settings import ScanSettings, from_mapping
from ...base.units import HU_AIR
from ...config.config import read_study
from ...config.plan import Plan
from ...config.read_config import PAPER_GROUPS
from ...features import MINIMUM_VOXELS
from ...io.schema import defaults_of
from ...io.study_sizes import sizes
from ...io.volumes import Volume
from ...phantom.ct import kept_columns, make_rois, read_hu, trimmed
from ...phantom.masks import report_other_frame
from ...phantom.plausibility import note_without_air, require_known_checks
from ...phantom.rois import read_roi_entries
from ...study.checks.coverage import points_of, reach_mm, rows_for, worst_share
from ...study.costs.rates import read_rates
from ...study.costs.table import cost_summary
from .body_box import box_is_needed, keep_box, widened_box
from .regions import Region, read_regions
from .rois import ChosenRegion, choose, largest
from .sampling import SPARE_ROWS, propose_grid, propose_scan, scanned_slices

SIZES = ("quick", "normal")


@dataclass(frozen=True)
class Proposal:
    """Proposed configuration and the data it is based on.

    Attributes
    ----------
    image : Volume
        The CT, HU.
    size : str
        One of SIZES.
    selected : tuple of ChosenRegion
        Regions that become ROIs.
    rejected : tuple of (Region, str)
        Other regions, each with the reason.
    voxels : dict of str to int
        Voxels of each ROI on the study's grid.
    reach_mm : float
        Largest distance of the body from the isocenter.
    box_mm : list
        Scanned box around the body, [[x, x], [y, y]], NIfTI world mm.
    cost : dict
        See costs.table.cost_summary.
    """

    image: Volume
    size: str
    selected: tuple[ChosenRegion, ...]
    rejected: tuple[tuple[Region, str], ...]
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
    """Propose a configuration for a CT and its segmented regions.

    Parameters
    ----------
    image : str or Path
        NIfTI file, or folder with one DICOM series; HU.
    labels : str or Path
        Label map, DICOM SEG, RTSTRUCT or mask, or a folder of masks.
    names : mapping of str to str, optional
        {label: name}; these regions are selected before larger ones.
    rois : sequence of str, optional
        Labels or names of the regions to use; by default the largest suitable ones.
    size : {"normal", "quick"}, optional
        quick: a trial run with coarse voxels, few protocols and few repeats.
    instead : str, optional
        Command that starts a normal study of the same CT. The pages of a quick study show it.
    not_checked : sequence of str, optional
        Checks of the CT to skip, see phantom.ct.not_checked.
    fill_gaps : bool, optional
        Interpolate missing slices of a region between two drawn slices.

    Raises
    ------
    InputError
        For a file that cannot be read, a region of `rois` that is missing or unsuitable, and fewer than two tissue
        classes.
    """
    if size not in SIZES:
        raise InputError(f"--size: '{size}' is not known; {did_you_mean(size, SIZES)}")
    defaults = sizes()[size]
    require_known_checks(not_checked)
    ct = read_hu(Path(image), not_checked)
    note_without_air(ct.array, image)
    ct = Volume(np.maximum(ct.array, np.float32(HU_AIR)), ct.grid)
    report_other_frame(labels, image)
    regions = inside = read_regions(ct, labels, names or {}, rois, fill_gaps)
    box, outside = keep_box(ct, inside, scanned_slices(ct.grid, inside))
    if rois:
        box, outside = widened_box(box, outside), []
    rejected = [(region, "lies outside the trunk, as in an arm, and would widen the scanned box") for region in outside]
    inside = [region for region in inside if region not in outside]
    if not inside:
        raise InputError(f"{labels}: no region lies in the trunk; name regions by --rois")
    grid, _ = propose_grid(ct.grid, box, inside, defaults["voxels_across"])
    selected, unfit = _choose_all(inside, grid, fill_gaps)
    rejected += unfit
    if not rois:
        selected, further = largest(selected, defaults["regions"], (names or {}).values())
        rejected += [(roi.region, f"not among the {defaults['regions']} largest suitable regions") for roi in further]
    elif unfit:
        region, reason = unfit[0]
        raise InputError(f"--rois: {region.name} {reason}; remove it, or use --size normal or a finer CT")
    _require_region(selected, labels)
    grid, oversampling = propose_grid(ct.grid, box, [roi.region for roi in selected], defaults["voxels_across"])
    common = None if Path(labels).is_dir() else str(labels)
    keep = box_is_needed(ct, box, grid)
    body = trimmed(ct, box) if keep else ct
    selected, found, lost = _on_grid(selected, common, ct.grid, grid, kept_columns(box, ct.grid))
    rejected += lost
    _require_region(selected, labels)
    reach = reach_mm(body, grid)
    phantom = {
        "image": str(image),
        **({"labels": common} if common else {}),
        **({"not_checked": list(not_checked)} if not_checked else {}),
        "centre_mm": list(grid.centre_mm),
        **({"keep_mm": box} if keep else {}),
        "rois": [roi.setting(common) for roi in selected],
    }
    config = {
        "base": PAPER_GROUPS,
        "phantom": {"source": "ct", "ct": phantom},
        "grid": {"shape": list(grid.shape), "spacing_mm": list(grid.spacing), "oversampling": oversampling},
        "scan": propose_scan(grid, reach),
        "reconstruction": defaults["reconstruction"],
        "noise": {"model": "astra", "levels": defaults["levels"]},
        "protocols": defaults["protocols"],
        "analyses": defaults["analyses"],
        "measured": {"overlay": False},
        "results_dir": results_dir,
    }
    if size == "quick":
        config = {"trial": instead or True} | config
    config["scan"]["rows"] = _rows(config, grid, found)
    plan = Plan(read_study(config))
    _, cost = cost_summary(plan, "cpu", read_rates(RESOURCES / "rates.yaml"))
    return Proposal(
        image=ct,
        size=size,
        selected=tuple(selected),
        rejected=tuple(sorted(rejected, key=lambda pair: [region.name for region in regions].index(pair[0].name))),
        voxels={name: int(mask.sum()) for name, mask in found.items()},
        reach_mm=reach,
        box_mm=box,
        config=_with_nulls(config, size),
        cost=cost,
    )


def _choose_all(
    regions: Sequence[Region], grid: Grid, fill_gaps: bool
) -> tuple[list[ChosenRegion], list[tuple[Region, str]]]:
    """Return the suitable regions as ROIs, and the others with the reason."""
    choices = [(region, choose(region, grid, fill_gaps)) for region in regions]
    return (
        [choice for _, choice in choices if isinstance(choice, ChosenRegion)],
        [(region, choice) for region, choice in choices if isinstance(choice, str)],
    )


def _require_region(selected: Sequence[ChosenRegion], labels: str | Path) -> None:
    if not selected:
        raise InputError(f"{labels}: no region is suitable; draw larger regions")


def _on_grid(
    selected: Sequence[ChosenRegion], common: str | None, ct: Grid, grid: Grid, kept: np.ndarray
) -> tuple[list[ChosenRegion], dict[str, np.ndarray], list[tuple[Region, str]]]:
    """Return the regions that are large enough on the grid, the masks of their ROIs, and the others with the reason."""
    opened: dict = {}
    suitable, masks, lost = [], {}, []
    for chosen in selected:
        region = chosen.region
        (entry,) = read_roi_entries([chosen.setting(common)], common)
        try:
            rois = make_rois(entry, ct, grid, kept, opened)
        except InputError as error:
            lost.append((region, str(error).removeprefix(f"ROI {region.name} ")))
            continue
        few = min(int(roi.mask.sum()) for roi in rois)
        if few < MINIMUM_VOXELS:
            lost.append((region, f"is too small: {few} voxels of this grid, texture needs {MINIMUM_VOXELS}"))
            continue
        suitable.append(chosen)
        masks |= {roi.name: roi.mask for roi in rois}
    return suitable, masks, lost


def _rows(config: dict, grid: Grid, masks: Mapping[str, np.ndarray]) -> int:
    """Return the detector rows that see every ROI from all directions in every protocol, plus a few spare rows."""
    scan = from_mapping(ScanSettings, defaults_of("scan") | config["scan"])
    points = np.concatenate(list(points_of(grid, masks).values()))
    rows = scan.rows
    for projections in sorted({protocol["projections"] for protocol in config["protocols"].values()}):
        if worst_share(replace(scan, rows=rows), projections, grid, points) == 1:
            continue
        least = rows_for(replace(scan, rows=rows), projections, grid, points)
        if least is None:
            raise InputError(
                f"CT: no number of detector rows sees all regions, which span {grid.extent_mm[0]:.0f} mm along z, in "
                f"{projections} projections; use fewer regions by --rois"
            )
        rows = least + SPARE_ROWS
    return rows + rows % 2


def _with_nulls(config: dict, size: str) -> dict:
    """Return the configuration with nulls that remove the other protocols and noise levels of the paper's groups."""
    config, default = copy.deepcopy(config), sizes()["normal"]
    if size != "normal":
        sections = ((config["protocols"], default["protocols"]), (config["noise"]["levels"], default["levels"]))
        for section, default_section in sections:
            section |= {name: None for name in default_section if name not in section}
    return config
