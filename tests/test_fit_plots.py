import cv2
import numpy as np
import pytest
import small_capture
from chart_photograph import reflectances

from calibration import chart, primaries, sets
from calibration.bands import sensitivities
from calibration.errors import InputError
from calibration.fit import fit
from calibration.training import TrainingSet
from pipeline.fitting import Fitted, plots

LIGHTS = ("A", "D65")
SIGNED = primaries.load("signed6")


def fitted(kind=chart.COLORCHECKER24):
    """M_S from a chart whose signals are known, one of them left out."""
    channels, bands = sensitivities(small_capture.sensitivities(), small_capture.transmittances())
    read = np.stack([reflectances(kind) * sets.lights("darling2011")[k] for k in LIGHTS])
    signals = read @ bands
    signals[0, 3] = np.nan
    seen = TrainingSet(
        channels=channels,
        lights=LIGHTS,
        signals=signals,
        spectra=read,
        variances=np.zeros(signals.shape),
        counts=np.ones(len(chart.CHARTS[kind])),
        names=chart.CHARTS[kind],
    )
    return Fitted(fit(seen, SIGNED, method="ridge"), SIGNED, chart=seen)


@pytest.mark.slow
@pytest.mark.parametrize("kind", chart.CHARTS)
def test_four_pictures_show_a_chart_fit(tmp_path, kind):
    paths = plots.draw(fitted(kind), tmp_path / "plots")
    assert [path.name for path in paths] == list(plots.PICTURES)
    assert sorted(p.name for p in (tmp_path / "plots").iterdir()) == sorted(plots.PICTURES)
    for path in paths:
        picture = cv2.imread(str(path))
        assert min(picture.shape[:2]) > 300
        assert np.ptp(picture) == 255
    # Each patch is shown in its colour: the chart's red, where it was read under daylight.
    rgb = cv2.imread(str(paths[0]))[..., ::-1].astype(int)
    if kind == chart.COLORCHECKER24:
        assert np.any(np.abs(rgb - (178, 50, 60)).max(axis=-1) < 16)


def test_known_curves_need_no_chart_and_pictures_of_others_are_kept(tmp_path):
    _, bands = sensitivities(small_capture.sensitivities(), small_capture.transmittances())
    known = Fitted(fitted().transform, SIGNED, bands=bands)
    assert [path.name for path in plots.draw(known, tmp_path)] == ["curves.png", "noise.png"]
    plots.check(tmp_path, force=False)  # our own are replaced
    (tmp_path / "noise.png").write_text("a diary")
    with pytest.raises(InputError, match=r"noise\.png: exists and is not ours"):
        plots.check(tmp_path, force=False)
    plots.check(tmp_path, force=True)
