"""The stability of every feature with the study's physics and without, and whether they differ."""

from virtual_phantom.features import tables
from virtual_phantom.features.names import features_of
from virtual_phantom.io import files
from virtual_phantom.statistics import physics_change, trust
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    source = str(snakemake.input.features)
    groups = dict(params.groups)
    table = tables.select_groups(tables.read_features(source), groups, noise=params.noise, seeds=params.seeds)
    without = trust.trust_table(
        table,
        features_of(table),
        {groups[protocol]: label for protocol, label in params.sharing.items()},
        params.cut_offs["w_stability_percent"],
        threshold=params.statistics["threshold"],
        compare=params.statistics["compare"],
        source=source,
    )
    found = physics_change.stability_change(files.read_csv(snakemake.input.trust), without)
    files.write_csv(found, snakemake.output[0])
    log.info("%d of %d features change", (found["changed"] == "yes").sum(), len(found))
