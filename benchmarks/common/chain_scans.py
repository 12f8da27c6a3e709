"""Scans that the library's own chain simulates, of a small body, and effects of a given signal-to-noise ratio."""

import copy
import math
from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.optimize import brentq

from benchmarks.common import circular_scan
from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.fitting.linearization import BASE
from virtual_phantom.diagnosis.fitting.templates import strength, varied
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.discretization import model_and_floor
from virtual_phantom.io.volumes import Volume
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.effect import acts_on_images, load, names
from virtual_phantom.physics.scenes.scene import IN_PLACE, VoxelScene
from virtual_phantom.physics.scenes.shapes import ShapesScene, cylinder, ellipsoid

PHOTONS, REPEATS = 1e5, 4
LIBRARY = [name for name in names() if not acts_on_images(name)]  # effects on projections
WEAKEST, STRONGEST = 5.0, 50.0
FAINTEST, LEAST_SHARE = 1e-3, 1e-5  # lower limits of the signal-to-noise ratio and of the share of a range
EDGE_MM = 2.0
INSERTS = {"bone": ((50, 10, 5), 20.0), "adipose": ((-40, -20, -5), 18.0)}  # center and radius, mm
ROD = ((-10, 45, 0), 12.0)
GEOMETRY = circular_scan(90, 64, 8, 8.0, view_interval_ms=10.0)


def scene(edge_mm=EDGE_MM):
    """Elliptic body with off-axis bone, fat and dense inserts; edges blurred by a Gaussian."""
    grid = Grid((48, 192, 192), (1.5, 1.5, 1.5))  # a third of a pixel at the isocenter
    z, y, x = np.meshgrid(*grid.axes_mm(), indexing="ij")
    hu = np.where((x / 110) ** 2 + (y / 80) ** 2 < 1, 20.0, -1000.0)
    hu = np.where((x - 50) ** 2 + (y - 10) ** 2 + (z - 5) ** 2 < 20**2, 800.0, hu)
    hu = np.where((x + 40) ** 2 + (y + 20) ** 2 + (z + 5) ** 2 < 18**2, -80.0, hu)
    hu = np.where((x + 10) ** 2 + (y - 45) ** 2 < 12**2, 300.0, hu)
    hu = ndimage.gaussian_filter(hu, np.array(edge_mm) / grid.spacing, mode="nearest")
    return VoxelScene.of(Volume(hu.astype(np.float32), grid), Segmentation(), 0.0193, 1)


def body(**changes):
    """Body of shapes with muscle, bone, fat and a PMMA rod; `changes` replaces inserts (None removes one)."""
    inserts = {name: ellipsoid(name, at, [radius] * 3) for name, (at, radius) in INSERTS.items()} | changes
    muscle = ellipsoid("soft_tissue", (0, 0, 0), (110, 80, 1000))
    return [muscle, *(insert for insert in inserts.values() if insert is not None), cylinder("pmma", *ROD)]


def shapes_scene():
    return ShapesScene(body())


def scans(chain, physics, random, pose=IN_PLACE, repeats=REPEATS):
    state = chain.state(physics, pose)
    air = state.measured_air
    lines = [-np.log(np.maximum(state.counts(random), 0.5) / (air * state.photons)) for _ in range(repeats)]
    white = air.mean(axis=0) * state.photons
    return observed.Scans(np.stack(lines).astype(np.float32), white, np.ones(lines[0].shape, bool))


def strengths(name, target_snr, random, prepared_data):
    """Parameters of an effect with a signal-to-noise ratio of `target_snr`, or the largest that its range allows."""
    effect = load(name)
    every = prepared_data.fitter.model.parameters(name)
    typical = prepared_data.fitter.model.chain.fixed_parameters(name) | {
        parameter.name: parameter.typical for parameter in every
    }
    parameters = varied(every)
    if effect.pattern:
        pixels = math.prod(prepared_data.data.mean.shape[1:])
        noise = np.sqrt(1 / prepared_data.fitter.weights[0].reshape(prepared_data.data.mean.shape).sum(axis=0)).mean()
        return typical | {"rms": float(noise * np.sqrt(target_snr * np.sqrt(2 / pixels)))}
    if not parameters:
        return {
            parameter.name: float(random.uniform(low, high))
            for parameter, (low, high) in zip(effect.parameters, ((80.0, 140.0), (3.0, 12.0), (0.3, 1.2)), strict=True)
        }
    for which in random.permutation(np.array(parameters, object)):
        rest = typical | {other.name: other.neutral for other in parameters}
        most = which.high if strength(which) > which.neutral else which.low

        def beyond(logarithm, rest=rest, which=which, most=most):
            """Logarithm of the ratio of actual and wanted signal-to-noise ratio; nearly linear."""
            value = which.neutral + np.exp(logarithm) * (most - which.neutral)
            snr = signal_to_noise(prepared_data, {name: rest | {which.name: value}})
            return np.log(max(snr, FAINTEST) / target_snr)

        reached = beyond(0.0)
        if reached >= np.log(WEAKEST / target_snr):
            share = np.exp(brentq(beyond, np.log(LEAST_SHARE), 0.0, xtol=0.03)) if reached > 0 else 1.0
            return rest | {which.name: float(which.neutral + share * (most - which.neutral))}
    raise ValueError(f"{name}: the signal-to-noise ratio stays below {WEAKEST} within its range")


def signal_to_noise(prepared_data, physics):
    """Signal-to-noise ratio of physics beyond the alignment, from a fit of the alignment to noise-free data."""
    fitter = prepared_data.fitter
    place = {one.name: one.expected for one in fitter.model.base_nuisances}
    there = fitter.model.predict(physics, place, fitter.data, BASE)
    noise = {"variance": np.exp(there.log_variance), "correlation": there.correlation}
    clean = copy.copy(fitter)
    clean.data = replace(fitter.data, mean=there.mean, white=there.white, **noise)
    return float(np.sqrt(sum(clean.fit(()).parts)))


def scaled(chain, name, share):
    """Parameters of an effect at a share of its typical strength; those without a neutral value are typical."""
    return {
        parameter.name: parameter.typical
        if parameter.neutral is None
        else parameter.neutral + share * (parameter.typical - parameter.neutral)
        for parameter in chain.parameters(name)
    }


def prepared_with_floor(taken, scene, geometry, samples, **options):
    """Prepare a scan for fits, with the model's numerical error."""
    model, floor = model_and_floor(scene, geometry, samples, photons=PHOTONS)
    return prepared.prepare(taken, None, model, floor_chain=floor, nominal_photons=PHOTONS, **options)
