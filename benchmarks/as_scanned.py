"""Compare the noise of the drawn phantom with the printed phantom's, scanned in the same way (2 minutes).

First run `snakemake --cores 2 results-as-scanned/projections/views2928/clean.h5 --configfile config/as_scanned.yaml`.
Each acquisition reconstructs only the largest section of one region, from the views that the section needs. All groups
reconstruct the same acquisitions. Prints the table of docs/validation/printed-phantom.md and the A at which group 2 has
the measured variance, and draws docs/images/as_scanned.png. An acquisition takes 20 s of one core and 2 GB.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks import common
from virtual_phantom.base.geometry import grid_of
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.config.settings import Study
from virtual_phantom.features import extraction
from virtual_phantom.features.names import VARIANCE
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.figures import style
from virtual_phantom.io.exchange import read_line_integrals
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.reconstruction.boxes import back_in_boxes, boxes_around, voxels_over
from virtual_phantom.reconstruction.fbp import ParallelProjections
from virtual_phantom.reconstruction.kernel import Kernel
from virtual_phantom.simulation.acquire import acquire
from virtual_phantom.statistics import measured

NAMES = {2: "B30f", 4: "B30f", 6: "B30f", 8: "B26f"}
MET, ROI = 2, "cyst_1"  # group that the noise level is matched to, and its region
GRAIN = "original_glcm_Correlation"
LEVEL = "as_scanned"


def acquisitions(config: Study, results: Path, repeats: int) -> pd.DataFrame:
    """SD, GLCM correlation and mean of the region, per acquisition and group."""
    (path,) = (results / "projections").glob("*/clean.h5")
    clean, geometry = read_line_integrals(path)
    grid, parameters = grid_of(config.grid), read_parameters(None, "largest", config.features.stored_offset_hu)
    seed = branch(config.seed, Branch.PHANTOM)
    groups = {}
    for protocol in config.protocols.values():
        voxels = voxels_over(grid, protocol.voxels.spacing_mm)
        (roi,) = (protocol for protocol in synthetic.rois(layout.read_layout(), voxels, seed) if protocol.name == ROI)
        largest = int(np.count_nonzero(roi.mask, axis=(1, 2)).argmax())
        section = np.zeros_like(roi.mask)
        section[largest] = roi.mask[largest]
        groups[protocol.group] = protocol, voxels, section
    # Views whose beam reaches the section, with a margin for the fan.
    middle = np.mean([voxels.axes_mm()[0][section.any(axis=(1, 2))][0] for _, voxels, section in groups.values()])
    reach = geometry.rows * geometry.row_pitch_mm / geometry.magnification * (0.5 * (1 + 80 / 595) + 0.1) + 3
    seen = np.flatnonzero(np.abs(geometry.source_z_mm - middle) < reach)
    part = slice(seen[0], seen[-1] + 1)
    views = {"angles_rad": geometry.angles_rad[part], "source_z_mm": geometry.source_z_mm[part], "view_times": None}
    near = replace(geometry, **views)
    rows = []
    for repeat in range(repeats):
        counts = acquire(
            clean[part],
            geometry=path.parent.name,
            noise=LEVEL,
            noise_level=config.noise.levels[LEVEL].A,
            seed=repeat,
            model=config.noise.model,
            study_seed=config.seed,
        )
        lines = counts.line_integrals(config.noise.zero_counts_as)[None].astype(np.float32)
        filtered = {}
        for group, (protocol, voxels, section) in groups.items():
            kernel = Kernel(**vars(protocol.kernel))
            if kernel not in filtered:
                filtered = {kernel: ParallelProjections.of(lines, near, kernel)}  # one at a time: each takes a gigabyte
            (box,) = boxes_around([section], voxels)
            height = int(np.flatnonzero(section.any(axis=(1, 2)))[0])
            (image,) = back_in_boxes(
                filtered[kernel],
                voxels,
                [(slice(height, height + 1), *box[1:])],
                mu_water_per_mm=config.mu_water_per_mm,
                thickness_mm=protocol.voxels.thickness_mm,
            )
            volume = Volume(np.rint(image).astype(np.int16), voxels)
            found = extraction.extract(volume, {ROI: section}, parameters=parameters).iloc[0]
            row = {"group": group, "seed": repeat, "variance": found[VARIANCE], "grain": found[GRAIN]}
            rows.append(row | {"mean": found["original_firstorder_Mean"]})
            print(rows[-1], flush=True)
    return pd.DataFrame(rows)


def summary(table: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Simulated means with standard errors, and measured means, per group."""
    images = table.assign(sd=np.sqrt(table["variance"])).groupby("group")
    simulated = images[["sd", "grain", "variance"]].mean()
    simulated[["sd_error", "grain_error"]] = images[["sd", "grain"]].sem()
    known = measured.load_group_summary().query("roi == @ROI").pivot(index="group", columns="feature", values="mean")
    printed = pd.DataFrame({"sd": np.sqrt(known[VARIANCE]), "grain": known[GRAIN], "variance": known[VARIANCE]})
    return simulated, printed.loc[simulated.index]


def text(simulated: pd.DataFrame, printed: pd.DataFrame, config: Study) -> str:
    """Markdown table for the page."""
    lines = [
        "| group | slice, mm | kernel | SD measured, HU | simulated | over group 2, measured | predicted | off | "
        "GLCM correlation, measured | simulated |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    thickness = {protocol.group: protocol.voxels.thickness_mm for protocol in config.protocols.values()}
    for group, kernel in NAMES.items():
        real, made = printed.loc[group], simulated.loc[group]
        ratios = [one["sd"] / table.loc[MET, "sd"] for one, table in ((real, printed), (made, simulated))]
        off = "met" if group == MET else f"{100 * (ratios[1] / ratios[0] - 1):+.1f} %"
        lines.append(
            f"| {group} | {thickness[group]:.1f} | {kernel} | {real['sd']:.1f} | {made['sd']:.1f} ± "
            f"{made['sd_error']:.1f} | {ratios[0]:.3f} | {ratios[1]:.3f} | {off} | {real['grain']:.3f} | "
            f"{made['grain']:.3f} |"
        )
    return "\n".join(lines)


@style.styled(grid=True)
def draw(simulated: pd.DataFrame, printed: pd.DataFrame, config: Study):
    """Plot simulated and measured SD and GLCM correlation per group."""
    figure = style.figure(style.DOUBLE_COLUMN_MM, 62)
    words = {"sd": "SD in the large cyst's section (HU)", "grain": "GLCM Correlation"}
    thickness = {protocol.group: protocol.voxels.thickness_mm for protocol in config.protocols.values()}
    names = [f"group {group}\n{thickness[group]:.1f} mm, {NAMES[group]}" for group in simulated.index]
    at = np.arange(len(names))
    for index, (axes, (what, word)) in enumerate(zip(figure.subplots(1, 2), words.items(), strict=True)):
        axes.plot(at - 0.06, printed[what], "o", color=style.ON_WHITE[0], label="measured, mean of 30 acquisitions")
        errors = simulated[f"{what}_error"]
        label = "simulated, ± standard error (noise of group 2 met)"
        axes.errorbar(at + 0.06, simulated[what], yerr=errors, fmt="s", color=style.ON_WHITE[1], capsize=2, label=label)
        axes.set(ylabel=word, ylim=(0, None))
        axes.set_xticks(at, names)
        style.letter_panel(axes, index)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncol=2)
    return figure


def add_arguments(parser):
    parser.add_argument("--results", type=Path, default=common.ROOT / "results-as-scanned")
    parser.add_argument("--image", type=Path, default=common.ROOT / "docs" / "images" / "as_scanned.png")
    parser.add_argument("--repeats", type=int, default=4)


def run(options):
    config = common.configuration("config/as_scanned.yaml")
    simulated, printed = summary(acquisitions(config, options.results, options.repeats))
    print(text(simulated, printed, config))
    level = config.noise.levels[LEVEL].A * printed.loc[MET, "variance"] / simulated.loc[MET, "variance"]
    print(f"\nGroup {MET} would have the measured variance in {ROI} at A = {level:.3g}")
    style.save(draw(simulated, printed, config), [options.image])
