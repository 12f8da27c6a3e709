"""Which regions become ROIs, how far they are shrunk and into how many parts they are cut."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ...base.geometry import Grid
from ...features.extraction import MINIMUM_VOXELS
from ...phantom.rois import shrink
from .regions import Region

MARGINS_MM = (5.0, 3.0, 2.0, 1.0)  # of config/abdomen.yaml for organs and vessels, and less for what is thinner
LEFT = 0.3  # of a region's volume that a margin must leave
PART_ML = 80.0  # of a part at least: the liver of config/abdomen.yaml is cut in 4, the spleen in 2
MOST_PARTS = 4
SPARE_VOXELS = 2  # times as many voxels as texture needs are wanted: rims are lost on the way to the grid
# Over this SD something else than soft tissue lies in a region, HU. In TotalSegmentator's test case, the CT of
# config/abdomen.yaml, organs, vessels without calcium and muscles have 21 to 37, what holds calcium, bone or gas 94 up.
SPREAD_HU = 60.0
SOME_GAS, MOSTLY_GAS = 0.02, 0.85  # of a region's voxels; between them it is an organ and its gas, over them lung


@dataclass(frozen=True)
class Chosen:
    """A region as an ROI of the configuration."""

    region: Region
    margin_mm: float
    parts: int
    fill_gaps: bool = False

    @property
    def names(self) -> list[str]:
        """Of the ROIs."""
        name = self.region.name
        return [name] if self.parts == 1 else [f"{name}_{number}" for number in range(1, self.parts + 1)]

    def setting(self, common: str | None) -> dict:
        """The entry under phantom.ct.rois; `common` is the file under phantom.ct.labels."""
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


def unsuitable(region: Region) -> str | None:
    """Why a region makes no good ROI, as far as it tells itself; None if nothing is against it."""
    if SOME_GAS < region.gas_share < MOSTLY_GAS:
        return f"holds gas beside tissue: {100 * region.gas_share:.0f} % of its voxels"
    return None


def doubtful(region: Region) -> str | None:
    """What may be wrong with the outline of a region that becomes an ROI; None if nothing seems to be."""
    if region.sd_hu > SPREAD_HU and region.gas_share <= SOME_GAS:
        return f"SD {region.sd_hu:.0f}: calcium, bone or air inside?"
    return None


def choose(region: Region, grid: Grid, fill_gaps: bool = False) -> Chosen | str:
    """A region as an ROI on a grid, or why it is none.

    Parameters
    ----------
    grid : Grid
        Of the study.
    fill_gaps : bool, optional
        Whether slices of the region that are not drawn were interpolated.
    """
    if reason := unsuitable(region):
        return reason
    # A voxel around it, but not where the CT ends: that is no surface, and `shrink` takes none there.
    around = [(int(s.start > 0), int(s.stop < n)) for s, n in zip(region.box, region.grid.shape, strict=True)]
    padded = np.pad(region.mask, around)
    own = Grid(padded.shape, region.grid.spacing)
    least = SPARE_VOXELS * MINIMUM_VOXELS
    for margin in (*MARGINS_MM, 0.0):
        kept = int(np.count_nonzero(shrink(padded, margin, own)))
        volume = kept * own.voxel_volume_mm3
        voxels = volume / grid.voxel_volume_mm3
        if margin == 0 or (kept >= LEFT * region.voxels and voxels >= least):
            break
    if voxels < least:
        return f"is too small: about {voxels:.0f} voxels of this grid, {least} are wanted"
    parts = max(1, min(MOST_PARTS, math.floor(volume / 1000 / PART_ML)))
    return Chosen(region, margin, parts, fill_gaps)


def largest(chosen: Sequence[Chosen], most: int, first: Collection[str] = ()) -> tuple[list[Chosen], list[Chosen]]:
    """The largest regions and the others, each in the order of the file.

    Parameters
    ----------
    most : int
        How many.
    first : collection of str, optional
        Names of regions that go before larger ones.
    """
    order = sorted(chosen, key=lambda one: (one.region.name not in first, -one.region.volume_ml))
    taken = {one.region.name for one in order[:most]}
    return [c for c in chosen if c.region.name in taken], [c for c in chosen if c.region.name not in taken]
