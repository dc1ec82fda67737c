import numpy as np
import pytest

from calibration import sets
from calibration.descent import Colours, Equations, descend
from calibration.optimise import rendering_errors
from calibration.primaries import load
from calibration.slopes import delta_e_2000_slopes, lab_slopes


@pytest.fixture(scope="module")
def colours():
    lights = sets.lights("darling2011").only(["A", "D65", "F2", "F11"])
    return Colours.of(lights, sets.surfaces("colorchecker24"), 0.2)


def residuals(colours, curves, matrix):
    """Each part of each colour's difference, times the root of its weight."""
    products = (colours.lights @ curves)[:, None] * (colours.surfaces @ curves)
    seen = np.einsum("lij,lsj->lsi", colours.to_d65, products @ matrix.T)
    parts = delta_e_2000_slopes(colours.target, lab_slopes(seen)[0])[0]
    return (np.sqrt(colours.weights)[..., None] * parts).ravel()


def test_the_normal_equations_are_those_of_the_jacobian_that_is_never_made(colours):
    curves, matrix = load("darling2011").curves, load("darling2011").xyz_from_primaries
    at = np.concatenate([curves.T.ravel(), matrix.ravel()])

    def of(point):
        return residuals(colours, point[:-18].reshape(6, 36).T, point[-18:].reshape(3, 6))

    step = 1e-6
    jacobian = np.stack(
        [(of(at + step * e) - of(at - step * e)) / (2 * step) for e in np.eye(len(at))], axis=1
    )
    equations = colours.equations(curves, matrix)
    left, right = jacobian.T @ jacobian, jacobian.T @ of(at)
    assert equations.cost == pytest.approx(np.sum(of(at) ** 2))
    np.testing.assert_allclose(equations.left, left, atol=1e-6 * np.abs(left).max())
    np.testing.assert_allclose(equations.right, right, atol=1e-6 * np.abs(right).max())


def test_the_errors_are_the_rendering_errors(colours):
    darling = load("darling2011")
    lights = sets.lights("darling2011").only(["A", "D65", "F2", "F11"])
    errors = colours.equations(darling.curves, darling.xyz_from_primaries).errors
    expected = rendering_errors(darling, lights, sets.surfaces("colorchecker24+white"))
    np.testing.assert_allclose(errors, expected, atol=1e-9)


def test_reweighted_squares_add_up_to_about_the_mean_squared(colours):
    errors = np.random.default_rng(1).uniform(0.8, 1.2, colours.counts.shape)
    mean = np.sum(colours.counts * errors)
    nearer = colours.nearer_the_mean(errors)
    assert np.sum(nearer.weights * errors**2) == pytest.approx(mean**2)


def test_thinned_colours_keep_white_and_its_share(colours):
    few = colours.thinned(30)
    assert few.counts.size <= 36
    np.testing.assert_array_equal(few.surfaces[-1], 1.0)
    assert few.counts.sum() == pytest.approx(1.0)
    assert few.counts[:, -1].sum() == pytest.approx(colours.counts[:, -1].sum(), rel=0.1)


def rosenbrock(at):
    """Squares of 10 (y - x^2) and 1 - x: a bent valley whose minimum is (1, 1)."""
    x, y = at
    residual = np.array([10.0 * (y - x**2), 1.0 - x])
    jacobian = np.array([[-20.0 * x, 10.0], [-1.0, 0.0]])
    return Equations(
        float(residual @ residual), jacobian.T @ jacobian, jacobian.T @ residual, residual
    )


def test_the_descent_follows_a_bent_valley_to_its_end():
    at, here = descend(rosenbrock, np.array([-1.2, 1.0]), steps=200, tolerance=0.0)
    np.testing.assert_allclose(at, 1.0, atol=1e-6)
    assert here.cost < 1e-12


def test_what_may_not_fall_lower_stays_at_its_bound():
    """|A x - b|^2 over x >= 0, against Lawson and Hanson's NNLS."""
    from scipy.optimize import nnls

    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(30, 12)), rng.normal(size=30)

    def equations(at):
        residual = a @ at - b
        return Equations(float(residual @ residual), a.T @ a, a.T @ residual, residual)

    at, _ = descend(equations, np.ones(12), steps=200, lowest=0.0, tolerance=0.0)
    expected = nnls(a, b)[0]
    assert np.count_nonzero(expected == 0.0) >= 3
    np.testing.assert_allclose(at, expected, atol=1e-6)
