"""Compute the overlap of the highest-ranked simulated and measured features, for equal numbers of repeats."""

from collections.abc import Mapping

from virtual_phantom.features.names import features_of
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import measured, ranking, wilcoxon
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    scores: str,
    output: str,
    images: Mapping,
    statistics: Mapping,
    measured_acquisitions: str | None,
) -> None:
    if measured_acquisitions:
        recorded = measured.load_score_draws(images["seeds"], measured_acquisitions)
    else:
        recorded = ranking.assessed(files.read_csv(scores), scores)
    repeats = int(recorded["repeats"].iloc[0])
    features = read_groups(features_file, **{**images, "seeds": repeats})
    simulated = wilcoxon.scores(features, features_of(features), source=features_file, **statistics)
    simulated = ranking.assessed(simulated, features_file)
    table = ranking.overlap(simulated, recorded, ranking.shared_variance(features, features_of(features)))
    files.write_csv(table, output)
    for kind in ranking.KINDS:
        first, ten = table.iloc[0], table.iloc[min(9, len(table) - 1)]
        log.info(
            "%s at %d repeats: area %.3f, SD %.3f (unrelated lists %.3f, 97.5 %% of them below %.3f). Above their band "
            "at %d of %d lengths. Shared: %.1f of the %d best, SD %.1f",
            kind,
            repeats,
            *(first[f"area_{kind}{what}"] for what in ("", "_sd", "_expected", "_upper")),
            ranking.lengths_above(table, kind),
            len(table),
            ten["n_top"] * ten[f"overlap_{kind}_percent"] / 100,
            ten["n_top"],
            ten["n_top"] * ten[f"overlap_{kind}_sd"] / 100,
        )


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            scores=snakemake.input.scores,
            output=snakemake.output[0],
            images=snakemake.params.images,
            statistics=snakemake.params.statistics,
            measured_acquisitions=snakemake.params.measured_acquisitions,
        )
