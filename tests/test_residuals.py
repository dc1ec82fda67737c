import numpy as np

from calibration import primaries, residuals, sets
from calibration.training import TrainingSet

PATCHES = tuple(map(str, range(1, 25)))
LIGHTS = ("A", "D65", "F11")
PRIMARIES = primaries.load("darling2011")


def chart_seen_by(bands):
    """The chart as a camera with these bands (36, B) sees it."""
    reflectances = sets.surfaces("colorchecker24").values.T
    read = np.stack([reflectances * sets.lights("darling2011")[light] for light in LIGHTS])
    return TrainingSet(
        channels=tuple("abcdef"[: bands.shape[1]]),
        lights=LIGHTS,
        signals=read @ bands,
        spectra=read,
        variances=np.zeros((*read.shape[:2], bands.shape[1])),
        counts=np.ones(len(PATCHES)),
        names=PATCHES,
    )


def test_what_is_seen_as_the_eye_sees_it_is_not_off():
    chart = chart_seen_by(sets.observer())
    eye = np.linalg.pinv(PRIMARIES.xyz_from_primaries)  # XYZ to primaries and back is XYZ
    off = residuals.residuals(eye, chart, PRIMARIES)
    np.testing.assert_allclose(off.delta_e, 0.0, atol=1e-6)
    # The white is patch 19, and it is white: L* = 100, no chroma.
    assert chart.white.tolist() == [18, 18, 18]
    np.testing.assert_allclose(off.read[:, 18], [[100.0, 0.0, 0.0]] * 3, atol=1e-9)


def test_a_patch_left_out_is_not_known_and_never_the_white_or_the_worst():
    chart = chart_seen_by(sets.observer())
    chart.signals[1, 18, 0] = np.nan
    eye = np.linalg.pinv(PRIMARIES.xyz_from_primaries)
    off = residuals.residuals(1.05 * eye, chart, PRIMARIES)
    assert np.argwhere(np.isnan(off.delta_e)).tolist() == [[1, 18]]
    assert chart.white.tolist() == [18, 15, 18]  # the next brightest, yellow
    worst = off.worst(1, 24)
    assert len(worst) == 23
    assert "19" not in dict(worst)
    assert [value for _, value in worst] == sorted(dict(worst).values(), reverse=True)


def test_the_curves_of_a_camera_that_sees_in_primaries_are_the_primaries():
    wide = primaries.gaussians(np.array([450.0, 540.0, 620.0]), np.array([25.0, 30.0, 25.0]))
    curves, uncertain = residuals.made_curves(np.eye(3), chart_seen_by(wide))
    top = wide.max(axis=0)
    # From 24 patches under three lamps a curve is known to a few hundredths, and it says so.
    assert np.sqrt(np.mean(((curves - wide) / top) ** 2)) < 0.03
    assert np.all(uncertain > 0.0)
    doubled, _ = residuals.made_curves(2 * np.eye(3), chart_seen_by(wide))
    np.testing.assert_allclose(doubled, 2 * curves)
