"""Scanner parameters do not depend on the scan: they are equal at another speed, dose or collimation.

The data are made without the chain: chords of a disc, Poisson counts, and afterglow in fine time steps.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gecatsim.pyfiles.Detection_Lag import Detection_Lag

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import circular
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.projections.model import ScansModel
from virtual_phantom.io.exchange import read_line_integrals, write_line_integrals
from virtual_phantom.physics.beam.materials import attenuation_per_mm
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import OF_AIR, acts_on_images, load, names, needs_times
from virtual_phantom.physics.effects.afterglow import of_views
from virtual_phantom.physics.noise.correlation import correlations
from virtual_phantom.physics.scenes.scene import DISC_ENERGY_KEV
from virtual_phantom.physics.scenes.shapes import DiscScene, ShapesScene, cylinder, ellipsoid
from virtual_phantom.physics.state import AIR, EARLIER_VIEWS, State, interpolate_views, with_afterglow
from virtual_phantom.physics.stored_state import read_state, to_store
from virtual_phantom.recordings.projections import Projections
from virtual_phantom.simulation.acquire import acquire

RADIUS, PLACE, MU = 80.0, np.array([12.0, -7.0]), attenuation_per_mm("water", [DISC_ENERGY_KEV])[0]
MOVED = load("motion").values({"x_mm_per_s": 1.0})
STEPS = 400  # of a view's interval


def scanner(views=60, rows=2, **times):
    return circular(
        views=views,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=64,
        rows=rows,
        column_pitch_mm=7.0,
        row_pitch_mm=7.0,
        **times,
    )


def fine_glow(signal, share, constant, interval, exposure):
    """Readings of views [view] whose beam is on for `exposure` in the middle of every interval.

    Very many equal views precede them. The light decays exponentially in time steps.
    """
    many = int(20 * constant / interval) + 2
    on = np.abs(np.arange(STEPS) + 0.5 - STEPS / 2) * interval / STEPS < exposure / 2
    beam = np.concatenate([np.full(many, signal[0]), signal])[:, None] * on / on.sum()  # energy per step
    fall = np.exp(-interval / STEPS / constant)
    lit, glow = np.empty(beam.size), 0.0
    for step, arriving in enumerate(beam.ravel()):
        stored = glow + share * arriving
        lit[step] = (1 - share) * arriving + stored * (1 - fall)
        glow = stored * fall
    return lit.reshape(beam.shape).sum(axis=1)[many:]


@pytest.mark.parametrize(("interval", "exposure"), [(1.0, 1.0), (2.5, 2.5), (2.5, 1.0), (7.0, 0.035)])
def test_one_afterglow_is_read_in_views_of_any_length(interval, exposure):
    signal = np.random.default_rng(1).uniform(0.1, 1, 12)
    share, constant = 0.3, 3.0
    lag = (*of_views(share, constant, interval, exposure), 1.0)
    found = with_afterglow(signal[:, None, None], lag)[:, 0, 0]
    np.testing.assert_allclose(found, fine_glow(signal, share, constant, interval, exposure), rtol=2e-3)
    # afterglow within the view would change the reading by much more
    assert (
        np.abs(found - signal).max() > 10 * np.abs(found - fine_glow(signal, share, constant, interval, exposure)).max()
    )


def test_flash_leaves_as_much_afterglow_as_a_short_exposure():
    for short in (0.0, 1e-6):
        assert of_views(0.2, 4.0, 6.0, short) == pytest.approx((0.2 * np.exp(-0.75), np.exp(-1.5)), rel=1e-6)
    assert of_views(0.2, 4.0, 6.0, 6.0) == of_views(0.2, 4.0, 6.0)


@pytest.mark.parametrize(("before", "air"), [(0.0, False), (1.0, True)])
def test_afterglow_of_flashes_agrees_with_xcist(before, air):
    """XCIST's lag of views that are flashes in the middle of their intervals, after a dark and after a lit start."""
    signal = np.random.default_rng(4).uniform(0.1, 1, 8)
    cfg = SimpleNamespace(
        physics=SimpleNamespace(lag_taus=[3.0, 1.0], lag_alphas=[0.25, 0.0], viewSampleCount=1),
        protocol=SimpleNamespace(rotationTime=0.3, viewsPerRotation=60, startViewId=0),
        sim=SimpleNamespace(isAirScan=air),
    )
    theirs = [Detection_Lag(np.array([one]), view, 0, cfg)[0] for view, one in enumerate(signal)]
    lag = (*of_views(0.25, 3.0, 5.0, 0.0), before)
    np.testing.assert_allclose(with_afterglow(signal[:, None, None], lag)[:, 0, 0], theirs, rtol=1e-12)


def test_excluded_views_still_contribute_afterglow():
    """For a linearly growing signal, readings of every third view equal those of the whole scan."""
    whole = np.linspace(1, 2, 31)[:, None, None]
    lag = (0.2, 0.6, 1.0)
    np.testing.assert_allclose(with_afterglow(whole[::3], lag, step=3), with_afterglow(whole, lag)[::3])
    np.testing.assert_allclose(interpolate_views(whole[::3], 3), whole)
    state = Chain(DiscScene(160.0, "water"), scanner(view_interval_ms=5.0).every(3)).state(
        {"afterglow": {"share": 0.3, "time_constant_ms": 12.0, "before": 1.0}}
    )
    share, memory, _ = state.lag
    weights = np.array([1 - share, *(share * (1 - memory) * memory**j for j in range(80))])
    signal = np.ones((400, 1, 1))
    lasting = State(state.geometry, signal=signal, air=signal[:1], lag=state.lag)
    right = (weights[3:] * weights[:-3]).sum() / (weights**2).sum()
    # The noise of views before the scan is averaged and uncorrelated with the scan's.
    assert correlations(lasting)[2] == pytest.approx(right, rel=0.01)


def test_previous_views_are_used_where_they_are_known():
    whole = np.random.default_rng(2).normal(size=(1 + 3 * 12, 2, 4))
    earlier = np.stack([np.concatenate([whole[:1], whole[12 - count :: 12][:3]]) for count in EARLIER_VIEWS])
    found = interpolate_views(whole[::12], 12, earlier)
    for back in (0, *EARLIER_VIEWS):
        np.testing.assert_allclose(found[12 - back :: 12], whole[12 - back :: 12][: len(found[12 - back :: 12])])
    np.testing.assert_allclose(found[12 - 4], (found[12 - 3] + found[12 - 5]) / 2)
    # For closer views, the view before the previous one is not needed.
    np.testing.assert_allclose(interpolate_views(whole[::2], 2, earlier[:, :1].repeat(19, 1))[::2], whole[::2])


@pytest.mark.parametrize("name", ["afterglow", "slow_afterglow"])
@pytest.mark.parametrize("constant_ms", [4.0, 12.0])
def test_afterglow_is_correct_in_a_subset_of_views(name, constant_ms):
    """Every 15th view of a complete scan: an afterglow of three views is invisible between views at 22 degrees."""
    body = [ellipsoid("water", (0, 0, 0), (90, 60, 1000)), cylinder("aluminium", (50, -20, 0), 8)]
    geometry = scanner(views=240, view_interval_ms=4.0)
    every = Chain(ShapesScene(body), geometry, 1e5, samples=2)
    few = Chain(ShapesScene(body), geometry.every(15), 1e5, samples=2)
    glow = {name: {"share": 0.1, "time_constant_ms": constant_ms, "before": 1.0}}
    right = every.state(glow).line_integrals()[::15][1:]
    without = every.state({}).line_integrals()[::15][1:]
    state = few.state(glow)
    found, far = state.line_integrals()[1:], replace(state, earlier=None).line_integrals()[1:]
    change = np.linalg.norm(right - without)
    assert np.linalg.norm(found - right) < 0.05 * change < 0.5 * change < np.linalg.norm(far - right)


def chords(geometry, moved=0.0):
    """Chords [view, row, column] of a long cylinder, whose axis is at PLACE + moved (view, 2)."""
    angle = geometry.angles_rad[:, None]
    fan = np.arctan(geometry.column_positions_mm() / geometry.source_to_detector_mm)
    centre = np.broadcast_to(PLACE + moved, (geometry.views, 2))
    # Distance of the axis from the ray at the fan angle whose source is at (-R sin b, R cos b).
    source = geometry.source_to_isocentre_mm * np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    along = np.stack([np.sin(angle + fan), -np.cos(angle + fan)], axis=-1)
    to = centre[:, None] - source
    off = to[..., 0] * along[..., 1] - to[..., 1] * along[..., 0]
    plane = 2 * np.sqrt(np.maximum(RADIUS**2 - off**2, 0))
    in_plane = np.hypot(geometry.column_positions_mm(), geometry.source_to_detector_mm)
    slant = np.hypot(1, geometry.row_positions_mm()[:, None] / in_plane)
    return plane[:, None, :] * slant


def recorded(geometry, photons, *, velocity=(0.0, 0.0), level=0.0, drift=0.0, glow=None, units=3.0, repeats=4):
    """Repeats of a scan in readout units, `units` per photon; velocity in mm/s, drift in units per second."""
    random = np.random.default_rng(5)
    times = (np.arange(geometry.views) + 0.5 - geometry.views / 2) * geometry.view_interval_ms / 1000
    mean = photons * np.exp(-MU * chords(geometry, times[:, None] * velocity))
    shape = (1, *mean.shape[1:])
    white, dark = np.full(shape[1:], units * photons + level), np.zeros(shape[1:])
    taken = []
    for _ in range(repeats):
        counts = random.poisson(mean).astype(float)
        if glow is not None:
            counts = glowing(counts, *glow, geometry.view_interval_ms)
        taken.append(Projections(units * counts + level + drift * times[:, None, None], white, dark))
    return observed.scans(taken)


def glowing(counts, share, constant, interval):
    """Views [view, row, column] for a continuous beam: the weights of each view from one view in fine steps."""
    one = np.zeros(len(counts))
    one[1] = 1.0
    weights = fine_glow(one, share, constant, interval, interval)[1:]
    before = np.cumsum(weights[::-1])[::-1]  # views before the scan, each equal to the first one on average
    read = np.zeros_like(counts)
    for late, weight in enumerate(weights):
        read[late:] += weight * counts[: len(counts) - late]
    return read + (np.append(before[1:], [0.0] * (len(counts) - len(before) + 1))[:, None, None] * counts[0])


def fitted(taken, geometry, photons, name, readout):
    chain = Chain(DiscScene(2 * RADIUS, "water"), geometry, readout=readout)
    known = {"x_mm": 20.0, "y_mm": 20.0}
    fitter = prepared.prepare(taken, None, chain, nominal_photons=photons, known=known).fitter
    return fitter.fit((name,), fitter.fit(()))


# The same scanner: slower with fewer photons, and faster with more.
SCANS = [(scanner(view_interval_ms=20.0), 2e4), (scanner(views=80, rows=4, view_interval_ms=4.0), 2e5)]


@pytest.mark.parametrize(
    ("name", "made", "truth"),
    [
        ("motion", {"velocity": (1.5, -2.0)}, {"x_mm_per_s": 1.5, "y_mm_per_s": -2.0}),
        ("dark_signal", {"level": 900.0, "drift": 400.0}, {"level_units": 900.0, "drift_units_per_s": 400.0}),
        ("afterglow", {"glow": (0.12, 6.0)}, {"share": 0.12, "time_constant_ms": 6.0}),
    ],
)
@pytest.mark.parametrize("scan", range(len(SCANS)))
def test_fit_finds_equal_parameters_at_another_speed_dose_and_collimation(name, made, truth, scan):
    geometry, photons = SCANS[scan]
    taken = recorded(geometry, photons, **made)
    fit = fitted(taken, geometry, photons, name, float(taken.white.mean()))
    for key, value in truth.items():
        error = fit.errors[name][key]
        assert abs(fit.physics[name][key] - value) < 3.5 * error and error < 0.5 * abs(value), (key, fit.physics[name])


# Effects that depend on time or on readings: their parameters have a range relative to one scan.
TIMED_OR_READ = {name for name in names() if any(one.reach is not None for one in load(name).parameters)}
HELD_TO = {  # effects that depend on the height of the beam
    "scatter": "its amount falls with the height of the beam",
    "veiling_glare": "the dark beside the beam spreads into it as its light does",
}


@pytest.mark.parametrize("name", [name for name in names() if not acts_on_images(name)])
def test_collimation_keeps_the_readings_of_the_remaining_rows(name):
    """Speed and dose do not change the means of effects that depend neither on time nor on readings."""
    if name in HELD_TO:
        pytest.skip(HELD_TO[name])
    physics = {name: load(name).values({})}
    wide, narrow = (
        Chain(DiscScene(160.0, "water"), scanner(rows=rows, view_interval_ms=5.0), 1e5).state(physics)
        for rows in (12, 6)
    )
    np.testing.assert_allclose(wide.line_integrals()[:, 5:7], narrow.line_integrals()[:, 2:4], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(wide.variance()[:, 5:7], narrow.variance()[:, 2:4], rtol=1e-6)
    if name not in TIMED_OR_READ:
        other = Chain(DiscScene(160.0, "water"), scanner(rows=12, view_interval_ms=1.0), 4e5).state(physics)
        np.testing.assert_allclose(other.line_integrals(), wide.line_integrals(), rtol=1e-6, atol=1e-9)


def test_effects_that_need_unknown_times_are_no_candidates():
    chain = Chain(DiscScene(160.0, "water"), scanner(), readout=AIR)
    timed = {"afterglow", "slow_afterglow", "motion", "source_drift"}
    assert {name for name in names() if needs_times(name)} == timed
    for name in sorted(timed):
        with pytest.raises(InputError, match="the time between views is not known"):
            chain.parameters(name)
    with pytest.raises(InputError, match="set scan.view_interval_ms or scan.rotation_time_ms"):
        chain.state({"motion": MOVED})
    (level,) = chain.parameters("dark_signal")
    assert (level.name, level.unit, level.high) == ("level_units", "of air", 0.1)
    assert chain.fixed_parameters("dark_signal") == {"drift_units_per_s": 0.0}
    fit = fitted(recorded(scanner(view_interval_ms=5.0), 2e4, level=600.0), scanner(), 2e4, "dark_signal", AIR)
    found, error = fit.physics["dark_signal"], fit.errors["dark_signal"]["level_units"]
    assert found["drift_units_per_s"] == 0 and abs(found["level_units"] - 0.01) < 3.5 * error + 0.02 * 0.01


def test_ranges_depend_on_the_scan():
    slow = scanner(view_interval_ms=1000.0)
    x, *_ = Chain(DiscScene(160.0, "water"), slow).parameters("motion")
    assert (x.low, x.high, x.typical) == pytest.approx((-1 / 3, 1 / 3, 1 / 60))  # 20 and 1 mm in a minute
    level, drift = Chain(DiscScene(160.0, "water"), slow, readout=4000.0).parameters("dark_signal")
    assert (level.low, level.high, level.unit) == (-80, 400, "readout units") and level.reach.of == OF_AIR
    assert drift.high == pytest.approx(80 / 60) and drift.unit == "readout units/s"
    _, constant, _ = Chain(DiscScene(160.0, "water"), replace(slow, view_interval_ms=0.3)).parameters("afterglow")
    assert (constant.low, constant.high) == pytest.approx((0.1, 15.0))  # 0.1 ms is the smallest value


def test_study_has_the_same_dark_signal_at_every_dose_and_keeps_its_times(tmp_path):
    """In photons for any A: clean projections are written once for all noise levels."""
    geometry = scanner(views=24, view_interval_ms=5.0, exposure_ms=2.0)
    chain = Chain(DiscScene(160.0, "water"), geometry, photons=1.0)
    found = []
    for name, physics in (("plain", {}), ("dark", {"dark_signal": {"level_units": 40.0, "drift_units_per_s": 100.0}})):
        state = chain.state(physics)
        write_line_integrals(tmp_path / f"{name}.h5", chain.state({}).line_integrals(), geometry, to_store(state))
        lines, read = read_line_integrals(tmp_path / f"{name}.h5")
        assert (read.view_interval_ms, read.exposure_ms) == (5.0, 2.0)
        np.testing.assert_array_equal(read.view_times, geometry.view_times)
        labels = {"geometry": "a", "noise": "b", "seed": 1, "model": "physical", "study_seed": 3}
        stored = read_state(tmp_path / f"{name}.h5")
        found.append([acquire(lines, **labels, noise_level=level, state=stored) for level in (1e-4, 1e-3)])
    times = (np.arange(24) - 11.5) * 0.005
    for plain, dark in zip(*found, strict=True):
        more = (dark.data - plain.data).mean(axis=(1, 2))
        np.testing.assert_allclose(more, 40 + 100 * times, rtol=1e-3)
        np.testing.assert_allclose(dark.white - plain.white, 40.0, rtol=1e-3)


def test_readings_and_shares_become_photons_of_a_study():
    """900 of 30 000 readout units, or 3 % of an air signal of 20 000 photons, are 600 photons."""
    geometry, aligned = scanner(view_interval_ms=5.0), {"log_photons": np.log(2e4)}
    for readout, level in ((30900.0, 900.0), (AIR, 0.03)):
        model = ScansModel(Chain(DiscScene(160.0, "water"), geometry, readout=readout), ())
        physics = {"dark_signal": {"level_units": level, "drift_units_per_s": -level}, "motion": MOVED}
        found = model.in_study_units(physics | {"gain_pattern": {"rms": 0.004}}, aligned)
        assert found.pop("gain_pattern") == {"rms": 0.004}  # fitted without a stated pattern
        assert found["dark_signal"] == pytest.approx({"level_units": 600.0, "drift_units_per_s": -600.0})
        assert found["motion"] == MOVED
