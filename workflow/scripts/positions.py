"""Write the position of the phantom in every repeat of every noise level."""

from collections.abc import Mapping, Sequence

import pandas as pd

from virtual_phantom.base.pose import IN_PLACE
from virtual_phantom.io import files
from virtual_phantom.phantom.repositioning import random_pose
from virtual_phantom.study.job import job, log


def main(*, output: str, repeats: Sequence[Mapping]) -> None:
    rows = []
    for row in repeats:
        pose = random_pose(**row["pose"]) if row["repositioned"] else IN_PLACE
        place = {key: getattr(pose, key) for key in ("x_mm", "y_mm", "z_mm", "turn_deg")}
        rows.append({key: row[key] for key in ("noise", "seed", "repositioned")} | place)
    files.write_csv(pd.DataFrame(rows), output)
    log.info("%d repeats, %d of them re-positioned", len(rows), sum(row["repositioned"] for row in rows))


if "snakemake" in globals():
    with job(snakemake):
        main(output=snakemake.output[0], repeats=snakemake.params.repeats)
