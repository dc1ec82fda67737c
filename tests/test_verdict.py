"""Captures spoilt in the ways captures are spoilt, and one that is not: each is told from the rest.

They are traced from the same world as the small capture, so that nothing but what is named is wrong
with them.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_capture
import sphere_tracer
from conftest import QUICK
from small_capture import CAMERA, world

from calibration import primaries
from calibration.fit import fit
from calibration.spectra import WAVELENGTHS
from calibration.training import computed
from calibration.transform import write_transform
from pipeline import cli
from pipeline.verdict import GOOD, verdict

FOCAL_MM = 50.0


def with_lens(folder: Path, *, room="distant = true", **sphere) -> None:
    """The small capture.toml, with the lens it was traced with."""
    table = {"radius_mm": small_capture.RADIUS_MM, "distance_mm": small_capture.DISTANCE_MM}
    lines = [f"{key} = {value}" for key, value in (table | sphere).items()]
    pitch_um = 1000 * FOCAL_MM / CAMERA.focal_px
    (folder / "capture.toml").write_text(
        "\n".join(
            [
                "[sphere]",
                *lines,
                'material = "stainless steel"',
                f"[camera]\nfocal_length_mm = {FOCAL_MM}\npixel_pitch_um = {pitch_um}",
                f"[room]\n{room}" if room else "",
                '[calibration]\ncamera = "C.csv"\nfilters = "F.csv"',
            ]
        )
    )


def nothing(folder: Path) -> None:
    pass


def underexposed(folder: Path) -> None:
    rng = np.random.default_rng(1)
    for name in small_capture.SHIFTS:
        small_capture.shoot(folder, name, rng, level=0.9 / 60)


def clipped_lamp(folder: Path) -> None:
    lamp = np.array([0.6, 0.2, 0.77]) / np.linalg.norm([0.6, 0.2, 0.77])

    def lit(d):
        return world(d) + 3000.0 * (d @ lamp > np.cos(np.radians(4)))[:, None]

    rng = np.random.default_rng(2)
    for name in small_capture.SHIFTS:
        small_capture.shoot(folder, name, rng, world=lit)


def ball_moved_between_the_filters(folder: Path) -> None:
    moved = sphere_tracer.Camera.seeing(
        157.3 + 7, 113.6 - 3, 88.0, *small_capture.SIZE, small_capture.DISTANCE_MM
    )
    small_capture.shoot(folder, "yellow", np.random.default_rng(3), camera=moved)


def another_glass_in_front_of_the_lens(folder: Path) -> None:
    magenta = 0.9 - 0.8 * np.exp(-0.5 * ((WAVELENGTHS - 540) / 30) ** 2)
    small_capture.shoot(folder, "yellow", np.random.default_rng(4), glass=magenta)


def light_that_drifted(folder: Path) -> None:
    def cloudy(d):  # daylight comes from -X, and fell by a third
        daylight = 1.0 / (1.0 + np.exp(4.0 * (d[:, :1] + 0.3)))
        return world(d) * (1.0 - daylight / 3.0)

    small_capture.shoot(folder, "yellow", np.random.default_rng(5), world=cloudy)


def wrong_radius(folder: Path) -> None:
    with_lens(folder, radius_mm=57.0)


def near_room(folder: Path) -> None:
    with_lens(folder, room="")


def stale_transform(folder: Path) -> None:
    """M_S of a session of which a measurement was corrected since."""
    training = computed(
        small_capture.sensitivities(),
        small_capture.transmittances(),
        filter_names=list(small_capture.SHIFTS),
    )
    fitted = fit(training, primaries.load())
    session = folder / "session" / "A"
    session.mkdir(parents=True)
    before, now = b"wavelength_nm,1\n400,1\n", b"wavelength_nm,1\n400,2\n"
    (session / "radiance.csv").write_bytes(now)
    inputs = {"A/radiance.csv": hashlib.sha256(before).hexdigest()}
    write_transform(folder / "M_S.toml", replace(fitted, inputs=inputs))
    toml = folder / "capture.toml"
    toml.write_text(
        toml.read_text().replace('camera = "C.csv"\nfilters = "F.csv"', 'transform = "M_S.toml"')
    )


SPOILT = {
    underexposed: "underexposed",
    clipped_lamp: "clipped",
    ball_moved_between_the_filters: "sphere moved",
    another_glass_in_front_of_the_lens: "filters",
    light_that_drifted: "drift",
    wrong_radius: "radius",
    near_room: "near room",
    stale_transform: "stale M_S",
}


def verdict_on(folder: Path) -> dict:
    out = folder.parent / "out"
    assert cli.status(["envmap", str(folder), "-o", str(out), *QUICK]) == 0
    return json.loads((out / "result.json").read_text())["verdict"]


@pytest.mark.slow
def test_a_good_capture_is_good(small):
    with_lens(small)
    assert verdict_on(small) == {"grade": GOOD, "findings": []}


@pytest.mark.slow
@pytest.mark.parametrize("spoil", SPOILT, ids=lambda spoil: spoil.__name__)
def test_a_spoilt_capture_is_told_with_its_reason(small, spoil):
    with_lens(small)
    spoil(small)
    found = verdict_on(small)
    assert found["grade"] != GOOD
    assert found["findings"][0]["about"] == SPOILT[spoil], found


@pytest.mark.parametrize(
    ("times", "grades"), [(1.0, set()), (20.0, {"look here"}), (100.0, {"do not trust"})]
)
def test_a_rim_known_only_roughly_is_told(finished_once, times, grades):
    """The small sphere's: 88 px, so that a pixel moves directions by over a degree."""
    result = json.loads((finished_once / "result.json").read_text())
    learnt = result["steps"]["locate"]["learnt"]
    learnt["rim_sigma_px"] = [times * 0.03] * 3
    assert {f["grade"] for f in verdict(result)["findings"] if f["about"] == "rim"} == grades
