"""Write the figures and the table of docs/explanation/theory.md: templates of effects and their correlations."""

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas
import yaml
from matplotlib.figure import Figure
from scipy.cluster import hierarchy
from scipy.optimize import lsq_linear
from scipy.spatial.distance import squareform

from virtual_phantom.base.geometry import grid_of, scan_geometry
from virtual_phantom.config import config
from virtual_phantom.diagnosis.fitting.fit import Fit, Fitter
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.templates import (
    SMALL,
    data_changes,
    projected,
    strength,
    templates,
    varied,
    whitened,
    with_priors,
)
from virtual_phantom.diagnosis.projections.model import Model
from virtual_phantom.diagnosis.projections.observed import scans
from virtual_phantom.diagnosis.projections.prepared import Prepared, prepare
from virtual_phantom.figures import style
from virtual_phantom.figures.style import label, number, save
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import acts_on_images, applicable_effects, load, names
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.recordings.projections import Projections

ROOT = Path(__file__).resolve().parents[2]

TABLE, IMAGES = ROOT / "docs" / "explanation" / "effect_templates.csv", ROOT / "docs" / "images"
VIEWS, REPEATS = 90, 10
DETECTOR = {"columns": 80, "rows": 24, "column_pitch_mm": 8.0, "row_pitch_mm": 8.0}
# Rays per pixel and direction: with few, a blur of less than a pixel is lost between them.
SAMPLES = 6
PHANTOM_STREAM, NOISE_STREAM = 0, 3
SHOWN_SD = 5.0
FEW = (  # parts of few numbers: what they are, and how each is called
    ("noise correlation", "neighbouring", ("columns", "rows", "views")),
    ("white field", "order", ("c1", "c2", "c3", "c4", "r1", "r2")),
)
ACROSS, PANEL_MM, TITLE_MM = 4, 30.0, 8.0
MOST_SHOWN = 99.5  # percentile of |values| with the full color: single pixels at edges would hide the others


@dataclass(frozen=True)
class Template:
    """First-order change that one parameter of an effect makes at typical strength.

    Attributes
    ----------
    parameter : str or None
        None if the effect has no parameter with a neutral value.
    change : ndarray, shape (data,)
        Change of the whitened data; its length is in standard deviations.
    left : ndarray, shape (data + parameters,)
        Part of the change that the fit does not absorb to first order. After the data, there is one entry per prior.
    """

    effect: str
    parameter: str | None
    change: np.ndarray
    left: np.ndarray

    @property
    def absorbed(self) -> float:
        """Absorbed share of the squared length; NaN for an effect without a change."""
        square = float(self.change @ self.change)
        return 1 - float(self.left @ self.left) / square if square else float("nan")


def templates_of_effects(fitter: Fitter, fit: Fit, names: Sequence[str]) -> list[Template]:
    """Return the templates of effects at a fit; a gain pattern has the template of one random realization."""
    problem, found = Problem.at(fitter, fit), []
    basis = np.linalg.qr(with_priors(data_changes(problem), problem))[0]
    for name in names:
        if load(name).pattern:
            labels, rows = [None], _gain_pattern_template(fitter, fit, name)[None]
        else:
            labels = [parameter.name for parameter in varied(fitter.model.parameters(name))] or [None]
            rows = templates(fitter, fit, name)
        left = projected(rows, basis)
        found += [Template(name, *row) for row in zip(labels, rows, left, strict=True)]
    return found


def _gain_pattern_template(fitter: Fitter, fit: Fit, name: str) -> np.ndarray:
    """Return the template of a gain pattern of typical strength, computed by the chain: predictions have no pattern."""
    effect, data = load(name), fitter.data
    photons = float(np.exp(fit.nuisance["log_photons"]))
    without, with_it = (
        fitter.model.chain.state(physics, photons=photons, anode=fitter.model.anode).line_integrals()
        for physics in (fit.physics, fit.physics | {name: effect.values({})})
    )
    mean = data.whitened(with_it - without).ravel()
    rest = data.residuals(fitter.predicted(fit))[1:]
    return whitened([mean, *(np.zeros_like(part) for part in rest)], fitter.weights)


def split(fitter: Fitter, row: np.ndarray) -> dict[str, np.ndarray]:
    """Split a whitened row by the parts of the data, without the entries for priors."""
    names = fitter.data.parts
    ends = np.cumsum([weight.size for weight in fitter.weights])
    return {name: row[end - w.size : end] for name, end, w in zip(names, ends, fitter.weights, strict=True)}


def shares_of_parts(fitter: Fitter, row: np.ndarray) -> dict[str, float]:
    """Return the share of a whitened row's squared length in every part of the data; NaN for a row of length 0."""
    squares = {name: float(part @ part) for name, part in split(fitter, row).items()}
    total = sum(squares.values())
    return {name: square / total if total else float("nan") for name, square in squares.items()}


def absorbed_in_range(fitter: Fitter, fit: Fit, rows: np.ndarray) -> np.ndarray:
    """Return the share of rows' squared lengths that a fit absorbs within its plausible ranges, shape (rows,).

    This is a bounded least-squares fit. Unlike a first-order projection, it depends on the strength of the effect.

    Parameters
    ----------
    rows : ndarray, shape (rows, data)
        Whitened.
    """
    problem = Problem.at(fitter, fit)
    basis, triangle = np.linalg.qr(with_priors(data_changes(problem), problem))
    scale = np.linalg.norm(triangle, axis=0)
    bounds = (problem.low - problem.start) * scale, (problem.high - problem.start) * scale
    found = []
    for row in rows:
        inside = basis[: row.size].T @ row
        solved = lsq_linear(triangle / scale, inside, bounds, method="bvls")
        found.append((inside @ inside - 2 * solved.cost) / (row @ row))
    return np.array(found)


def correlations(found: Sequence[Template]) -> np.ndarray:
    """Return cosines between the remaining parts of templates, shape (templates, templates).

    NaN for a template that is fully absorbed.
    """
    rows = np.stack([template.left for template in found])
    squares = (rows**2).sum(axis=1)
    whole = np.array([template.change @ template.change for template in found])
    length = np.sqrt(np.where(squares > SMALL * whole, squares, np.nan))
    return rows @ rows.T / np.outer(length, length)


def grouped(correlation: np.ndarray) -> list[int]:
    """Return an order of templates with similar ones adjacent: average linkage of 1 - |correlation|."""
    distance = 1 - np.abs(np.nan_to_num(correlation))
    np.fill_diagonal(distance, 0)
    near = squareform((distance + distance.T) / 2, checks=False)
    return hierarchy.leaves_list(hierarchy.linkage(near, "average", optimal_ordering=True)).tolist()


@dataclass(frozen=True)
class Panel:
    """Template of one effect in one part of the data.

    Attributes
    ----------
    values : ndarray, shape (views, x) or (x,)
        Values in standard deviations: a map, or bars if there are `names`.
    across : str
        Label of x, with the part of the data.
    names : tuple of str
        Names of the bars.
    """

    title: str
    values: np.ndarray
    across: str
    names: tuple[str, ...] = ()


@style.styled()
def draw_templates(panels: Sequence[Panel]) -> Figure:
    """Draw each template on its own scale. The number in the corner has the full color, or is the longest bar."""
    down = -(-len(panels) // ACROSS)
    figure = style.figure(style.DOUBLE_COLUMN_MM, TITLE_MM + PANEL_MM * down)
    axes = figure.subplots(down, ACROSS).ravel()
    for ax, panel in zip(axes, panels, strict=False):
        sizes = np.abs(panel.values)
        limit = float(sizes.max() if panel.names else np.percentile(sizes, MOST_SHOWN)) or 1.0
        if panel.names:
            ax.bar(panel.names, panel.values, 0.7, color=style.BLUE)
            ax.set_xlim(-0.5, len(panel.names) - 0.5)
            ax.axhline(0, color=style.GREY, linewidth=0.6)
            ax.margins(y=0.3)
            ax.tick_params(length=0)
        else:
            ax.imshow(panel.values, aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest")
            ax.set_xticks([])
        ax.set_yticks([])
        ax.set_title(panel.title, loc="left", fontsize=style.FONT_POINTS)
        ax.set_xlabel(panel.across, labelpad=2)
        ax.set_ylabel("SD" if panel.names else "view", labelpad=2)
        ax.text(
            0.97,
            0.95,
            style.number(limit) if panel.names else f"±{style.number(limit)}",
            transform=ax.transAxes,
            ha="right",
            va="top",
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    return figure


@style.styled()
def draw_correlations(correlation: np.ndarray, labels: Sequence[str]) -> Figure:
    """Draw a heat map of the correlations between templates.

    Parameters
    ----------
    correlation : ndarray, shape (templates, templates)
    """
    values = pandas.DataFrame(correlation, labels, labels)
    figure = style.figure(style.DOUBLE_COLUMN_MM, style.DOUBLE_COLUMN_MM * 1.08)
    axes = figure.subplots()
    image = style.heat_map(axes, values, cmap="RdBu_r", vmin=-1, vmax=1)
    text = "correlation of templates after projection of the alignment"
    figure.colorbar(image, ax=axes, location="top", label=text, shrink=0.6, aspect=40)
    return figure


def recording() -> Prepared:
    """Simulate repeats of the default scan without missing effects, with fewer views and larger pixels."""
    study = yaml.safe_load((ROOT / "config" / "paper_groups.yaml").read_text(encoding="utf-8"))
    study = config.read_study(study)
    grid = grid_of(study.grid)
    seed = np.random.SeedSequence(study.seed, spawn_key=(PHANTOM_STREAM,))
    shapes = layout.read_layout(study.phantom.layout)
    phantom = synthetic.build(shapes, grid, study.grid.oversampling, seed)
    scene = VoxelScene.of(phantom.fine, Segmentation(**vars(study.materials)), study.mu_water_per_mm)
    geometry = scan_geometry(replace(study.scan, **DETECTOR), VIEWS, grid)
    photons = 1 / study.noise.levels["dose10"].A
    chains = [Chain(scene, geometry, photons, SAMPLES + more) for more in (0, 1)]
    state = chains[0].state({})
    random = np.random.default_rng(np.random.SeedSequence(study.seed, spawn_key=(NOISE_STREAM,)))
    white = state.measured_air[0] * photons
    dark = np.zeros_like(white)
    taken = scans([Projections(state.counts(random), white, dark) for _ in range(REPEATS)])
    return prepare(taken, None, chains[0], nominal_photons=photons, floor_chain=chains[1])


def labels(found: list[Template]) -> list[str]:
    """Return the effect names, with the parameter if an effect has several templates."""
    counts = Counter(one.effect for one in found)
    return [
        label(one.effect) if counts[one.effect] == 1 else f"{label(one.effect)}: {_display_name(one)}" for one in found
    ]


def _display_name(template: Template) -> str:
    """Return the name of a template's parameter, without its unit."""
    (parameter,) = (one for one in load(template.effect).parameters if one.name == template.parameter)
    return parameter.display_name


def panels(prepared: Prepared, found: list[Template]) -> list[Panel]:
    """Return a panel of each template: mean or noise variance, whichever is larger, and the visible parts in FEW."""
    data, result = prepared.data, []
    shapes = {"mean": data.mean.shape, "noise variance": data.blocks.shape}
    for name, one in zip(labels(found), found, strict=True):
        parts = split(prepared.fitter, one.left)
        most = max(shapes, key=lambda part: parts[part] @ parts[part])
        across, values = summed(parts[most].reshape(shapes[most]))
        result.append(Panel(name, values, across if most == "mean" else f"{across}: {most}"))
        for part, axis, ticks in FEW:
            if np.linalg.norm(parts[part]) > SHOWN_SD:
                result.append(Panel(name, parts[part], f"{part}, {axis}", ticks))
    return result


def summed(values: np.ndarray) -> tuple[str, np.ndarray]:
    """Sum a template [view, row, column] over rows or columns, whichever keeps more, scaled to noise of 1 SD.

    Return the remaining axis and the map.
    """
    sums = {"column": values.sum(axis=1) / values.shape[1] ** 0.5, "row": values.sum(axis=2) / values.shape[2] ** 0.5}
    kept = max(sums, key=lambda name: (sums[name] ** 2).sum())
    return kept, sums[kept]


LEAST_SHOWN = 1e-3  # share of a template: less is rounding in a table of percent to one decimal


def percent(share: float) -> str:
    return "< 0.1" if share < LEAST_SHOWN else f"{100 * share:.1f}"


def shown(shares: dict[str, float]) -> str:
    """Return the parts of the data that contain a template, with percent if several, largest first."""
    parts = sorted((one for one in shares.items() if one[1] >= LEAST_SHOWN), key=lambda one: -one[1])
    return ", ".join(f"{part} {percent(share)}" for part, share in parts) if len(parts) > 1 else parts[0][0]


def table(prepared: Prepared, fit: Fit, found: list[Template]) -> list[list[str]]:
    """Return the header and one row for each template."""
    correlation = correlations(found)
    in_range = absorbed_in_range(prepared.fitter, fit, np.stack([one.change for one in found]))
    effects, called = np.array([one.effect for one in found]), labels(found)
    rows = [["effect", "strength", "shows in", "absorbed, %", "remaining, SD", "most similar", "rho"]]
    for place, one in enumerate(found):
        alike = np.where(effects == one.effect, 0, np.nan_to_num(correlation[place]))
        other = int(np.argmax(np.abs(alike)))
        first_order, within = percent(one.absorbed), percent(in_range[place])
        rows.append(
            [
                called[place],
                at(one, prepared.fitter.model),
                shown(shares_of_parts(prepared.fitter, one.change)),
                first_order if within == first_order else f"{first_order} ({within})",
                number(np.linalg.norm(one.left)),
                called[other],
                f"{alike[other]:.3f}",
            ]
        )
    return rows


def at(one: Template, model: Model) -> str:
    """Return the strength of a template with its unit."""
    parameters = [p for p in model.parameters(one.effect) if one.parameter in (None, p.name) and p.unit != "number"]
    values = [(strength(p) if p.neutral is not None else p.typical, p.unit) for p in parameters]
    return ", ".join(f"{value:.3g}" + ("" if unit == "1" else f" {unit}") for value, unit in values)


if __name__ == "__main__":
    prepared = recording()
    fit = prepared.fitter.fit(())
    alone = applicable_effects((name for name in names() if not acts_on_images(name)), ())
    found = templates_of_effects(prepared.fitter, fit, alone)
    save(draw_templates(panels(prepared, found)), [IMAGES / "effect_templates.png"])
    order = grouped(correlations(found))
    ordered = [found[place] for place in order]
    save(draw_correlations(correlations(ordered), labels(ordered)), [IMAGES / "effect_correlations.png"])
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(table(prepared, fit, found))
