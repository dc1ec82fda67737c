"""A session's photographs to signals on one scale; whole sessions are in test_fitting.py."""

import numpy as np

from pipeline.fitting import chart
from stages.types import Lights


def test_brackets_whose_scale_is_in_doubt_are_named():
    """One pair of times a bracket, that fits 1/60 and 1/64; and no white of the first light."""
    exposed = Lights((1 / 60, 1 / 15), (1 / 64, 1 / 16), (1 / 60, 1 / 15), (0, 1))
    of_white = Lights((1 / 500, 1 / 125), (1 / 512, 1 / 128), (1 / 500, 1 / 125), (0, 1))
    signals = np.ones((24, 3))
    seen = {
        "A": chart._Seen(signals, signals, (exposed,), ()),
        "D65": chart._Seen(signals, signals, (exposed,), (of_white,)),
    }
    _, (note,) = chart._on_one_scale(seen, ["cyan"])
    assert "A through cyan and D65 through cyan and the white of D65 through cyan may" in note
