"""Selection of the regions that become ROIs, with their margins and numbers of parts."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ...base.geometry import Grid
from ...base.settings import RoiEntry
from ...features import MINIMUM_VOXELS
from ...phantom.rois import shrink
from .regions import Region

MARGINS_MM = (5.0, 3.0, 2.0, 1.0)  # the first two as in config/abdomen.yaml for organs and vessels
REMAINING_SHARE = 0.3  # fraction of a region's volume that a margin must leave
PART_ML = 80.0  # smallest part: the liver of config/abdomen.yaml has 4 parts, the spleen 2
MOST_PARTS = 4
SPARE_VOXELS = 2  # required multiple of the voxels that texture needs, because resampling to the grid loses rims
# A region with a larger SD contains more than soft tissue, HU. In the CT of config/abdomen.yaml, organs, muscles and
# vessels without calcium have 21 to 37 HU; regions with calcium, bone or gas have at least 94 HU.
SPREAD_HU = 60.0
# Fractions of gas voxels: between the two, a region is an organ with gas in it; above the second, it is lung.
SOME_GAS, MOSTLY_GAS = 0.02, 0.85


@dataclass(frozen=True)
class ChosenRegion:
    """Region that becomes one or more ROIs."""

    region: Region
    margin_mm: float
    parts: int
    fill_gaps: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the ROIs."""
        return RoiEntry(self.region.name, self.region.tissue_class, parts=self.parts).names

    def setting(self, common: str | None) -> dict:
        """Return the entry under phantom.ct.rois; `common` is the file under phantom.ct.labels."""
        region = self.region
        entry: dict = {"name": region.name, "tissue_class": region.tissue_class}
        if region.file != common:
            entry["file"] = region.file
        if region.label is not None:
            entry["label"] = region.label
        if self.margin_mm:
            entry["margin_mm"] = int(self.margin_mm) if self.margin_mm.is_integer() else self.margin_mm
        if self.parts > 1:
            entry["parts"] = self.parts
        if self.fill_gaps:
            entry["fill_gaps"] = True
        return entry


def outline_warning(region: Region) -> str | None:
    """Return a warning if the outline of a region seems to include other tissue; None otherwise."""
    if region.sd_hu > SPREAD_HU and region.gas_share <= SOME_GAS:
        return f"SD {region.sd_hu:.0f}: calcium, bone or air inside?"
    return None


def choose(region: Region, grid: Grid, fill_gaps: bool = False) -> ChosenRegion | str:
    """Return a region as an ROI on the grid of the study, or the reason why it is unsuitable.

    `fill_gaps` tells whether missing slices of the region were interpolated.
    """
    if SOME_GAS < region.gas_share < MOSTLY_GAS:
        return f"contains gas and tissue: {100 * region.gas_share:.0f} % of its voxels are gas"
    # Pad by one voxel, except where the CT ends: for `shrink`, the end of the array is not a surface.
    padding = [(int(s.start > 0), int(s.stop < n)) for s, n in zip(region.box, region.grid.shape, strict=True)]
    padded = np.pad(region.mask, padding)
    padded_grid = Grid(padded.shape, region.grid.spacing)
    least = SPARE_VOXELS * MINIMUM_VOXELS
    for margin in (*MARGINS_MM, 0.0):
        kept = int(np.count_nonzero(shrink(padded, margin, padded_grid)))
        volume = kept * padded_grid.voxel_volume_mm3
        voxels = volume / grid.voxel_volume_mm3
        if margin == 0 or (kept >= REMAINING_SHARE * region.voxels and voxels >= least):
            break
    if voxels < least:
        return f"is too small: about {voxels:.0f} voxels of this grid, at least {least} are needed"
    parts = max(1, min(MOST_PARTS, math.floor(volume / 1000 / PART_ML)))
    return ChosenRegion(region, margin, parts, fill_gaps)


def largest(
    chosen: Sequence[ChosenRegion], most: int, first: Collection[str] = ()
) -> tuple[list[ChosenRegion], list[ChosenRegion]]:
    """Return the `most` largest regions and the others, both in the order of `chosen`.

    Regions named in `first` are selected before larger regions.
    """
    order = sorted(chosen, key=lambda roi: (roi.region.name not in first, -roi.region.volume_ml))
    selected = {roi.region.name for roi in order[:most]}
    return [c for c in chosen if c.region.name in selected], [c for c in chosen if c.region.name not in selected]
