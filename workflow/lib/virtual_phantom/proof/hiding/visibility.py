"""Signal-to-noise ratio of hidden effects: how well an ideal observer sees them in a scan.

The observer knows the change of the scan by the effect, but of the errors of the object, its pose and the dose only the
distributions [1]_.

References
----------
.. [1] H. H. Barrett, J. Opt. Soc. Am. A 7, 1266, 1990.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...base.geometry import OrbitGeometry
from ...base.proof_settings import ProofSettings
from ...base.streams import Stream
from ...physics.scenes.shapes import ShapesScene, ellipsoid
from ...recordings.scan import scan_geometry
from .generate import ATTENUATION, ENERGY_OF_WATER, acquire, hidden_settings, scan_of
from .imperfections import DOSE_SD, HEIGHT_MM, HU_ERROR, SHAPE_MM, SHIFT_MM, TURN_DEG
from .materials import Attenuation
from .objects import ScannedObject, imperfect
from .suite import World, scan_seed
from .xcist import Acquired, Scan

DIVIDED = (1, 4)  # rays per pixel along rows and columns
STEP_MM, STEP_DEG = 0.1, 0.1  # for derivatives by shape and pose
# Standard deviations of the uniform distributions from which the errors are drawn.
HU_SD, SHAPE_SD = HU_ERROR / 3**0.5, (sum(side**2 for side in SHAPE_MM) / 2) ** 0.5
POSE = {
    "x_mm": (STEP_MM, SHIFT_MM / 3**0.5),
    "y_mm": (STEP_MM, SHIFT_MM / 3**0.5),
    "z_mm": (STEP_MM, HEIGHT_MM / 3**0.5),
    "turn_deg": (STEP_DEG, TURN_DEG / 3**0.5),
}


@dataclass(frozen=True)
class Expected:
    """Mean and variance of the line integrals of one scan, shape (views, rows, columns)."""

    lines: np.ndarray
    variance: np.ndarray


def snr(truth: Mapping, settings: ProofSettings, mu_water_per_mm: float) -> dict[str, float]:
    """Return {hidden effect: signal-to-noise ratio} in all repeats of a scan, beside the other hidden effects.

    The signal is the change of mean and variance of the line integrals. Changes of the white field and of the
    correlation of noise are not included.

    Parameters
    ----------
    truth : mapping
        Truth of a case of projections.
    """
    world, wanted = World.of(truth), settings.scan
    stated, kev = world.stated(settings.seed), ENERGY_OF_WATER[world.simulator](mu_water_per_mm)
    orbit, seed = world.orbits(settings)[0], scan_seed(settings.seed, world.number).spawn(2)[0]

    def expected(effects: list) -> Expected:
        hidden = hidden_settings(truth | {"effects": effects})
        scan = scan_of(orbit, wanted.photons, wanted.rotation_time_ms, kev, hidden)
        return _expected(world.simulator, scan, stated, truth["imperfections"], mu_water_per_mm, seed)

    hidden = truth["effects"]
    with_all = expected(hidden)
    without = {one["name"]: expected([other for other in hidden if other is not one]) for one in hidden}
    changes = {name: _change(with_all, one) for name, one in without.items()}
    geometry = scan_geometry(orbit.recorded(wanted.rotation_time_ms), truth["case"])
    attenuation = ATTENUATION[world.simulator](kev)
    errors = _errors(stated, truth["imperfections"], geometry, attenuation, mu_water_per_mm)
    found = {}
    for name, one in without.items():
        # The mean of the repeats, and the logarithm of their sample variance, which has a variance of 2 / (n - 1).
        weight = np.concatenate(
            [wanted.repeats / one.variance.ravel(), np.full(one.variance.size, (wanted.repeats - 1) / 2)]
        )
        others = [change for other, change in changes.items() if other != name]
        found[name] = _beside(changes[name], [*errors, *others], weight)
    return found


def _expected(
    simulator: str, scan: Scan, stated: ScannedObject, errors: Mapping, mu_water_per_mm: float, seed: Stream
) -> Expected:
    taken = acquire(simulator, scan, stated, errors, mu_water_per_mm, 0, seed)
    lines = -np.log(taken.readings[0].astype(float) / taken.air)
    quanta = scan.photons * scan.settings.get("flux_factor", 1.0) * _relative(taken, scan)
    return Expected(lines, 1 / quanta + (scan.settings.get("electronic_photons", 0.0) / quanta) ** 2)


def _relative(taken: Acquired, scan: Scan) -> np.ndarray:
    """Return readings relative to air in the center of the detector, at the tube current of each view."""
    middle = [slice((n - 1) // 2, n // 2 + 1) for n in (scan.rows, scan.columns)]
    current = 1.0 if taken.current is None else taken.current[:, None, None]
    return taken.readings[0].astype(float) / taken.air[tuple(middle)].mean() * current


def _change(one: Expected, other: Expected) -> np.ndarray:
    """Return the change of mean and logarithm of the variance, shape (2 * rays,)."""
    return np.concatenate([(one.lines - other.lines).ravel(), np.log(one.variance / other.variance).ravel()])


def _errors(
    stated: ScannedObject, errors: Mapping, geometry: OrbitGeometry, attenuation: Attenuation, mu_water_per_mm: float
) -> list[np.ndarray]:
    """Return the changes, shape (2 * rays,), by one standard deviation of each error of object, pose and dose."""

    def lines(changed: Mapping) -> np.ndarray:
        return _lines(imperfect(stated, changed, attenuation, mu_water_per_mm), geometry, attenuation, mu_water_per_mm)

    def by(kind: str, name: str, step: float, sd: float) -> np.ndarray:
        low, high = (
            lines(errors | {kind: errors[kind] | {name: errors[kind].get(name, 0.0) + side}}) for side in (-step, step)
        )
        return (high - low) * (sd / (2 * step))

    names = [part.name for part in stated.parts]
    found = [by("object", name, HU_SD, HU_SD) for name in names]
    found += [by("shape_mm", name, STEP_MM, SHAPE_SD) for name in names]
    found += [by("pose", name, step, sd) for name, (step, sd) in POSE.items()]
    rays = found[0].size
    dose = np.concatenate([np.zeros(rays), np.full(rays, DOSE_SD)])
    return [*(np.concatenate([one.ravel(), np.zeros(rays)]) for one in found), dose]


def _lines(
    scanned: ScannedObject, geometry: OrbitGeometry, attenuation: Attenuation, mu_water_per_mm: float
) -> np.ndarray:
    """Return the line integrals of the monochromatic beam through an object without its hidden changes."""
    rows, columns = DIVIDED
    shapes = [
        ellipsoid(str(number), part.centre_mm, part.semi_axes_mm, part.turn_deg)
        for number, part in enumerate(scanned.parts)
    ]
    each = [part.attenuation_per_mm(attenuation, mu_water_per_mm) for part in scanned.parts]
    lengths = ShapesScene(shapes).path_lengths(geometry.divided(rows, columns)).astype(float)
    passed = np.exp(-np.tensordot(each, lengths, 1))
    views, shape = len(passed), (geometry.rows, rows, geometry.columns, columns)
    return -np.log(passed.reshape(views, *shape).mean(axis=(2, 4)))


def _beside(change: np.ndarray, errors: list[np.ndarray], weight: np.ndarray) -> float:
    """Return the signal-to-noise ratio of a change with weights 1 / variance beside errors of one standard deviation.

    It is the square root of s'(W^-1 + E E')^-1 s for a signal s and errors E.
    """
    root = np.sqrt(weight)
    signal, columns = root * change, (root * np.stack(errors)).T
    along = columns.T @ signal
    taken = np.linalg.solve(np.eye(columns.shape[1]) + columns.T @ columns, along)
    return float(np.sqrt(max(0.0, signal @ signal - along @ taken)))
