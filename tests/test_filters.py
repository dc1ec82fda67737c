"""Choosing filters: what must win wins, what cannot help does not, bad input is named."""

import numpy as np
import pytest

from calibration import channels, filters, sets
from calibration.bands import sensitivities
from calibration.errors import InputError
from calibration.fit import fit
from calibration.primaries import load
from calibration.spectra import WAVELENGTHS, Spectra
from calibration.training import computed


def edge(middle_nm, width_nm):
    return 0.9 / (1.0 + np.exp(-(WAVELENGTHS - middle_nm) / width_nm))


@pytest.fixture(scope="module")
def camera():
    return sets.camera("nikon5100")


@pytest.fixture(scope="module")
def candidates():
    """Real shapes, a grey that tells nothing, and one as good as opaque."""
    magenta = np.clip(edge(600.0, 8.0) + edge(480.0, -12.0), 0.0, 1.0)
    green = edge(500.0, 10.0) * edge(590.0, -12.0) / 0.9
    grey, opaque = np.full(36, 0.25), np.full(36, 1e-4)
    columns = [edge(600.0, -22.0), edge(485.0, 9.0), magenta, green, grey, opaque]
    names = ("cyan", "yellow", "magenta", "green", "grey", "opaque")
    return Spectra(WAVELENGTHS, names, np.stack(columns, axis=1))


@pytest.fixture(scope="module")
def lights():
    return sets.lights("darling2011")


@pytest.fixture(scope="module")
def pairs(camera, candidates, lights):
    return filters.rank(
        camera,
        candidates,
        count=2,
        primaries=load("darling2011"),
        lights=lights,
        best=50,
        beside=[("yellow", "cyan"), ("grey", "no filter")],
    )


def test_all_pairs_are_ranked_best_first_but_not_the_opaque(pairs):
    ranking = pairs[:-2]
    assert len(ranking) == 15  # of five that pass light, and no filter
    assert [r.rank for r in ranking] == list(range(1, 16))
    expected = [r.expected_delta_e for r in ranking]
    assert expected == sorted(expected)
    assert not any("opaque" in r.filters for r in ranking)


def test_grey_glass_adds_no_colour(pairs, camera, candidates, lights):
    (single,) = filters.rank(
        camera,
        candidates.only(["grey"]),
        count=1,
        primaries=load("darling2011"),
        lights=lights,
        best=1,
    )
    grey = pairs[-1]
    # The same three bands twice: only their noise is less, by averaging.
    assert grey.rank >= 14
    assert grey.delta_e == pytest.approx(single.delta_e, rel=0.02)
    assert grey.noise_delta_e == pytest.approx(single.noise_delta_e / np.sqrt(2.0), rel=0.05)


def test_stops_are_of_the_darkest_filter(pairs):
    assert pairs[-1].stops == pytest.approx(2.0)  # a quarter passes


def test_what_is_asked_for_beside_the_best_comes_last_with_its_rank(pairs):
    asked = pairs[-2]
    assert asked.filters == ("cyan", "yellow")
    assert asked in pairs[:-2]


def test_the_left_out_error_is_that_of_fitting_without_the_light(camera, candidates, lights):
    """The same from samples, one by one: ridge from all other lights, then the light left out."""
    primaries, glass = load("darling2011"), candidates.only(["magenta", "green"])
    some, paints = lights.only(["A", "D65", "F2", "F8", "F11"]), sets.surfaces("colorchecker24")
    *_, ranked = filters.rank(
        camera, glass, count=2, primaries=primaries, lights=some, surfaces=paints,
        beside=[("magenta", "green")],
    )  # fmt: skip
    _, bands = sensitivities(camera, glass)
    white = np.ones((36, 1))
    walls = Spectra(
        WAVELENGTHS,
        (*paints.names, "white"),
        np.concatenate([paints.values, white], axis=1),
    )
    weights = np.append(np.ones(24), 0.2 * 24)
    errors = []
    for left_out in some.names:
        kept = some.only(name for name in some.names if name != left_out)
        radiances = np.einsum("wl,ws->lsw", kept.values, walls.values).reshape(-1, 36)
        w = np.tile(weights, 4)[:, None]
        signals = radiances @ bands
        noise = np.diag((w * (0.01 * signals) ** 2).sum(axis=0))
        M_S = np.linalg.solve(
            (w * signals).T @ signals + noise, (w * signals).T @ (radiances @ primaries.curves)
        ).T
        seen = channels.Channels(bands @ M_S.T, primaries.curves, primaries.xyz_from_primaries)
        errors.append(seen.errors(some.only([left_out]), walls))
    assert ranked.delta_e == pytest.approx(np.mean(errors), rel=1e-3)  # the noise has a floor


def test_noise_is_amplified_as_the_fit_says(camera, candidates):
    ranked = filters.rank(
        camera, candidates, count=2, primaries=load("darling2011"), best=1,
        lights=sets.lights("room"), beside=[("cyan", "yellow")],
    )[-1]  # fmt: skip
    made = fit(
        computed(camera, candidates.only(["cyan", "yellow"])),
        load("darling2011"),
        method="ridge",
        noise_level=filters.NOISE_LEVEL,
    )
    assert ranked.amplification == pytest.approx(max(made.figures["noise_amplification"]), rel=0.05)


def test_a_third_filter_helps(camera, candidates, pairs, lights):
    triples = filters.rank(
        camera, candidates, count=3, primaries=load("darling2011"), lights=lights, best=1
    )
    assert triples[0].expected_delta_e < pairs[0].expected_delta_e


@pytest.mark.parametrize(
    ("count", "names", "message"),
    [
        (4, ["cyan"], "4 filters"),
        (3, ["cyan", "opaque"], "2 candidates that pass light"),
    ],
)
def test_what_cannot_be_ranked_is_refused(camera, candidates, count, names, message):
    with pytest.raises(InputError, match=message):
        filters.rank(camera, candidates.only(names), count=count, primaries=load("darling2011"))


def test_an_unknown_combination_is_named(camera, candidates):
    with pytest.raises(InputError, match="'blue'"):
        filters.rank(
            camera, candidates, count=2, primaries=load("darling2011"), beside=[("blue", "cyan")]
        )
