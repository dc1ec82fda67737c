import numpy as np
import pytest

from calibration import sets
from calibration.checks import problems_of_set
from calibration.spectra import WAVELENGTHS, Spectra


@pytest.mark.parametrize(
    ("what", "values", "says"),
    [
        ("light", [[1.0, -1.0]], "light 'a' is negative"),
        ("light", [[0.0, 0.0]], "light 'a' is 0 everywhere"),
        ("light", [[1.0, 2.0], [2.0, 4.0]], "light 'b' is 'a' again"),
        ("light", [[1.0, 1.0], [2.0, 2.0]], "every light is the same at all wavelengths"),
        ("surface", [[20.0, 60.0]], "surface 'a' reaches 60: percent"),
        ("surface", [[0.2, 0.4], [0.2, 0.4]], "surface 'b' is 'a' again"),
    ],
)
def test_lights_and_surfaces_of_no_use_are_named(what, values, says):
    columns = np.array([np.linspace(a, b, 36) for a, b in values]).T
    given = Spectra(WAVELENGTHS, tuple("ab"[: len(values)]), columns)
    (problem,) = problems_of_set(given, what)
    assert says in str(problem)


def test_a_surface_half_as_bright_is_another_surface():
    columns = np.linspace((0.2, 0.4), (0.4, 0.8), 36)
    assert problems_of_set(Spectra(WAVELENGTHS, ("a", "b"), columns), "surface") == []


@pytest.mark.parametrize("name", ["room", "darling2011"])
def test_what_ships_has_no_problems(name):
    assert problems_of_set(sets.lights(name), "light") == []
