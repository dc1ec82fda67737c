"""The file of a fitted matrix, and the order of its bands."""

from dataclasses import replace

import numpy as np
import pytest
import small_capture

from calibration.errors import InputError
from calibration.fit import fit
from calibration.primaries import Primaries, load
from calibration.training import computed
from calibration.transform import matched, read_transform, to_toml, write_transform

CAMERA = small_capture.sensitivities(), small_capture.transmittances()


@pytest.fixture(scope="module")
def primaries():
    return load()


@pytest.fixture(scope="module")
def known(primaries):
    return fit(computed(*CAMERA), primaries)


def test_m_r_does_not_pass_for_m_s(primaries, tmp_path):
    got = fit(computed(*CAMERA, quantity="reflectance"), primaries)
    write_transform(tmp_path / "M_R.toml", got)
    back = read_transform(tmp_path / "M_R.toml")
    assert back.quantity == "reflectance"
    assert matched(back, got.channels, primaries, "reflectance").channels == got.channels
    with pytest.raises(InputError, match="a matrix for reflectance"):
        matched(back, got.channels, primaries)


def test_a_written_transform_comes_back_the_same(tmp_path, known):
    write_transform(tmp_path / "M_S.toml", known)
    back = read_transform(tmp_path / "M_S.toml")
    np.testing.assert_array_equal(back.matrix, known.matrix)
    for key, value in vars(known).items():
        if key != "matrix":
            assert getattr(back, key) == value, key


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("absolute = false", "", "absolute is missing"),
        ("absolute = false", 'absolute = "no"', "absolute is 'no'"),
        ('"cyan.R",', "", "5 finite numbers"),
        ('"cyan.R",', '"cyan.G",', "finite numbers"),
        ("matrix = [\n    [", "matrix = [\n    [nan, ", "finite numbers"),
        ("matrix = [\n    [", 'matrix = [\n    ["x", ', "gaps or text"),
        ("[primaries]", "[primaries", "not TOML"),
        ("[primaries]", "[other]", "primaries.name is missing"),
    ],
)
def test_a_faulty_file_is_refused_and_named(tmp_path, known, old, new, says):
    text = to_toml(known)
    assert old in text
    path = tmp_path / "M_S.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_transform(path)
    assert says in str(caught.value)
    assert all(line.startswith(f"{path}: ") for line in str(caught.value).splitlines())


def with_signals(known, rows):
    return replace(known, signals=np.random.default_rng(4).lognormal(0, 3, (rows, 6)))


@pytest.mark.parametrize(("rows", "kept"), [(120, 120), (700, 234)])
def test_what_a_chart_sent_is_kept_beside_the_matrix(tmp_path, known, rows, kept):
    made = with_signals(known, rows)
    write_transform(tmp_path / "M_S.toml", made)
    back = read_transform(tmp_path / "M_S.toml")
    assert back.signals.shape == (kept, 6)
    np.testing.assert_allclose(back.signals, made.signals[:: -(-rows // kept)], rtol=5e-4)
    np.testing.assert_array_equal(back.matrix, known.matrix)
    assert len(to_toml(made)) < len(to_toml(known)) + 70 * kept


@pytest.mark.parametrize(
    "rows", ["[[1.0, 2.0]]", "[[nan, 1, 1, 1, 1, 1]]", '"none"', "5", "[[1.0], []]"]
)
def test_faulty_signals_of_a_chart_are_refused(tmp_path, known, rows):
    path = tmp_path / "M_S.toml"
    path.write_text(to_toml(known) + f"\n[chart]\nsignals = {rows}\n")
    with pytest.raises(InputError, match=r"M_S\.toml: chart\.signals are no table"):
        read_transform(path)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"M_S\.toml: no such file"):
        read_transform(tmp_path / "M_S.toml")


def test_bands_in_another_order_are_put_right(known, primaries):
    order = [known.channels[i] for i in (3, 4, 5, 0, 1, 2)]
    got = matched(known, order, primaries)
    assert got.channels == tuple(order)
    np.testing.assert_array_equal(got.matrix[:, 0], known.matrix[:, 3])
    assert got.signals is None
    made = with_signals(known, 30)
    got = matched(made, order, primaries)
    np.testing.assert_array_equal(got.signals[:, 0], made.signals[:, 3])


def test_a_transform_for_other_bands_or_primaries_is_refused(known, primaries):
    other = Primaries("mine", primaries.curves, primaries.xyz_from_primaries * 1.01)
    with pytest.raises(InputError) as caught:
        matched(known, ["red.R", "red.G", "red.B"], other)
    bands, numbers = str(caught.value).splitlines()
    assert "for the bands cyan.R" in bands
    assert "red.R" in bands
    assert f"primaries {primaries.name!r}" in numbers
    assert "'mine'" in numbers
