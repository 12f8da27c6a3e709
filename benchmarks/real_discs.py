"""Compare sets of effects on three real discs: fit one disc, test on the others (10 minutes).

The folder RECORDINGS holds solid_disc, ta and tb, imported as in docs/validation/real-discs.md. Prints a Markdown table
with the RMS of held-out line integrals and the share of the excess over noise that each set removes.
"""

from pathlib import Path

from virtual_phantom.diagnosis.fitting.trial import Trial, trial
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection.forward_selection import Choice
from virtual_phantom.diagnosis.selection.transfer import Physics, fit_with_fixed_physics
from virtual_phantom.diagnosis.settings import Disc, MaskedObject, RecordingSettings
from virtual_phantom.diagnosis.verdict.verdict import excess_rms_removed, metrics_of
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.physics.beam.materials import Segmentation

ALIGNMENT = {"scale": 1.0, "size": 0.01, "offset": 0.02}  # as in config/htc2022.yaml
SETS = (("spectrum", "dark_signal"), ("spectrum", "veiling_glare"), ("spectrum", "scatter"), ("scatter",))


def prepared(folder: Path, name: str, view_step: int):
    """Disc prepared with the settings of config/htc2022.yaml."""
    scanned = {"disc": Disc(70, "pmma")}
    if name != "solid_disc":
        scanned = {"object": MaskedObject(str(folder / name / "object.nii.gz"), "pmma")}
    settings = RecordingSettings(1, view_step, ALIGNMENT, **scanned)
    diagnosis_request = DiagnosisRequest(folder / name, settings, defaults_of()["mu_water_per_mm"], Segmentation())
    return prepare_recording(diagnosis_request)[1]


def left(one, baseline: Trial, chosen: Trial) -> str:
    """RMS after the fit, and the share of the excess that it removes."""
    choice = Choice(baseline, chosen)
    rms = metrics_of(one, choice, held_out=True)["rms_line_integral"]
    return f"{rms['after']:.4f} ({100 * excess_rms_removed(**rms):.0f} %)"


def add_arguments(parser):
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--view-step", type=int, default=5, help="distance of the views that are fitted or held out")


def run(options):
    discs = {name: prepared(options.recordings, name, options.view_step) for name in ("solid_disc", "ta", "tb")}
    baselines = {name: trial(one.fitter, ()) for name, one in discs.items()}
    print("| effects | solid disc | ta, physics of the solid disc | tb | ta, fitted to it |")
    print("|---|---|---|---|---|", flush=True)
    for effects in SETS:
        found = {name: trial(discs[name].fitter, effects, baselines[name]) for name in ("solid_disc", "ta")}
        fit = found["solid_disc"].fit
        density = (fit.nuisance["scale"], fit.nuisance_errors["scale"]) if "spectrum" in effects else None
        units = {name: {} for name in effects}
        physics = Physics("solid_disc", fit.physics, fit.errors, units, density, ())
        row = [left(discs["solid_disc"], baselines["solid_disc"], found["solid_disc"])]
        for name in ("ta", "tb"):
            chosen = fit_with_fixed_physics(discs[name].fitter, baselines[name], physics, same_material=True).chosen
            row.append(left(discs[name], baselines[name], chosen))
        row.append(left(discs["ta"], baselines["ta"], found["ta"]))
        print(f"| {', '.join(effects).replace('_', ' ')} | {' | '.join(row)} |", flush=True)
