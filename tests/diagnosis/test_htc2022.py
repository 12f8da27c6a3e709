"""Physics from the solid disc of the Helsinki challenge, validated on a disc with holes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from virtual_phantom.diagnosis.fitting.fit import Fitter
from virtual_phantom.diagnosis.fitting.nuisance import nuisances
from virtual_phantom.diagnosis.fitting.trial import trial
from virtual_phantom.diagnosis.projections.model import ScansModel
from virtual_phantom.diagnosis.projections.observed import observe, scans
from virtual_phantom.diagnosis.scanned_object import mask_scene
from virtual_phantom.diagnosis.selection.transfer import Physics, fit_with_fixed_physics
from virtual_phantom.diagnosis.verdict.verdict import excess_rms_removed
from virtual_phantom.physics.beam.spectra import Anode
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.state import AIR
from virtual_phantom.recordings.importers.htc2022 import OBJECT, import_htc2022

REAL = Path(__file__).resolve().parents[2] / "../shared/real/htc2022"
pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL.exists(), reason="the real measurements are not beside this checkout"),
]
# docs/validation/real-discs.md
PHOTONS = 36000.0  # per pixel in air, from differences of neighboring views
EVERY = 36  # of the views; half of these are held out
FOUND = {
    "spectrum": {"kvp": 40.0, "filtration_mm": 2.357, "sensor_mm": 0.6},
    "dark_signal": {"level_units": 0.0503, "drift_units_per_s": 0.0049 / (721 * 1.2)},  # of air; 1.2 s per view
}
DENSITY = (0.964, 0.011)


def test_physics_of_the_solid_disc_predicts_a_disc_with_holes(tmp_path):
    name = "htc2022_ta_full"
    recording = import_htc2022(REAL / f"{name}.mat", tmp_path / "ta", segmentation=REAL / f"{name}_recon_fbp_seg.mat")
    geometry, taken, selected = recording.geometry, scans(recording.repeats), slice(0, 720, EVERY)
    geometry = geometry.every(EVERY)  # the last view repeats the first one
    geometry = replace(
        geometry,
        angles_rad=geometry.angles_rad[:-1],
        source_z_mm=geometry.source_z_mm[:-1],
        view_times=geometry.view_times[:-1],
    )
    taken = replace(taken, repeats=taken.repeats[:, selected], usable=taken.usable[selected])
    chain = Chain(PosedScene(mask_scene(tmp_path / "ta" / OBJECT, "pmma")), geometry, readout=AIR)
    variance = np.exp(taken.repeats[0].astype(float)) / PHOTONS
    odd = (np.arange(geometry.views) % 2 == 1)[:, None, None]
    data, held_out = (observe(replace(taken, usable=taken.usable & part), variance) for part in (~odd, odd))
    aligned = nuisances(np.log(PHOTONS), 0.02, {"scale": 1.0, "size": 0.01, "offset": 0.02})
    fitter = Fitter(
        ScansModel(chain, aligned, anode=Anode("Mo"), tube_kvp=45.0), data, held_out, variance, np.zeros_like(variance)
    )
    errors = {effect: dict.fromkeys(values, 0.0) for effect, values in FOUND.items()}
    units = {effect: {} for effect in FOUND}
    baseline = trial(fitter, ())
    choice = fit_with_fixed_physics(
        fitter, baseline, Physics("solid_disc", FOUND, errors, units, DENSITY, ()), same_material=True
    )
    used = fitter.held_weights[0] > 0
    before, after = (
        float(np.sqrt((fitter.residuals(one.fit, held_out=True)[0][used] ** 2).mean()))
        for one in (baseline, choice.chosen)
    )
    floor = float(np.sqrt(variance.ravel()[used].mean()))
    assert before > 5 * floor
    assert excess_rms_removed(before, after, floor) > 0.6
    # Both are necessary: the beam is polychromatic, and the signal has an additive part.
    assert min(choice.gains["spectrum"], choice.gains["dark_signal"]) > 1000
