"""Report of a diagnosis: one HTML file with its figures, and all files of a diagnosis."""

from __future__ import annotations

import numpy as np

from ..diagnosis.fitting.fit import Fit
from ..diagnosis.residuals.dataset import Prepared
from ..diagnosis.residuals.residual_tests import ALPHA
from ..diagnosis.result_files import RESIDUAL_MAPS, DiagnosisFiles, write_diagnosis
from ..diagnosis.setup.unknown_object import DataMaps
from ..diagnosis.verdict.verdict import Diagnosis
from ..diagnosis.verdict.warnings import advice
from ..diagnosis.verdict_text import DIFFERENCES, PRACTICAL
from ..figures import diagnosis as figures
from ..physics.effect import load
from .agreement_table import agreement_table
from .html import picture, render_diagnosis
from .words import DOMAINS, ONE_SIDED, describe_nuisance

STEPPED = "views"  # domain with one location per fitted view
QUANTITIES = {"line_integral": "line integral", "hu": "HU"}  # by unit of the residuals
PIXELS_ACROSS = 120  # of the residual map: with more, a block holds too few rays


def write_results(diagnosis: Diagnosis, output: DiagnosisFiles) -> None:
    """Write diagnosis.json, physics.yaml, the report and the maps."""
    content, overlay = diagnosis.content, {}
    if diagnosis.choice is None:
        shown, maps = diagnosis.setup.maps, {}
        unknown = isinstance(diagnosis.setup, DataMaps)
        html = data_page(content, diagnosis.setup) if unknown else setup_page(content, *shown)
    else:
        shown = residual_maps(diagnosis)
        maps = {location.domain: location.map for location in diagnosis.before}
        html = diagnosis_page(diagnosis, shown)
        if content["verdict"] != PRACTICAL:
            overlay = overlay_of(diagnosis)
    maps |= dict(zip(RESIDUAL_MAPS, shown, strict=True))
    write_diagnosis(output, content, overlay, html, maps)


def overlay_of(diagnosis: Diagnosis) -> dict:
    """Return the physics found as a configuration of the study."""
    fit = diagnosis.choice.chosen.fit
    physics = diagnosis.prepared.fitter.model.in_study_units(fit.physics, fit.nuisance)
    return {"physics": physics, "noise": {"model": "physical"}}


def diagnosis_page(diagnosis: Diagnosis, maps: tuple[np.ndarray, np.ndarray]) -> str:
    """Return the report of a diagnosis, with the maps of `residual_maps`, as HTML."""
    content, choice, prepared = diagnosis.content, diagnosis.choice, diagnosis.prepared
    after, display = {location.domain: location for location in diagnosis.after}, prepared.display
    image = diagnosis.scanned and diagnosis.scanned.fine
    pieces = content.get("object", {}).get("pieces", [])
    fit = choice.chosen.fit
    axes = figures.MapAxes(display.across, display.down, display.summed == 0, _steps(prepared))
    profile = (content.get("agreement") or {}).get("profile")
    title = f"{content['recording']}: mean over {('slices', 'rows')[display.summed]}"
    data = _data_maps(diagnosis)
    every = prepared.step * round(prepared.held_out.usable.shape[1 - display.summed] / len(data[0]))
    of_data = figures.MapAxes(display.across, display.down, display.summed == 0, (every, 1))
    profiles, letters = _profiles(diagnosis), len(data) + 1 + len(maps)  # one letter for each panel of the page
    return render_diagnosis(
        "diagnosis",
        content,
        effects={effect["name"]: load(effect["name"]) for effect in content["effects"]},
        doubts=[f"{doubt}." for doubt in content["doubts"]] + advice(fit, prepared.fitter.model) + content["caveats"],
        places=[(location, after[location.domain]) for location in diagnosis.before],
        alpha=ALPHA,
        agreement=agreement_table(content.get("agreement")),
        data=picture(figures.draw_data(*data, title, of_data, QUANTITIES[display.unit])),
        maps=picture(figures.draw_maps(*maps, None, axes, len(data) + 1)),
        profiles=picture(figures.draw_profiles(profiles, letters)),
        profile=picture(figures.draw_image_profile(profile, letters + len(profiles))) if profile else None,
        one_repeat=display.one_repeat,
        ranking=picture(figures.draw_ranking(choice.alone, choice.gains, choice.singles)) if choice.alone else None,
        pieces=picture(figures.draw_pieces(image, pieces)) if pieces and image is not None else None,
        object=None if image is None else picture(figures.draw_object(image)),
        domains=DOMAINS,
        quantities={name: text.replace("{} ", "") for name, text in DIFFERENCES.items()},
        one_sided=ONE_SIDED,
        nuisances={name: describe_nuisance(name) for name in content["alignment"]},
    )


def setup_page(content: dict, stated: np.ndarray, best: np.ndarray) -> str:
    """Return the report of a recording with a wrong set-up or object, as HTML.

    Parameters
    ----------
    stated, best : ndarray, shape (down, across)
        Residuals of the scan as described and as corrected.
    """
    maps = picture(figures.draw_setup(stated, best, content["recording"], content["setup"]["of"]))
    return render_diagnosis("diagnosis_of_setup", content, maps=maps)


def data_page(content: dict, maps: DataMaps) -> str:
    """Return the report of a recording whose object is not known, as HTML."""
    names = maps.quantity, f"differences of {maps.of}"
    figure = figures.draw_setup(maps.data, maps.differences, content["recording"], maps.quantity, names)
    return render_diagnosis("diagnosis_of_data", content, maps=picture(figure))


def residual_maps(diagnosis: Diagnosis) -> tuple[np.ndarray, np.ndarray]:
    """Return maps of the standardized held-out residuals, with the baseline and the chosen model, (down, across)."""
    halves = diagnosis.halves
    return tuple(_residual_map(trial.fit, diagnosis.prepared) for trial in (halves.baseline, halves.chosen))


def _data_maps(diagnosis: Diagnosis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return maps of the held-out data and of their residuals before and after, in the unit of the recording.

    If every second view was held out, the other views are dropped. Pixels without data are NaN.
    """
    prepared, halves = diagnosis.prepared, diagnosis.halves
    usable, maps = prepared.held_out.usable, []
    differences = (prepared.difference(trial.fit, held_out=True) for trial in (halves.baseline, halves.chosen))
    for values in (prepared.recorded(held_out=True), *differences):
        whole = np.zeros(usable.shape)
        whole[usable] = values
        counts = usable.sum(axis=prepared.display.summed)
        mean = np.where(counts > 0, whole.sum(axis=prepared.display.summed) / np.maximum(counts, 1), np.nan)
        held_out = (counts > 0).any(axis=1)
        halves = [mean[first::2] for first in (0, 1) if not held_out[1 - first :: 2].any()]
        maps.append(halves[0] if halves else mean)
    return tuple(maps)


def _residual_map(fit: Fit, prepared: Prepared) -> np.ndarray:
    """Return weighted means of the standardized residual over one axis and over blocks of rays or voxels."""
    fitter = prepared.fitter
    shape = prepared.held_out.mean.shape
    residual, weight = (part[0].reshape(shape) for part in (fitter.residuals(fit, held_out=True), fitter.held_weights))
    summed = prepared.display.summed
    sums, weights = (residual * weight).sum(axis=summed), weight.sum(axis=summed)
    for axis in (0, 1):
        edges = np.arange(0, sums.shape[axis], _block(sums.shape[axis]))
        sums, weights = (np.add.reduceat(part, edges, axis) for part in (sums, weights))
    return sums / np.sqrt(np.where(weights > 0, weights, np.inf))


def _block(places: int) -> int:
    """Return how many entries of an axis with `places` entries one pixel of the map covers."""
    return -(-places // PIXELS_ACROSS)


def _steps(prepared: Prepared) -> tuple[int, int]:
    """Return how many entries of the recording (views, rows, columns or voxels) a map pixel covers, down and across."""
    down, across = (n for axis, n in enumerate(prepared.held_out.mean.shape) if axis != prepared.display.summed)
    return prepared.step * _block(down), _block(across)


def _profiles(diagnosis: Diagnosis) -> list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """Return the panels of profiles: name of the axis, positions, residuals before and after."""
    panels, prepared = [], diagnosis.prepared
    for domain, label, first in prepared.display.profiles:
        step = prepared.step if domain == STEPPED else 1
        before, after = (
            next(location for location in side if location.domain == domain).map
            for side in (diagnosis.before, diagnosis.after)
        )
        panels.append((label, step * np.arange(before.size) + first, before, after))
    return panels
