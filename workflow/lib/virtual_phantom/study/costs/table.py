"""Expected cost of a study by rule and by kind of file, as a table and as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import pandas as pd

from ...base.errors import InputError
from ...config.plan import Plan
from ..progress.status import duration_range
from .diagnoses import rays_text
from .jobs import Job, study_jobs
from .rates import seconds, written_bytes

COLUMNS = ["rule", "stage", "jobs", "core_hours", "longest_job_minutes", "bytes"]


def by_rule(jobs: list[Job], rates: dict) -> pd.DataFrame:
    """Return a table with COLUMNS and one row per rule and stage; NaN if a job has no measured rate."""
    groups: dict[tuple[str, str], list[Job]] = {}
    for job in jobs:
        groups.setdefault((job.rule, job.stage), []).append(job)
    rows = []
    for (rule, stage), members in groups.items():
        times = [seconds(job, rates) for job in members]
        sizes = [written_bytes(job, rates) for job in members]
        known = None not in times
        hours, longest = (sum(times) / 3600, max(times) / 60) if known else (None, None)
        rows.append((rule, stage, len(members), hours, longest, None if None in sizes else sum(sizes)))
    table = pd.DataFrame(rows, columns=COLUMNS)
    return table.astype({"core_hours": float, "longest_job_minutes": float, "bytes": float})


def cost_summary(plan: Plan, engine: str, rates: dict) -> tuple[pd.DataFrame, dict]:
    """Return the expected cost of a study, by rule and in total.

    Parameters
    ----------
    engine : str
        Projector, see projectors.choose_engine.
    rates : dict
        See rates.read_rates.

    Returns
    -------
    table : DataFrame
        See `by_rule`.
    content : dict
        acquisitions, jobs, core_hours, bytes, bytes_written, bytes_kept and measured (see the rates). bytes is
        {kind: {total, per_acquisition, kept}} for kinds with a rate.

    Raises
    ------
    InputError
        If jobs have no measured rate.
    """
    jobs = study_jobs(plan, engine, len(plan.tissue_classes))
    table = by_rule(jobs, rates)
    missing = table[table["core_hours"].isna()].groupby("stage")["jobs"].sum()
    if len(missing):
        stages = ", ".join(f"{stage} ({count} jobs)" for stage, count in missing.items())
        raise InputError(
            f"rates.yaml: no rate was measured for {stages}; measure it with python -m benchmarks run fit_rates or "
            "sirt_rates (docs/explanation/performance.md)"
        )
    acquisitions = sum(len(plan.seeds(noise)) for _, noise in plan.acquisitions())
    amounts = Counter()
    for job in jobs:
        amounts.update(job.writes)
    amounts["logs"] = len(jobs)
    sizes = {kind: rates["bytes"][kind] * amount for kind, amount in amounts.items() if kind in rates["bytes"]}
    temporary = () if plan.study.keep_images else ("images",)
    content = {
        "acquisitions": acquisitions,
        "jobs": len(jobs),
        "core_hours": float(table["core_hours"].sum()),
        "bytes": {
            kind: {
                "total": round(size),
                "per_acquisition": round(size / acquisitions) if acquisitions else None,
                "kept": kind not in temporary,
            }
            for kind, size in sizes.items()
        },
        "bytes_written": round(sum(sizes.values())),
        "bytes_kept": round(sum(size for kind, size in sizes.items() if kind not in temporary)),
        "measured": rates["measured"],
    }
    return table, content


def plan_text(table: pd.DataFrame, content: dict) -> str:
    """Return the plan as text for a terminal."""
    lines = [f"{content['acquisitions']} acquisitions, {content['jobs']} jobs", ""]
    lines.append(f"{'rule':<34}{'jobs':>7}{'core-hours':>12}{'longest job':>14}")
    for row in table.itertuples():
        name = row.stage if row.rule == "reconstruct" else row.rule
        lines.append(f"{name:<34}{row.jobs:>7}{row.core_hours:>12.3f}{row.longest_job_minutes * 60:>12.0f} s")
    lines.append(f"{'all':<34}{content['jobs']:>7}{content['core_hours']:>12.3f}")
    lines += ["", f"{'files':<34}{'in all':>12}{'per acquisition':>18}"]
    for kind, sizes in content["bytes"].items():
        each = "" if sizes["per_acquisition"] is None else _size(sizes["per_acquisition"])
        kept = "" if sizes["kept"] else "  deleted once used"
        lines.append(f"{kind:<34}{_size(sizes['total']):>12}{each:>18}{kept}")
    lines.append(f"{'written':<34}{_size(content['bytes_written']):>12}")
    lines.append(f"{'kept':<34}{_size(content['bytes_kept']):>12}")
    measured = content["measured"]
    shape, detector = (" x ".join(map(str, measured[key])) for key in ("voxels", "detector_rows_columns"))
    lines += [
        "",
        f"Rates: {measured['jobs']} jobs on {measured['machine']},",
        f"{shape} voxels, {detector} detector pixels.",
    ]
    return "\n".join(lines) + "\n"


def diagnoses_text(forecasts: Sequence[Mapping]) -> str:
    """Return the diagnoses of a plan as text after an empty line; "" without diagnoses.

    Parameters
    ----------
    forecasts : sequence of mapping
        Forecasts of study.diagnosis_jobs.
    """
    if not forecasts:
        return ""
    lines = ["", f"{'diagnosis (snakemake diagnosis)':<34}{'effects':>8}{'rays':>21}{'processes':>11}{'time':>17}"]
    for forecast in forecasts:
        rays = rays_text(forecast["rays"]) if "rays" in forecast else ""
        time = "unknown" if forecast["seconds"] is None else duration_range(*forecast["seconds"])
        effects, processes = forecast.get("effects", ""), forecast.get("processes", "")
        lines.append(f"{forecast['name']:<34}{effects:>8}{rays:>21}{processes:>11}{time:>17}")
    return "\n".join(lines) + "\n"


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB" if count < 1000 else f"{count / 1000:.3g} TB"
