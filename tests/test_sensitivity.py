"""How far directions move, against the plain mirror formula far away."""

import numpy as np
import pytest

from stages.mirror import Sphere
from stages.sensitivity import sensitivity


def test_a_pixel_of_rim_moves_directions_as_paper_says():
    far = Sphere.from_rim(
        500.0, 400.0, 300.0, radius_mm=50.0, principal_px=(500.0, 400.0), distance_mm=1e6
    )
    moved = sensitivity(far, distance_known=True)["rim +1 px"]
    for ring in (90.0, 135.0):
        sine = np.sin(np.radians(ring / 2.0))  # a pixel at 300 sin(psi / 2) from the centre
        paper = ring - np.degrees(2.0 * np.arcsin(300.0 / 301.0 * sine))
        assert moved[f"{ring:g} degrees"] == pytest.approx(paper, abs=1e-3)


def test_only_what_was_used_can_be_wrong():
    s = Sphere.from_rim(
        500.0, 400.0, 300.0, radius_mm=50.0, principal_px=(500.0, 400.0), distance_mm=800.0
    )
    assert "distance_mm +1 %" in sensitivity(s, distance_known=True)
    assert "focal length +1 %" in sensitivity(s, distance_known=False)
