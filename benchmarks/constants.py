"""Count verdicts that change if a constant of the diagnosis is halved or doubled (30 minutes).

The scans come from the simulator of the blind validation. A verdict changes if its kind or the set of named effects
changes. Constants of fits (--fits) need all fits again for each value. Cases in the output file are not repeated.
"""

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from benchmarks import common
from benchmarks.common import simulator_scans
from virtual_phantom.diagnosis import run as diagnosis_run
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.selection import forward_selection
from virtual_phantom.diagnosis.verdict import unmodeled

DIAGNOSIS = "virtual_phantom.diagnosis"
FACTORS = (0.5, 2.0)
# {module: constants of effect selection and verdict}.
OF_VERDICTS = {
    "selection.forward_selection": ("ALPHA", "LEAST_GAIN", "AS_GOOD", "RULED_OUT", "MOST_EFFECTS", "MOST_SWAPS"),
    "selection.screening": ("SCREEN", "FEW", "LEAST_SHARE", "NEAR_BEST"),
    "residuals.residual_tests": ("ALPHA", "EDGE_SHARE", "BINS"),
    "verdict.warnings": ("WELL_KNOWN", "MOST_CHI_SQUARE"),
    "verdict.verdict": ("LEFT_SD",),
    "verdict.object_mismatch": ("BEYOND",),
    "projections.residual_maps": ("THIN",),
}
OF_FITS = {  # and of priors
    "fitting.nuisance": ("PRIOR_BOUND_SD", "NOMINAL_PHOTONS_SD", "NUMERICAL"),
    "fitting.model": ("DENSITY_SD", "TUBE_KVP_SD"),
    "projections.discretization": ("LEFT", "MOST_STRAY"),
    "projections.prepared": ("SIZE_SD",),
}
ABOVE_ONE = ("MOST_CHI_SQUARE",)  # a ratio with the null value 1: the excess is scaled
STATED = "stated"  # key of the unchanged diagnosis


@dataclass(frozen=True)
class Constant:
    """A number of a module, or of `model_accuracy` if `module` is empty."""

    module: str
    name: str

    @property
    def label(self) -> str:
        return f"{self.module or 'model_accuracy'}.{self.name}"

    @contextmanager
    def times(self, factor: float, accuracy: dict[str, float]) -> Iterator[dict[str, float]]:
        """Scale the constant in all modules that import it; yields the accuracy to use."""
        if not self.module:
            yield accuracy | {self.name: accuracy[self.name] * factor}
            return
        home = import_module(f"{DIAGNOSIS}.{self.module}")
        stated = getattr(home, self.name)
        holders = [
            one
            for key, one in list(sys.modules.items())
            if key.startswith(DIAGNOSIS) and getattr(one, self.name, None) is stated
        ]
        for one in holders:
            setattr(one, self.name, scaled(stated, factor, self.name))
        try:
            yield accuracy
        finally:
            for one in holders:
                setattr(one, self.name, stated)


def constants_of(modules: dict[str, tuple[str, ...]]) -> list[Constant]:
    return [Constant(module, name) for module, names in modules.items() for name in names]


def scaled(value, factor: float, name: str = ""):
    """A constant times a factor: whole numbers stay whole, and a pair of mean and standard deviation keeps its mean."""
    if isinstance(value, dict):
        return {key: scaled(one, factor) for key, one in value.items()}
    if isinstance(value, tuple):
        return (value[0], value[1] * factor)
    if isinstance(value, int):
        return max(1, round(value * factor))
    return 1 + (value - 1) * factor if name in ABOVE_ONE else value * factor


class Remembered:
    """Cache of fits, matched filters and kinds of change of one recording."""

    def __init__(self):
        self._trials, self._others = {}, {}

    @staticmethod
    def _key(fit) -> str:
        return json.dumps([fit.effects, fit.physics, fit.nuisance])

    def _of(self, effects, *begun) -> tuple:
        return effects, *(None if one is None else self._key(one.fit) for one in begun)

    def get(self, effects, given=None, against=None):
        return self._trials.get(self._of(effects, given, against))

    def put(self, found, effects, given=None, against=None) -> None:
        self._trials[self._of(effects, given, against)] = found

    def once(self, function: Callable) -> Callable:
        """Cache a function of (prepared, fit, ...)."""

        def answered(one, fit, *rest, **settings):
            # The cache keeps `one` alive, so that its id stays unique.
            key = function.__name__, id(one), self._key(fit), repr(rest[:1])
            if key not in self._others:
                self._others[key] = one, function(one, fit, *rest, **settings)
            return self._others[key][1]

        return answered

    @contextmanager
    def of_everything(self) -> Iterator[None]:
        """Use the cache for matched filters and kinds of change."""
        screened, changes = forward_selection.screened, unmodeled.changes
        forward_selection.screened = diagnosis_run.screened = self.once(screened)
        unmodeled.changes = self.once(changes)
        try:
            yield
        finally:
            forward_selection.screened = diagnosis_run.screened = screened
            unmodeled.changes = changes


def kind_and_effects(
    diagnosis_request: DiagnosisRequest, tried: list[str], accuracy: dict[str, float], remembered: Remembered, made=None
) -> dict:
    """Kind of the verdict and ranked effects."""
    recording, prepared = made or prepare_recording(diagnosis_request)
    found = diagnosis_run.find_missing_physics(recording.name, prepared, tried, accuracy, cache=remembered)
    return {"verdict": found.content["verdict"], "effects": [effect["name"] for effect in found.content["effects"]]}


def answers(folder: Path, truth: dict, config: dict, seed: int, of_fits: bool) -> dict[str, dict]:
    """{changed constant: verdict}."""
    model = simulator_scans.recorded(folder, truth, config, seed)
    diagnosis_request, tried = (
        DiagnosisRequest.of(model, str(folder / "image.nii.gz"), 1),
        list(candidates(model.settings)),
    )
    accuracy, made, remembered = config.diagnosis.model_accuracy, prepare_recording(diagnosis_request), Remembered()
    found = {}
    with remembered.of_everything():
        found[STATED] = kind_and_effects(diagnosis_request, tried, accuracy, remembered, made)
        for one in [*(Constant("", name) for name in accuracy), *constants_of(OF_VERDICTS)]:
            for factor in FACTORS:
                with one.times(factor, accuracy) as taken:
                    found[f"{one.label} * {factor:g}"] = kind_and_effects(
                        diagnosis_request, tried, taken, remembered, made
                    )
    for one in constants_of(OF_FITS) if of_fits else []:
        for factor in FACTORS:
            fresh = Remembered()
            with one.times(factor, accuracy) as taken, fresh.of_everything():
                found[f"{one.label} * {factor:g}"] = kind_and_effects(diagnosis_request, tried, taken, fresh)
    return found


def changed(one: dict, stated: dict) -> bool:
    return one["verdict"] != stated["verdict"] or set(one["effects"]) != set(stated["effects"])


def counted(rows: list[dict]) -> None:
    """Print the number of changed verdicts per constant, largest first."""
    names = {key.rpartition(" * ")[0] for row in rows for key in row["answers"] if key != STATED}
    table = {}
    for name in names:
        by_factor = []
        for factor in FACTORS:
            key = f"{name} * {factor:g}"
            of = [row["answers"] for row in rows if key in row["answers"]]
            first = sum(one[key]["effects"][:1] != one[STATED]["effects"][:1] for one in of)
            by_factor.append((sum(changed(one[key], one[STATED]) for one in of), first, len(of)))
        table[name] = by_factor
    print(f"{'constant':40} halved: another verdict, another first effect; doubled; of")
    for name, (half, twice) in sorted(table.items(), key=lambda one: (-sum(part[0] for part in one[1]), one[0])):
        print(f"{name:40} {half[0]:3} {half[1]:3}   {twice[0]:3} {twice[1]:3}   {half[2]}")
    flips, of = (sum(part[place] for parts in table.values() for part in parts) for place in (0, 2))
    print(f"all: {flips} of {of} verdicts")


def add_arguments(parser):
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    simulator_scans.add_draws(parser, ["weak", "medium"], none=4, pairs=2, unknown=4)
    parser.add_argument("--fits", action="store_true", help="include constants of fits; each needs a full diagnosis")


def run(options):
    config = common.configuration()
    rows = common.read_jsonl(options.out)
    for case, truth in simulator_scans.left_to_do(options, rows).items():
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            found = answers(Path(folder), truth, config, options.seed, options.fits)
        rows.append({"truth": truth, "answers": found})
        common.append_jsonl(options.out, rows[-1])
        hidden = ", ".join(effect["name"] for effect in truth["effects"]) or "nothing"
        stated, others = found[STATED], [key for key in found if changed(found[key], found[STATED])]
        words = f"{stated['verdict']}, {', '.join(stated['effects']) or 'no effect'}"
        seconds = time.perf_counter() - began
        print(f"{case} {hidden}: {words}; changed by {', '.join(others) or 'none'} [{seconds:.0f} s]", flush=True)
    counted(rows)
