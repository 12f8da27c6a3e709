"""Report of a diagnosis of features: one HTML file with its figures."""

from __future__ import annotations

from ..diagnosis.features.selection import MATERIAL
from ..diagnosis.features.verdict import FeatureDiagnosis
from ..diagnosis.residuals.residual_tests import ALPHA
from ..figures import feature_diagnosis as figures
from .html import picture, render_diagnosis

MOST_PLACES = 20


def feature_diagnosis_page(diagnosis: FeatureDiagnosis) -> str:
    """Return the report as HTML."""
    trials, found = diagnosis.trials, diagnosis.content["effects"]
    families = next(iter(diagnosis.content["candidates"].values()))["families"]
    return render_diagnosis(
        "diagnosis_of_features",
        diagnosis.content,
        families=list(families),
        misses=list(families.values()) if diagnosis.before.significant else [],
        before=len(diagnosis.before.significant),
        after=len(diagnosis.after.significant),
        tested=len(diagnosis.before.locations),
        most=MOST_PLACES,
        alpha=ALPHA,
        material=MATERIAL,
        shifts=picture(figures.draw_shifts(diagnosis.before.cells, diagnosis.after.cells if found else None)),
        shares=picture(
            figures.draw_shares(
                {image_property.name: trial.fitted for image_property, trial in trials.items()},
                {image_property.name: trial.held_out for image_property, trial in trials.items()},
                tuple(effect["name"] for effect in found),
                MATERIAL,
            )
        ),
    )
