"""What a shoot shares: found, merged under each capture's own, blamed by its file's name."""

from __future__ import annotations

import os

import pytest

from pipeline import capture as captures
from pipeline import defaults
from pipeline.errors import InputError


@pytest.fixture
def shot(small):
    """A small capture with nothing of its own but photographs; and its shoot's folder."""
    shoot = small.parent / "shoot"
    (shoot / "week").mkdir(parents=True)
    inside = shoot / "week" / "small"
    small.rename(inside)
    for name in ("C.csv", "F.csv"):
        (inside / name).rename(shoot / name)
    (inside / "capture.toml").rename(shoot / "defaults.toml")
    text = (shoot / "defaults.toml").read_text()
    (shoot / "defaults.toml").write_text(text.replace('name = "small"\n', ""))
    return shoot, inside


def test_all_may_be_said_once_for_a_shoot(shot):
    shoot, inside = shot
    loaded = captures.load(inside)
    assert (loaded.sphere.radius_mm, loaded.sphere.distance_mm) == (50.0, 1500.0)
    assert loaded.calibration.camera.resolve() == (shoot / "C.csv").resolve()
    assert loaded.transform is not None
    assert any("../../defaults.toml" in note for note in loaded.notes)


def test_the_nearest_wins_key_by_key(shot):
    shoot, inside = shot
    (shoot / "week" / "defaults.toml").write_text("[sphere]\nradius_mm = 40\ndistance_mm = 900\n")
    (inside / "capture.toml").write_text("[sphere]\nradius_mm = 30\n")
    sphere = captures.load(inside).sphere
    assert (sphere.radius_mm, sphere.distance_mm) == (30.0, 900.0)
    assert sphere.material == "stainless steel"  # of the folder above


@pytest.mark.parametrize(
    ("shared", "own", "expected"),
    [
        (
            {"calibration": {"camera": "C.csv", "filters": "F.csv", "primaries": "signed6"}},
            {"calibration": {"transform": "M_S.toml"}},
            {"calibration": {"transform": "M_S.toml", "primaries": "signed6"}},
        ),
        (
            {"room": {"size_m": [1, 2, 3], "sphere_m": [0.5, 1, 1]}},
            {"room": {"distant": True}},
            {"room": {"distant": True}},
        ),
        (
            {"room": {"distant": True}},
            {"room": {"size_m": [1, 2, 3]}},
            {"room": {"size_m": [1, 2, 3]}},
        ),
    ],
    ids=["transform", "distant", "walls"],
)
def test_what_is_said_in_one_way_is_not_given_the_other_besides(tmp_path, shared, own, expected):
    import tomli_w

    file = tmp_path / "defaults.toml"
    file.write_text(tomli_w.dumps(shared))
    problems: list = []
    content, _ = defaults.under(own, tmp_path / "a" / "capture.toml", [file], problems)
    assert (content, problems) == (expected, [])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[sphere]\nradius_mm = -5\ndistance_mm = 1500\n", "sphere.radius_mm is -5"),
        ('[calibration]\ncamera = "../C.csv"\nfilters = "F.csv"\n', "a path inside"),
        ('[calibration]\ntransform = "link.toml"\n', "a path inside"),
        ('[calibration]\nprimaries = "../.."\n', "a path inside"),
        ("[sphere]\ncolour = 1\n", "sphere.colour is not known here"),
        ('name = "all"\n', "tables that captures share"),
        ('[[filter]]\nname = "cyan"\n', "tables that captures share"),
        ("[sphere\n", "not TOML"),
    ],
    ids=["number", "path", "link", "folder", "unknown", "name", "filters", "no TOML"],
)
def test_what_is_wrong_names_the_file_it_is_in(shot, sixlight, text, said):
    shoot, inside = shot
    (shoot.parent / "outside.toml").write_text("")
    (shoot / "link.toml").symlink_to(shoot.parent / "outside.toml")
    (shoot / "defaults.toml").write_text(text)
    (inside / "capture.toml").write_text("[sphere]\nradius_mm = 30\ndistance_mm = 900\n")
    if "radius_mm = -5" in text:
        (inside / "capture.toml").unlink()
    outcome = sixlight("inspect", inside)
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1, outcome.err
    assert outcome.err.startswith(f"{shoot.resolve() / 'defaults.toml'}: ")
    assert said in outcome.err


def test_wrong_values_of_the_capture_still_name_its_own_file(shot):
    _, inside = shot
    (inside / "capture.toml").write_text("[sphere]\nradius_mm = -1\n")
    with pytest.raises(InputError) as caught:
        captures.load(inside)
    assert [str(p.file) for p in caught.value.problems] == [str(inside / "capture.toml")]


def test_no_further_up_than_home(shot, monkeypatch):
    shoot, inside = shot
    assert defaults.above(inside) == [shoot.resolve() / "defaults.toml"]
    monkeypatch.setenv("HOME", str(shoot / "week"))
    assert defaults.above(inside) == []


@pytest.mark.skipif(os.geteuid() != 0, reason="giving files away takes root")
def test_what_others_left_above_says_nothing(shot):
    shoot, inside = shot
    os.chown(shoot, 12345, -1)
    assert defaults.above(inside) == []
    os.chown(shoot, 0, -1)
    os.chown(shoot / "defaults.toml", 12345, -1)
    assert defaults.above(inside) == []
