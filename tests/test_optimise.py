import numpy as np
import pytest

from calibration import optimise, sets
from calibration.descent import Colours
from calibration.errors import InputError
from calibration.primaries import Primaries, gaussians, load
from calibration.spectra import WAVELENGTHS, Spectra


@pytest.fixture(scope="module")
def lights():
    return sets.lights("darling2011")


@pytest.fixture(scope="module")
def checker():
    return sets.surfaces("colorchecker24")


def test_the_shipped_matrix_has_the_papers_accuracy(lights, checker):
    """The paper's ColorChecker under its 19 lights: mean .6, sd .6, max 3.1, 90 % below 1.2."""
    errors = optimise.rendering_errors(load("darling2011"), lights, checker)
    assert errors.mean() <= 0.57
    assert errors.std() <= 0.6
    assert np.percentile(errors, 90) <= 1.2
    assert errors.max() <= 3.7


def test_white_is_white_under_every_light(lights):
    errors = optimise.rendering_errors(load("darling2011"), lights, sets.surfaces("white"))
    assert errors.mean() <= 0.42
    assert errors.max() <= 1.4


def test_fitted_to_the_colorchecker_alone_the_papers_curves_do_no_better_than_the_paper_says(
    lights, checker
):
    """.55/.54/3.3/1.17 was found with another fit of the same curves."""
    matrix = optimise.fit_matrix(load("darling2011").curves, lights, checker, white_share=0.0)
    errors = optimise.rendering_errors(
        Primaries("x", load("darling2011").curves, matrix), lights, checker
    )
    assert 0.5 < errors.mean() <= 0.57


def test_the_shipped_matrix_is_a_minimum_of_what_it_was_fitted_to(lights):
    """So the file is what `python -m calibration.optimise` gives, without running all of it."""
    shipped = load("darling2011")
    surfaces = optimise._with_white(sets.surfaces("ces99+rawtoaces190"))
    weights = np.append(np.ones(289), optimise.WHITE_SHARE * 289)

    def cost(matrix):
        errors = optimise.rendering_errors(Primaries("x", shipped.curves, matrix), lights, surfaces)
        return np.sum(weights * errors**2)

    least = cost(shipped.xyz_from_primaries)
    rng = np.random.default_rng(7)
    for _ in range(12):
        nudge = 0.003 * rng.normal(size=(3, 6)) * np.abs(shipped.xyz_from_primaries)
        assert cost(shipped.xyz_from_primaries + nudge) > 0.9995 * least


def test_primaries_that_are_the_observers_own_make_no_error_without_a_surface(lights):
    """One channel a colour matching function: light on white is then exact, whatever the light."""
    curves = sets.observer() / sets.observer().sum(axis=0)
    matrix = np.diag(sets.observer().sum(axis=0))
    errors = optimise.rendering_errors(
        Primaries("cmf", curves, matrix), lights, sets.surfaces("white")
    )
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)


def test_a_matrix_that_is_exact_is_found(lights):
    """With the colour matching functions as curves, greys are exact through their sums alone."""
    grey = Spectra(WAVELENGTHS, ("grey",), np.full((36, 1), 0.4))
    sums = sets.observer().sum(axis=0)
    matrix = optimise.fit_matrix(sets.observer() / sums, lights, grey)
    np.testing.assert_allclose(matrix, np.diag(sums), atol=1e-6)


@pytest.fixture(scope="module")
def small(lights):
    """A problem of a second: six lights on every sixth of the CES99."""
    few = lights.only(["A", "D50", "D90", "F2", "F8", "F11"])
    return few, sets.surfaces("ces99").only([f"CES{i:02d}" for i in range(1, 100, 6)])


# The most that the ColorChecker, which none was trained on, may differ on average under the paper's
# 19 lights, its five places, and the LEDs left out. Written down from the files as they ship.
@pytest.mark.parametrize(
    ("name", "at_most"),
    [
        ("gaussian6", (0.83, 0.77, 0.99)),
        ("signed5", (0.32, 0.29, 0.64)),
        ("signed6", (0.24, 0.17, 0.53)),
        ("signed7", (0.11, 0.09, 0.35)),
        ("signed8", (0.11, 0.10, 0.29)),
        ("nonnegative6", (0.51, 0.53, 0.80)),
    ],
)
def test_what_ships_reproduces_colours_it_was_not_trained_on(name, at_most, checker):
    for tested, most in zip(("darling2011", "places5", "leds8"), at_most, strict=True):
        errors = optimise.rendering_errors(load(name), sets.lights(tested), checker)
        assert errors.mean() <= most, tested


@pytest.mark.slow
@pytest.mark.parametrize("name", ["signed6", "nonnegative6"])
def test_what_ships_is_where_its_descent_ends(name):
    """So the files are what `python -m calibration.optimise NAME` gives, without running it."""
    kind, channels = optimise.TRAINED[name]
    shipped = load(name)
    form = optimise._Form(kind, channels, optimise.SMOOTHING)
    colours = Colours.of(
        sets.lights(optimise.TRAINING_LIGHTS),
        sets.surfaces(optimise.TRAINING_SURFACES),
        optimise.WHITE_SHARE,
    )
    at = np.concatenate([form.free(shipped.curves), shipped.xyz_from_primaries.ravel()])
    errors = form.equations(colours)(at).errors
    nearer = colours.nearer_the_mean(errors)
    _, there = form.descend(nearer, at, steps=3)
    assert there.cost > 0.97 * form.equations(nearer)(at).cost


def test_curves_that_can_be_exact_are_found(lights):
    """On greys any curves that span the colour matching functions are: three signed ones can."""
    near = Primaries("near", gaussians(np.array([445.0, 550.0, 600.0]), 25.0), np.empty((3, 3)))
    greys = Spectra(WAVELENGTHS, ("a", "b", "c"), np.outer(np.ones(36), [0.2, 0.5, 0.8]))
    found, figures = optimise.new_set(
        lights, greys, channels=3, starts=1, first=near, smoothing=0.0
    )
    assert figures["delta_e"]["max"] < 0.05  # nobody sees a twentieth
    rendered = found.project(lights.values.T) @ found.xyz_from_primaries.T
    np.testing.assert_allclose(rendered, sets.xyz(lights.values.T), rtol=2e-3)


@pytest.mark.parametrize("kind", optimise.KINDS)
def test_a_new_set_is_of_its_kind_and_better_than_the_papers(kind, small):
    found, figures = optimise.new_set(*small, kind=kind, starts=0, first=load("darling2011"))
    assert np.all(np.diff(found.peaks_nm) > 0)
    np.testing.assert_allclose(found.curves.sum(axis=0), 1.0, atol=1e-7)
    assert found.xyz_from_primaries[1].sum() == pytest.approx(1.0, abs=1e-5)
    papers = optimise.figures_of(load("darling2011"), *small)
    assert figures["delta_e"]["mean"] < papers["delta_e"]["mean"]
    if kind == "signed":
        assert figures["least"] < 0.0
    else:
        assert figures["least"] >= 0.0
    if kind == "gaussian":
        shapes = gaussians(found.peaks_nm, found.widths_nm)
        np.testing.assert_allclose(found.curves, shapes, atol=1e-4)


@pytest.mark.slow
def test_a_seed_makes_the_same_set_again(small):
    made = [
        optimise.new_set(*small, kind="gaussian", channels=4, starts=2, seed=seed)[0].digest
        for seed in (3, 3)
    ]
    assert made[0] == made[1]


def test_more_smoothing_makes_smoother_curves(small):
    bends = [
        np.sum(
            np.diff(
                optimise.new_set(*small, channels=3, starts=1, smoothing=s)[0].curves, 2, axis=0
            )
            ** 2
        )
        for s in (0.01, 30.0)
    ]
    assert bends[1] < 0.5 * bends[0]


@pytest.mark.slow
def test_progress_runs_to_its_end(small):
    seen = []
    optimise.new_set(
        *small, kind="gaussian", starts=2, progress=lambda done, of: seen.append((done, of))
    )
    assert [done for done, _ in seen] == list(range(1, seen[-1][1] + 1))


@pytest.mark.slow
def test_cross_validation_is_on_what_was_left_out(small):
    lights, surfaces = small
    rows = optimise.cross_validate(
        lights, surfaces, smoothings=(0.1, 1000.0), channels=3, folds=2, starts=1
    )
    assert [row["smoothing"] for row in rows] == [0.1, 1000.0]
    _, trained = optimise.new_set(lights, surfaces, channels=3, starts=1, smoothing=0.1)
    assert rows[0]["mean"] > trained["delta_e"]["mean"]
    assert rows[1]["mean"] > rows[0]["mean"]


def test_folds_keep_lights_that_are_alike_together():
    values = np.eye(36)[:, [0, 0, 1, 2, 2, 3]] + 1e-3
    groups = optimise._alike(Spectra(WAVELENGTHS, tuple("abcdef"), values))
    fold = optimise._dealt(np.random.default_rng(1), groups, 2)
    assert fold[0] == fold[1]
    assert fold[3] == fold[4]
    assert np.bincount(fold).tolist() == [3, 3]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda v: -v, "'A' is negative"),
        (lambda v: 0.0 * v, "'A' is zero"),
    ],
)
def test_lights_that_are_none_are_refused(small, change, says):
    lights, surfaces = small
    values = lights.values.copy()
    values[:, 0] = change(values[:, 0])
    with pytest.raises(InputError, match=says):
        optimise.new_set(Spectra(WAVELENGTHS, lights.names, values), surfaces)


def test_a_light_without_a_whole_band_is_refused_by_name(small):
    """A low-pressure sodium lamp: one line."""
    lights, surfaces = small
    values = lights.values.copy()
    values[:, 1] = WAVELENGTHS == 590.0
    sodium = Spectra(WAVELENGTHS, (lights.names[0], "sodium", *lights.names[2:]), values)
    with pytest.raises(InputError, match="light 'sodium' has nothing from 430 to 460 nm") as caught:
        optimise.new_set(sodium, surfaces)
    assert len(caught.value.problems) == 1


def test_lamps_that_light_rooms_lack_no_band():
    lights = sets.lights("training+leds8+places5")
    for channels in (3, 6, 12):
        optimise._check_training(lights, sets.surfaces("ces99"), channels)


def test_percent_and_too_few_colours_are_refused(small):
    lights, surfaces = small
    percent = Spectra(WAVELENGTHS, surfaces.names, 100.0 * surfaces.values)
    with pytest.raises(InputError, match="'CES01' reflects"):
        optimise.new_set(lights, percent)
    with pytest.raises(InputError, match="6 lights x 2 surfaces are 12 colours"):
        optimise.new_set(lights, surfaces.only(["CES01", "CES07"]), channels=6)
    with pytest.raises(InputError, match="2 channels"):
        optimise.new_set(lights, surfaces, channels=2)
