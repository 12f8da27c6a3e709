"""Stability of every feature by W, ICC, CCC and coefficients of variation, and which features are stable by which."""

from virtual_phantom.features import tables
from virtual_phantom.features.names import features_of
from virtual_phantom.io import files
from virtual_phantom.statistics import stability_measures
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params, output = snakemake.params, snakemake.output
    source = str(snakemake.input.features)
    table = tables.select_groups(
        tables.read_features(source), dict(params.groups), noise=params.noise, seeds=params.seeds
    )
    scores = files.read_csv(snakemake.input.trust)
    measured = stability_measures.measure_table(table, scores, features_of(table), params.cut_offs, source)
    features = stability_measures.stable_by_feature(measured)
    files.write_csv(measured, output.measures)
    files.write_csv(features, output.features)
    for measure, rows in measured.groupby("measure", sort=False):
        counts = rows["stable"].value_counts()
        log.info(
            "%s, cut-off %g: %d of %d features stable, %d undefined",
            measure,
            rows["cut_off"].iloc[0],
            counts.get("yes", 0),
            len(rows),
            counts.get("undefined", 0),
        )
    log.info("stable by all measures: %d", (features["stable_by"] == len(stability_measures.CUT_OFFS)).sum())
