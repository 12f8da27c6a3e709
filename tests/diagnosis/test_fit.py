"""Steps, errors and starts of fits."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from simulated_scans import body, chosen, noisy_lines

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.fitting.priors import declared
from virtual_phantom.diagnosis.fitting.problem import Problem
from virtual_phantom.diagnosis.fitting.solver import Iterate, solve
from virtual_phantom.diagnosis.fitting.steps import NORMAL_95, bounded_step, standard_errors
from virtual_phantom.diagnosis.fitting.templates import data_changes
from virtual_phantom.diagnosis.fitting.unknown import Unknown
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.selection.screening import amounts, explained, screened
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.effect import LOGARITHM, load
from virtual_phantom.physics.scenes.posed import PosedScene
from virtual_phantom.physics.scenes.scene import VoxelScene

WIDE = np.full(3, np.inf)
WIDTH = next(parameter for parameter in load("focal_spot").parameters if parameter.name == "width_mm")


def exact(matrix, right):
    """Solve a linear system by Cramer's rule with fractions, without rounding."""

    def determinant(rows):
        a, b, c = rows
        return (
            a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])
        )

    rows = [[Fraction(float(value)) for value in row] for row in matrix]
    whole = determinant(rows)
    found = []
    for column in range(3):
        changed = [row[:] for row in rows]
        for row, value in zip(changed, right, strict=True):
            row[column] = Fraction(float(value))
        found.append(float(determinant(changed) / whole))
    return np.array(found)


class Valley:
    """Residuals x and sqrt(1000 - 0.98 x^2): their squared derivatives are 50 times the curvature of chi-square."""

    low, high, patterned, count = np.full(1, -30.0), np.full(1, 30.0), False, 2

    def at(self, point):
        residuals = np.array([point[0], np.sqrt(1000 - 0.98 * point[0] ** 2)])
        return Iterate(point, {"": [residuals]}, float(residuals @ residuals))

    def inherited_jacobians(self, here):
        return None

    def stepped(self, here, step):
        return self.at(np.clip(here.point + step, self.low, self.high))

    def jacobians(self, here):
        first, second = here.residuals[""][0]
        return np.array([[1.0, -0.98 * first / second]])

    def normal(self, jacobian, here):
        return jacobian @ jacobian.T, -jacobian @ here.residuals[""][0]

    def updated(self, jacobian, here, there):
        return jacobian

    def follow(self, here):
        return here

    def needs_new_corrections(self, here):
        return False


def test_steps_grow_where_residuals_are_large():
    valley = Valley()
    found = solve(valley, valley.at(np.array([20.0])))
    assert found.chi_square < 1000.5  # 1007.8 without longer steps, at 1000.4 with them


@settings(deadline=None)
@given(st.lists(st.integers(-9, 9), min_size=3, max_size=3))
def test_steps_and_errors_do_not_depend_on_units(powers):
    """Information on shares and on millimeters can differ by a factor of 1e36; neither is rounding noise."""
    units = 10.0 ** np.array(powers)
    information = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.8], [0.5, -0.8, 2.0]]) * np.outer(units, units)
    gradient = np.array([1.0, -2.0, 0.5]) * units
    step = bounded_step(information, gradient, np.zeros(3), -WIDE, WIDE)
    np.testing.assert_allclose(step, exact(information, gradient), rtol=1e-9)
    inverse = [exact(information, row)[place] for place, row in enumerate(np.eye(3))]
    np.testing.assert_allclose(standard_errors(information), np.sqrt(inverse), rtol=1e-9)


def test_unconstrained_parameter_stays_and_has_infinite_error():
    information = np.diag([4.0, 0.0, 1.0])
    np.testing.assert_array_equal(standard_errors(information), [0.5, np.inf, 1.0])
    np.testing.assert_array_equal(
        bounded_step(information, np.array([2.0, 0.0, 1.0]), np.zeros(3), -WIDE, WIDE), [0.5, 0.0, 1.0]
    )


@settings(deadline=None)
@given(arrays(float, (3, 3), elements=st.floats(-3, 3)), arrays(float, 3, elements=st.floats(-5, 5)))
def test_steps_end_at_the_minimum_within_bounds(root, gradient):
    """At an active bound, the gradient points outwards (Karush-Kuhn-Tucker conditions)."""
    information = root @ root.T + np.eye(3)
    point, low, high = np.array([0.0, 0.5, -1.0]), np.array([0.0, 0.0, -1.5]), np.array([2.0, 0.6, 9.0])
    reached = point + bounded_step(information, gradient, point, low, high)
    assert (reached >= low - 1e-9).all() and (reached <= high + 1e-9).all()
    slope = gradient - information @ (reached - point)  # direction in which the model improves
    tolerance = 1e-6 * (1 + np.abs(information).max())
    assert (slope[reached > low + 1e-7] > -tolerance).all()
    assert (slope[reached < high - 1e-7] < tolerance).all()


def test_two_equivalent_parameters_share_one_step():
    information = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    step = bounded_step(information, np.array([1.0, 1.0, 0.0]), np.zeros(3), -WIDE, WIDE)
    np.testing.assert_allclose(step, [0.5, 0.5, 0.0], atol=1e-12)
    np.testing.assert_array_equal(standard_errors(information), [np.inf, np.inf, 1.0])


def fitted_to(truth, stated=None, insert=((50, 10, None), 20, 800.0)):
    """Fitter of a scan with this physics, simulated in the same steps, for a scanner with declared physics."""
    grid = Grid((12, 96, 96), (3.0, 3.0, 3.0))
    painted = body(grid, (110, 80), 20.0, [insert])
    scene = VoxelScene.of(painted, Segmentation(), 0.0193)
    geometry = circular(
        views=60,
        source_to_isocentre_mm=570.0,
        source_to_detector_mm=1040.0,
        columns=64,
        rows=4,
        column_pitch_mm=8.0,
        row_pitch_mm=8.0,
        view_interval_ms=10.0,
    )
    chain = Chain(PosedScene(scene, 2), geometry, 1e5, samples=2)
    state = chain.state(truth)
    repeats = noisy_lines(state, 4, np.random.default_rng(3)).astype(np.float32)
    white = state.measured_air.mean(axis=0) * state.photons
    taken = observed.Scans(repeats, white, np.ones(repeats[0].shape, bool))
    known = declared(stated or {}, "here")
    return prepared.prepare(taken, None, chain, nominal_photons=1e5, declared=known).fitter


def test_grid_is_found_with_known_scatter():
    scatter = {"scatter": {"amount": 0.1, "width_mm": 60.0}}
    truth = scatter | {"anti_scatter_grid": {"ratio": 8.0, "ratio_along_rows": 0.0}}
    tried = ["anti_scatter_grid", "electronic_noise"]
    alone = chosen(fitted_to(truth), tried)
    assert "anti_scatter_grid" not in alone.alone and not alone.chosen.fit.effects
    stated = {"scatter": {"amount": {"value": 0.1, "sd": 0.001}, "width_mm": {"value": 60.0, "sd": 1.0}}}
    fit = chosen(fitted_to(truth, stated), tried).chosen.fit
    assert fit.effects == ("anti_scatter_grid",)
    ratio, error = (one["anti_scatter_grid"]["ratio"] for one in (fit.physics, fit.errors))
    assert abs(ratio - 8) < 3.5 * error and error < 4


@pytest.mark.parametrize("share, width_mm", [(0.002, 25.0), (0.004, 90.0), (0.02, 90.0)])
def test_faint_wide_glare_is_found_from_the_default_start(share, width_mm):
    """The width changes the data much less than the share. A fit that neglects it would stay at its starting width.

    The share of the faintest glare depends on the light from beyond the detector, which the data do not show.
    """
    truth = {"veiling_glare": {"share": share, "width_mm": width_mm, "beyond": 0.0}}
    fitter = fitted_to(truth)
    fit = fitter.fit(("veiling_glare",), fitter.fit(()))
    errors = fit.errors["veiling_glare"]
    for name, value in truth["veiling_glare"].items():
        assert abs(fit.physics["veiling_glare"][name] - value) < 3.5 * errors[name]
    assert share < 0.01 or (errors["width_mm"] < width_mm and errors["share"] < share / 3)
    begun_there = fitter.fit(("veiling_glare",), replace(fit, physics=truth))
    assert fit.chi_square == pytest.approx(begun_there.chi_square, abs=0.5)


@pytest.mark.parametrize("name, truth", [("photon_flux", {"factor": 0.7}), ("electronic_noise", {"photons": 140.0})])
def test_errors_use_derivatives_at_the_end_of_the_fit(name, truth):
    """Derivatives updated from step to step may keep their errors from the start of the fit."""
    fitter = fitted_to({name: truth})
    fit = fitter.fit((name,), fitter.fit(()))
    there = Problem.at(fitter, fit)
    residuals = there.residuals(there.start)
    information, _ = there.normal(there.jacobian(there.start, residuals), there.start, residuals)
    errors = [*fit.errors[name].values(), *fit.nuisance_errors.values()]
    np.testing.assert_allclose(errors, standard_errors(information), rtol=0.02)


@pytest.mark.parametrize("width_mm", [1.6, 2.4])
def test_blur_is_found_from_a_zero_start(width_mm):
    """The change grows with the square of the width: a fit of the width itself would start with zero slope."""
    fitter = fitted_to({"focal_spot": {"width_mm": width_mm, "length_mm": 0.0}})
    none = fitter.fit(())
    fit = fitter.fit(("focal_spot",), replace(none, physics={"focal_spot": {"width_mm": 0.0, "length_mm": 0.0}}))
    found, error = fit.physics["focal_spot"], fit.errors["focal_spot"]
    assert abs(found["width_mm"] - width_mm) < 3 * error["width_mm"] < 0.5 * width_mm
    assert found["length_mm"] < 3 * error["length_mm"]


@given(st.floats(0, 16), st.floats(1e-6, 20))
def test_intervals_of_a_value_equal_those_of_its_square(number, error):
    one = Unknown("focal_spot", replace(WIDTH, power=2), 0.0, 16.0, (1.0,), 0.0, 8.0, 16.0)
    assert one.of(one.value(number)) == pytest.approx(number)
    value, reach = one.value(number), NORMAL_95 * one.value_error(number, error)
    assert (value + reach) ** 2 >= (number + NORMAL_95 * error) * (1 - 1e-9)
    assert value - reach <= np.sqrt(max(0.0, number - NORMAL_95 * error)) + 1e-9
    if NORMAL_95 * error < 1e-3 * number:
        assert one.value_error(number, error) == pytest.approx(error / (2 * value), rel=1e-3)
    assert one.value_error(number, np.inf) == np.inf


@pytest.mark.parametrize(
    "chosen, left",
    [
        # A wrong distance has pushed the object size to its bound; the filter only has to release it.
        (("afterglow",), {"source_distance": {"isocentre_mm": 1.8, "detector_mm": 0.0}}),
        # Widths far from the typical one.
        (("photon_flux",), {"veiling_glare": {"share": 0.01, "width_mm": 10.0, "beyond": 0.0}}),
        # The same distance with the object size just at its bound: releasing the size is most of the gain.
        (("afterglow",), {"source_distance": {"isocentre_mm": 1.45, "detector_mm": 0.0}}),
        ((), {"detector_offset": {"columns_px": 0.01}}),
        # It cannot be faint, and it changes the meaning of the density scale.
        (("photon_flux",), {"spectrum": {"kvp": 100.0, "filtration_mm": 8.0, "sensor_mm": 0.6}}),
    ],
)
def test_matched_filters_predict_the_gain_of_a_fit(chosen, left):
    physics = {"afterglow": {"share": 0.05, "time_constant_ms": 10.0, "before": 1.0}, "photon_flux": {"factor": 0.8}}
    fitter = fitted_to({name: physics[name] for name in chosen} | left)
    without = fitter.fit(chosen, fitter.fit(()))
    ((name, _),) = left.items()
    gained = sum(without.parts) - sum(fitter.fit((*chosen, name), without).parts)
    assert gained > 15
    assert 0.5 < screened(fitter, without, [name])[name].gain / gained < 2


@pytest.mark.parametrize("rows_mm", [2.5, 6.0])
def test_matched_filters_of_ray_moving_effects_see_what_the_pose_absorbs(rows_mm):
    """A row offset looks like a shifted object, whose position has a prior."""
    fitter = fitted_to({"detector_row_offset": {"rows_mm": rows_mm}}, insert=((50, 10, 10.0), 12, 800.0))
    without = fitter.fit(())
    assert abs(without.nuisance["z_mm"]) > 1
    gained = without.chi_square - fitter.fit(("detector_row_offset",), without).chi_square
    assert screened(fitter, without, ["detector_row_offset"])["detector_row_offset"].gain == pytest.approx(
        gained, rel=0.1
    )


def test_jacobians_at_finished_fits_are_computed_once():
    """Once for both halves, and again for a model with a prior from elsewhere."""
    truth = {"scatter": {"amount": 0.05, "width_mm": 60.0}}
    fitter = fitted_to(truth)
    fit = fitter.fit(("scatter",), fitter.fit(()))
    fitted, held_out = Problem.at(fitter, fit).changes_of_halves()
    again = Problem.at(fitter, fit)
    fresh = again.jacobian(again.start, again.residuals(again.start))
    for one, other in zip(fitted, fresh, strict=True):
        np.testing.assert_array_equal(one, other)
    predict = fitter.model.predict
    try:
        fitter.model.predict = None
        columns = data_changes(again)
        assert again.changes_of_halves()[1] is held_out
    finally:
        fitter.model.predict = predict
    np.testing.assert_allclose(
        columns[: fitter.data.mean.size].T * again.steps[:, None], fitted[0] * np.sqrt(fitter.weights[0])
    )
    known = fitter.model.with_fixed({"scatter": {"width_mm": 60.0}})
    assert data_changes(Problem.at(fitter.of(known), fit)).shape[1] == len(again.start) - 1


def test_columns_of_the_given_fit_are_inherited():
    """The steps of the two problems may differ, and the derivatives change little beside faint scatter."""
    fitter = fitted_to({})
    given = fitter.fit(())
    problem = Problem(fitter, ("scatter",), given)
    point = problem.start.copy()
    point[0] = 1e-3
    residuals = problem.residuals(point)
    fresh, inherited = problem.jacobian(point, residuals)[0], problem.inherited_jacobian(point, residuals)[0]
    np.testing.assert_array_equal(inherited[:2], fresh[:2])  # of scatter
    assert (np.linalg.norm(inherited - fresh, axis=1) <= 0.05 * np.linalg.norm(fresh, axis=1)).all()
    assert Problem(fitter, (), given).inherited_jacobian(given, residuals) is None


def test_scatter_cannot_be_negative():
    """Data that need a negative amount of an effect support another effect."""
    least, most = amounts(load("scatter").parameters)
    assert least.tolist() == [0.0] and most[0] > 1
    least, most = amounts(load("photon_flux").parameters)
    assert least[0] < 0 < most[0]
    least, most = amounts(load("spectrum").parameters)
    assert least[0] > 0


def test_amounts_stay_in_range_and_equal_templates_count_once():
    rows, residual = np.eye(2, 5), np.array([-3.0, 2.0, 1.0, 0.0, 0.0])
    wide = np.full(2, np.inf)
    assert explained(rows, residual, -wide, wide) == pytest.approx(13)
    assert explained(rows, residual, np.array([0.0, -np.inf]), wide) == pytest.approx(4)
    assert explained(rows[1:], residual, np.array([-1.0]), np.array([1.0])) == pytest.approx(4 - 1)
    assert explained(rows[1:], residual, np.array([5.0]), np.array([9.0])) == 0  # worse than no effect
    twice = np.stack([rows[1], rows[1] + 1e-7 * rows[0]])
    assert explained(twice, residual, -wide, wide) == pytest.approx(4, abs=1e-3)


def test_stalled_fit_restarts_from_farther_away(monkeypatch):
    """Parameters of ray-moving effects restart at shares of their range; the best result is returned."""
    fitter = fitted_to({"detector_row_offset": {"rows_mm": 2.0}})
    stalled = fitter.fit(("detector_row_offset",))
    begun = Problem(fitter, ("detector_row_offset",), None).farther(stalled)
    numbers = [one.physics["detector_row_offset"]["rows_mm"] for one in begun]
    here = stalled.physics["detector_row_offset"]["rows_mm"]
    assert numbers == pytest.approx([max(here - 10, -10), here - 2, here + 2, min(here + 10, 10)])
    assert all(one.nuisance == stalled.nuisance for one in begun)
    ends = iter([(replace(stalled, chi_square=value), 9.0) for value in (50.0, 60.0, 40.0, 30.0, 70.0)])
    monkeypatch.setattr(fitter, "_solve", lambda problem, final, needed: next(ends))
    assert fitter.fit(("detector_row_offset",)).chi_square == 30.0


def test_fit_that_cannot_matter_ends_early(monkeypatch):
    """A spectrum does not explain scatter: its fit ends near its minimum, far above the needed chi-square."""
    computed, jacobian = [], Problem.jacobian
    monkeypatch.setattr(Problem, "jacobian", lambda self, *rest: computed.append(rest) or jacobian(self, *rest))
    fitter = fitted_to({"scatter": {"amount": 0.1, "width_mm": 60.0}})
    aligned = fitter.fit(())
    right = fitter.fit(("scatter",), aligned, final=False)
    needed = right.chi_square + 20
    found, times = {}, {}
    for least in (np.inf, needed):
        computed.clear()
        found[least] = fitter.fit(("spectrum",), aligned, final=False, needed=least).chi_square
        times[least] = len(computed)
    assert times[needed] < times[np.inf]
    assert needed < found[np.inf] < found[needed] < found[np.inf] + 0.01 * (found[np.inf] - needed)
    assert fitter.fit(("scatter",), aligned, final=False, needed=needed).chi_square == right.chi_square


def test_effects_that_move_no_rays_do_not_restart():
    fitter = fitted_to({"scatter": {"amount": 0.1, "width_mm": 60.0}})
    fit = fitter.fit(("scatter",))
    assert Problem(fitter, ("scatter",), None).farther(fit) == []
    # An effect that was fitted before does not restart either.
    fit = fitter.fit(("detector_row_offset",))
    assert Problem(fitter, ("detector_row_offset",), fit).farther(fit) == []


VALLEY = {"source_distance": {"isocentre_mm": -6.0, "detector_mm": 2.0}}


def test_slopes_are_exact_along_the_valley_of_ray_moving_effects():
    """Object size, density scale and distances together change the data by a tenth of what each does alone."""
    fitter = fitted_to(VALLEY)
    fit = fitter.fit(("source_distance",))
    problem = Problem.at(fitter, fit)
    problem.follow(problem.start)
    here = problem.residuals(problem.start)
    jacobian = problem.jacobian(problem.start, here)
    information, _ = problem.normal(jacobian, problem.start, here)
    along = np.linalg.inv(information)[0]
    along /= np.sqrt(
        along[0]
    )  # one standard error of the first parameter, with the others at their conditional optimum
    moved = problem.residuals(problem.start + along)
    predicted_decrease = jacobian[0].T @ (along / problem.steps)
    root = np.sqrt(fitter.weights[0])
    off = np.linalg.norm((here[0] - moved[0] - predicted_decrease) * root)
    assert off < 0.2 * np.linalg.norm(predicted_decrease * root)


def test_fit_in_a_valley_ends_at_the_fit_from_the_true_values():
    fitter = fitted_to(VALLEY)
    fit = fitter.fit(("source_distance",))
    there = fitter.fit(("source_distance",), replace(fit, physics=VALLEY))
    assert fit.chi_square == pytest.approx(there.chi_square, abs=0.1)
    for key, value in fit.physics["source_distance"].items():
        error = fit.errors["source_distance"][key]
        assert abs(value - there.physics["source_distance"][key]) < 0.3 * error
        assert abs(value - VALLEY["source_distance"][key]) < 3 * error


@pytest.mark.parametrize("power", [1, 2, LOGARITHM])
@pytest.mark.parametrize("number, error", [(1.5, 0.2), (1.5, 0.7), (0.0, 0.4)])
def test_errors_of_values_transform_back_to_those_of_parameters(power, number, error):
    one = Unknown("focal_spot", replace(WIDTH, power=power), -9.0, 9.0, (0.0,), None, 0.0, 1.0)
    assert one.number_error(one.value(number), one.value_error(number, error)) == pytest.approx(error)
