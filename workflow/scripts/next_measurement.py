"""Rank further recordings: table and figure, similarity of the effects, and a recording.yaml to fill in."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from virtual_phantom.base.settings import from_mapping, to_mapping
from virtual_phantom.diagnosis.planning.ranking import effect_similarity, found_in, possible, rank, refit, refit_jointly
from virtual_phantom.diagnosis.planning.tables import (
    best_measurement_text,
    ranking_table,
    recording_template,
    similarity_table,
)
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.scanner.scanner import protocols_of
from virtual_phantom.diagnosis.selection.forward_selection import AS_GOOD
from virtual_phantom.diagnosis.selection.transfer import with_declared
from virtual_phantom.diagnosis.settings import FitSettings
from virtual_phantom.diagnosis.setup.check import NOT_CHECKED, read_setup
from virtual_phantom.figures.next_measurement import draw_ranking
from virtual_phantom.figures.style import save
from virtual_phantom.io.files import read_text, write_text
from virtual_phantom.study.job import job, log


def main(
    *,
    diagnosis_file: str,
    phantom_file: str | None,
    declared_file: str | None,
    setup_files: Sequence[str] | None,
    output: str,
    name: str,
    models: Mapping[str, FitSettings],
    effect_names: Sequence[str],
    protocol_names: Mapping | None,
    threads: int,
) -> None:
    folder = Path(output)
    diagnosis = json.loads(read_text(diagnosis_file))
    folder.mkdir(parents=True, exist_ok=True)
    named = [effect["name"] for effect in diagnosis["effects"]]
    result = f"{name}: no effect is missing, so that no alternatives remain to distinguish"
    if named:
        models = {name: with_declared(model, declared_file) for name, model in models.items()}
        setups = [diagnosis.get("setup", NOT_CHECKED)] if setup_files is None else list(map(read_setup, setup_files))
        made = {
            name: prepare_recording(DiagnosisRequest.of(model, phantom_file, threads).located(setup["location"]))
            for (name, model), setup in zip(models.items(), setups, strict=True)
        }
        known = {effect for model in models.values() for effect in model.settings.baseline}
        effects = [name for name in effect_names if name not in known]
        prepared = {recording: dataset for recording, (_, dataset) in made.items()}
        baselines = {recording: dataset.fitter.fit(()) for recording, dataset in prepared.items()}
        alike = effect_similarity(prepared, baselines, effects)
        protocols = None
        if len(prepared) == 1:
            chosen, ambiguities = refit(*prepared.values(), *prepared, found_in(diagnosis))
        else:
            protocols = protocols_of(prepared, protocol_names)
            chosen, ambiguities = refit_jointly(prepared, named, effects, alike, protocols)
        first = next(iter(prepared))
        settings = to_mapping(models[first].settings)
        found = rank(prepared, chosen, ambiguities, possible(prepared), protocols)
        rows = ranking_table(found)
        write_text(rows.to_csv(index=False), folder / "ranking.csv")
        write_text(similarity_table(alike).to_csv(index=False), folder / "effect_correlations.csv")
        save(draw_ranking(rows, AS_GOOD), [folder / "ranking.png", folder / "ranking.pdf"])
        document = made[first][0].document.content
        text = recording_template(first, found.ranked[0], document, settings, len(document["repeats"]))
        write_text(text, folder / "recording.yaml")
        result = f"{name}: {best_measurement_text(found)}"
    log.info("%s", result)
    print(result)


if "snakemake" in globals():
    with job(snakemake):
        main(
            diagnosis_file=snakemake.input.diagnosis,
            phantom_file=snakemake.input.get("phantom"),
            declared_file=snakemake.input.get("declared"),
            setup_files=snakemake.input.get("setups"),
            output=snakemake.output[0],
            name=snakemake.params.what,
            models=from_mapping(dict[str, FitSettings], snakemake.params.models),
            effect_names=snakemake.params.effects,
            protocol_names=snakemake.params.get("protocols"),
            threads=snakemake.threads,
        )
