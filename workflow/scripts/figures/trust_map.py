"""Figure of the robustness of every feature against every kind of change."""

from collections.abc import Mapping

from virtual_phantom.figures import trust_map
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(*, table: str, outputs: list[str], cut_offs: Mapping[str, float], trial: bool) -> None:
    trust = files.read_csv(table)
    limits = trust_map.cut_offs(trust, cut_offs["ccc"])
    trust_map.save(trust_map.heat_map(trust, limits, trial=trial), outputs)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table=snakemake.input.table,
            outputs=[snakemake.output.png, snakemake.output.pdf],
            cut_offs=snakemake.params.cut_offs,
            trial=snakemake.params.trial,
        )
