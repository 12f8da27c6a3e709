"""Compute stability and discriminative power of every feature over the groups, and controls of their means."""

from collections.abc import Mapping

from virtual_phantom.features.names import features_of
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import controls, wilcoxon
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    noise_control: str | None,
    output: str,
    controls_output: str,
    images: Mapping,
    statistics: Mapping,
) -> None:
    table = read_groups(features_file, **images)
    options = {"source": features_file, **statistics}
    files.write_csv(wilcoxon.scores(table, features_of(table), **options), output)
    found = controls.controls(table, features_of(table), **options)
    if noise_control:
        noise_only = files.read_csv(noise_control)
        found = controls.add_noise_control(found, noise_only, features_of(table), **statistics, source=noise_control)
    files.write_csv(found, controls_output)
    means = controls.headline(found)
    log.info("mean stability %s, mean discriminative power %s", means["stability"], means["discrimination"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            noise_control=snakemake.input.get("noise_control") or None,
            output=snakemake.output.scores,
            controls_output=snakemake.output.controls,
            images=snakemake.params.images,
            statistics=snakemake.params.statistics,
        )
