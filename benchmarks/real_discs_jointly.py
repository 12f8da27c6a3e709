"""Fit the shared physics of real discs jointly and predict each disc from the others (10 to 20 minutes).

The folder RECORDINGS holds sinograms of the Helsinki Tomography Challenge 2022, imported as in
docs/validation/real-discs.md. Prints Markdown tables: the prediction of each disc, the parameters from two disjoint
halves of the discs, and the residuals on smooth parts. Discs of --test-recordings are for testing only.
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.real_discs import prepared
from virtual_phantom.diagnosis.fitting.fit import Fit
from virtual_phantom.diagnosis.fitting.joint_fit import JointFitter
from virtual_phantom.diagnosis.residuals.dataset import Prepared
from virtual_phantom.diagnosis.scanner.scanner import run_scanner_diagnosis
from virtual_phantom.io.schema import defaults_of

SMOOTH = 0.9  # share of rays that are not at edges
BEHIND = 1.0  # smallest line integral inside the disc


def smooth_left(one: Prepared, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Recorded less modeled, and the noise's variance, of data held out where lines are smooth; NaN elsewhere.

    Returns
    -------
    left, noise : ndarray, shape (views, columns)
    """
    data = one.fitter.held_out
    lines = one.fitter.predicted(fit, held_out=True).mean[:, 0]
    slopes = np.abs(np.gradient(lines, axis=1))
    there = data.usable[:, 0] & (slopes < np.quantile(slopes, SMOOTH)) & (lines > BEHIND)
    left = one.fitter.residuals(fit, held_out=True)[0].reshape(data.mean.shape)[:, 0]
    return np.where(there, left, np.nan), np.where(there, one.variance[:, 0], np.nan)


def constants(left: np.ndarray) -> np.ndarray:
    """Mean per column; NaN if fewer than half of the views have it. Shape (columns,)."""
    counts = np.isfinite(left).sum(axis=0)
    return np.where(counts > counts.max() / 2, np.nansum(left, axis=0) / np.maximum(counts, 1), np.nan)


def print_left(discs: Mapping[str, Prepared], fits: Mapping[str, Fit]) -> None:
    """Print the excess variance on smooth parts and its share that is constant per column or view."""
    print("\n| smooth parts | variance over noise | of the rest, columns' constants | views' constants |")
    print("|---|---|---|---|")
    columns = {}
    for name, one in discs.items():
        left, noise = smooth_left(one, fits[name])
        columns[name] = constants(left)
        rest = np.nansum(left**2) - np.nansum(noise)
        shares = []
        for axis in (0, 1):  # squared means minus their noise
            counts = np.isfinite(left).sum(axis=axis)
            sums, noises = np.nansum(left, axis=axis), np.nansum(noise, axis=axis)
            shares.append(((sums**2 - noises)[counts > 0] / counts[counts > 0]).sum() / rest)
        ratio = np.nansum(left**2) / np.nansum(noise)
        print(f"| {name} | {ratio:.2f} | {100 * shares[0]:.0f} % | {100 * shares[1]:.0f} % |")
    differences = []
    names = list(columns)
    for place, name in enumerate(names):
        for other in names[place + 1 :]:
            both = np.isfinite(columns[name]) & np.isfinite(columns[other])
            differences.append(np.corrcoef(columns[name][both], columns[other][both])[0, 1])
    low, middle, high = np.quantile(differences, [0.1, 0.5, 0.9])
    print(f"\nColumns' constants of two discs correlate by {middle:.2f} (median; 10 to 90 %: {low:.2f} to {high:.2f}).")


def print_halves(discs: Mapping[str, Prepared], effects: Sequence[str]) -> None:
    """Print the shared parameters of two disjoint halves of the discs."""
    names = list(discs)
    halves = [
        JointFitter({name: discs[name].fitter for name in names[first::2]}).fit(tuple(effects)) for first in (0, 1)
    ]
    print("\n| parameter | one half of the discs | the other half | difference, noise SDs |\n|---|---|---|---|")
    for effect in effects:
        for key in halves[0].errors[effect]:
            (one, other), errors = (
                (half.physics[effect][key] for half in halves),
                [half.errors[effect][key] for half in halves],
            )
            agreement = abs(one - other) / np.hypot(*errors)
            print(
                f"| {key} of {effect} | {one:.4g} ± {errors[0]:.2g} | {other:.4g} ± {errors[1]:.2g} | {agreement:.1f} |"
            )


def add_arguments(parser):
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--view-step", type=int, default=48, help="distance of the views that are fitted or held out")
    parser.add_argument("--test-recordings", nargs="+", default=[], help="discs for testing only")
    parser.add_argument("--effects", nargs="+", default=["spectrum", "dark_signal", "veiling_glare", "scatter"])


def run(options):
    began = time.perf_counter()
    names = sorted(path.name for path in options.recordings.iterdir() if path.is_dir())
    discs = {name: prepared(options.recordings, name, options.view_step) for name in names}
    accuracy = defaults_of("diagnosis", "model_accuracy")
    found = run_scanner_diagnosis("bench", discs, options.effects, accuracy, test_recordings=options.test_recordings)
    print(found.content["sentence"], "\n")
    for effect in found.content["effects"]:
        numbers = (f"{key} {one['value']:.4g} {one['ci95']}" for key, one in effect["parameters"].items())
        print(f"* {effect['name']}: {'; '.join(numbers)}")
    print("\n| disc | before | with the physics of the others | noise | removed | beside the others | of its own |")
    print("|---|---|---|---|---|---|---|")
    for name, one in found.content["recordings"].items():
        rms = one["rms_line_integral"]
        own_parameters = "; ".join(
            f"{key} {value:.2g}" for values in one["own"].values() for key, value in values.items()
        )
        share, agreement = f"{100 * one['excess_rms_removed']:.1f} %", one["agreement"]
        note = f"chi-square {agreement['chi_square']:.0f} of {agreement['numbers']} numbers" if agreement else ""
        each = f"{rms['before']:.4f} | {rms['after']:.4f} | {rms['floor']:.4f} | {share}"
        print(f"| {name}{' (judges only)' if one['judged'] else ''} | {each} | {note} | {own_parameters} |")
    discs = {name: discs[name] for name in found.choice.left_out}
    print_left(discs, found.choice.left_out)
    if effects := found.choice.chosen.effects:
        print_halves(discs, effects)
    print(f"\n{(time.perf_counter() - began) / 60:.1f} min")
