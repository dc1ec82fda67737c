"""Captures of several views: what capture.toml may say, and the job on three small ones."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import small_capture
import small_views
from conftest import QUICK
from scipy.spatial.transform import Rotation

from calibration import primaries
from calibration.errors import InputError
from pipeline import capture as captures
from pipeline import cli, io
from pipeline.steps import files_of
from stages import cube
from stages.orient import Place


def test_files_of_one_view_among_several_are_named_by_it_in_work():
    def files(name, views=(None,)):
        return files_of(name, filters=["cyan", "yellow"], channels=6, views=views)

    assert files("cubemap{view}.exr") == ["cubemap.exr"]
    assert files("cubemap{view}.exr", ["left"]) == ["work/cubemap_left.exr"]
    assert files("work/{sphere}{view}.json") == ["work/sphere.json"]
    assert files("work/{sphere}{view}.json", ["left"]) == ["work/oriented_left.json"]
    assert files("work/image{view}_{filter}.exr", ["a", "b"]) == [
        "work/image_a_cyan.exr",
        "work/image_a_yellow.exr",
        "work/image_b_cyan.exr",
        "work/image_b_yellow.exr",
    ]


# ------------------------------------------------------------------------------------- capture.toml


@pytest.fixture(scope="module")
def photographs(tmp_path_factory) -> Path:
    """Two views without a world: front/ and right/, two filters of two exposures each."""
    folder = tmp_path_factory.mktemp("captures") / "two"
    rng = np.random.default_rng(1)
    for view in ("front", "right"):
        for name in ("cyan", "yellow"):
            (folder / view / name).mkdir(parents=True)
            for i, tag in enumerate([(1, 60), (1, 15)]):
                raw = rng.integers(600, 9000, (62, 94)).astype(np.uint16)
                small_capture.write_shot(folder / view / name / f"{i}.dng", raw, tag)
    return folder


@pytest.fixture
def told(photographs, tmp_path):
    """Reads the capture with what capture.toml then says: told('[[view]] ...') -> Capture."""

    def read(views: str, sphere: str = "radius_mm = 50.0\ndistance_mm = 1500.0"):
        folder = tmp_path / "two"
        if not folder.exists():
            shutil.copytree(photographs, folder)
        material = 'material = "silver"'
        (folder / "capture.toml").write_text(f"[sphere]\n{material}\n{sphere}\n{views}")
        return captures.load(folder)

    return read


FRONT, RIGHT = '[[view]]\nname = "front"\n', '[[view]]\nname = "right"\n'


def test_views_are_read_from_folders_of_their_names(told):
    capture = told(f"{FRONT}{RIGHT}yaw_deg = 120.0\npitch_deg = 5\ndistance_mm = 1400.0\n")
    assert [name for name, _ in capture.brackets] == [
        "front cyan",
        "front yellow",
        "right cyan",
        "right yellow",
    ]
    assert len(capture.shots) == 8
    first, second = capture.views
    assert (first.place, second.place) == (None, Place(120.0, 5.0))
    assert (first.sphere.distance_mm, second.sphere.distance_mm) == (1500.0, 1400.0)
    alone = capture.of_view("right")
    assert alone.sphere.distance_mm == 1400.0
    assert alone.brackets_before == 2
    assert {shot.path.parent.parent.name for shot in alone.shots} == {"right"}
    assert capture.bands == alone.bands
    assert any("not joined" in note for note in capture.notes)  # without a calibration


def test_one_view_is_a_capture_as_ever(told):
    capture = told(FRONT)
    assert capture.views == ()
    assert len(capture.shots) == 4


def test_views_may_name_their_files(told):
    own = "".join(
        f'[[view]]\n[[view.filter]]\nname = "{a}"\nfiles = "{v}/{a}/*"\n'
        f'[[view.filter]]\nname = "{b}"\nfiles = "{v}/{b}/*"\n'
        for v, a, b in (("front", "cyan", "yellow"), ("right", "cyan", "yellow"))
    )
    assert [view.name for view in told(own).views] == ["view1", "view2"]


@pytest.mark.parametrize(
    ("views", "line"),
    [
        (
            f"{FRONT}{FRONT}",
            "view[2].name is 'front' again (expected each view once); merge or rename them",
        ),
        (
            f'{FRONT}[[view]]\nname = "no such"\n',
            "view[2].name is 'no such' (expected letters, digits, hyphens and underscores); "
            "rename it",
        ),
        (
            f'{FRONT}[[view]]\nname = "left"\n',
            "view[2].filter is missing (expected [[view.filter]] tables, or a folder left/ with "
            "one a filter); add them",
        ),
        (
            f"{FRONT}{RIGHT}colour = 3\n",
            "view[2].colour is not known here (expected one of distance_mm, filter, mask, name, "
            "outline, pitch_deg, yaw_deg); correct or remove it",
        ),
        (
            f"{FRONT}yaw_deg = 30.0\n{RIGHT}",
            "view[1].yaw_deg is 30, pitch_deg 0 (expected 0, or nothing: the others' places are "
            "counted from it); remove it",
        ),
        (
            f"{FRONT}{RIGHT}pitch_deg = 100.0\n",
            "view[2].pitch_deg is 100.0 (expected a number in degrees, -90 to 90); correct it",
        ),
        (
            f"{FRONT}{RIGHT}distance_mm = 20.0\n",
            "view[2].distance_mm is 20 (expected well above radius_mm 50); correct it",
        ),
        (
            f"{FRONT}{RIGHT}outline = [40.0, 30.0, 50.0]\n",
            "view[2].outline is [40.0, 30.0, 50.0] (expected a circle inside the 94 x 62 "
            "photograph); correct it or photograph again",
        ),
        (
            f'{FRONT}{RIGHT}[[filter]]\nname = "cyan"\n',
            "filter is given beside [[view]] (expected each [[filter]] under a view, as "
            "[[view.filter]]); move it there",
        ),
        (
            f'{FRONT}{RIGHT}[[view.filter]]\nname = "yellow"\nfiles = "right/yellow/*"\n'
            '[[view.filter]]\nname = "cyan"\nfiles = "right/cyan/*"\n',
            "view[2].filter is yellow, cyan (expected cyan, yellow, as of 'front', in that order); "
            "correct it",
        ),
    ],
)
def test_what_is_wrong_with_a_view_is_said_in_a_line(told, tmp_path, views, line):
    with pytest.raises(InputError) as error:
        told(views)
    assert str(error.value) == f"{tmp_path / 'two' / 'capture.toml'}: {line}"


def test_an_outline_for_all_views_is_refused(told):
    with pytest.raises(InputError, match=re.escape("its own in each [[view]]")):
        told(
            f"{FRONT}{RIGHT}",
            "radius_mm = 50.0\ndistance_mm = 1500.0\noutline = [40.0, 30.0, 20.0]",
        )


# -------------------------------------------------------------------------------------- the whole


@pytest.fixture(scope="session")
def three(tmp_path_factory):
    """Three small views, processed: the results' folder, and result.json."""
    folder = small_views.make(tmp_path_factory.mktemp("captures") / "three")
    out = tmp_path_factory.mktemp("finished") / "three"
    assert cli.status(["envmap", str(folder), "-o", str(out), *QUICK]) == 0
    return out, json.loads((out / "result.json").read_text())


@pytest.mark.slow
@pytest.mark.xdist_group("three")  # of what takes a minute to make
def test_three_small_views_are_brought_into_one_world(three):
    _, result = three
    for name, view in result["steps"]["orient"]["learnt"]["views"].items():
        turn = np.array(view["turn"]) @ small_views.TURNS[name].T
        # A sphere 176 px across is found to a tenth of a pixel, which is a tenth of a degree.
        assert np.degrees(Rotation.from_matrix(turn).magnitude()) < 0.15
        assert view["gain"] == pytest.approx(1.0, abs=0.005)
    assert not [note for note in result["notes"] if "light" in note]


@pytest.mark.slow
@pytest.mark.xdist_group("three")  # of what takes a minute to make
def test_the_joined_map_is_the_world_without_photographers(three):
    out, _ = three
    light, _ = io.read_measured(out / "cubemap.exr", cube=True)
    assert (light.valid == 1).all()
    n = light.values.shape[1]
    directions = cube.directions(n)
    spectral = small_views.world(directions.reshape(-1, 3))
    truth = primaries.load().project(spectral).reshape(light.values.shape)
    usual = np.median(light.values / truth, axis=(0, 1, 2))  # off by what the calibration is
    error = np.abs(light.values / truth / usual - 1.0).max(axis=-1)
    assert np.median(error) < 0.015
    for name, turn in small_views.TURNS.items():
        before = small_views.someone(directions.reshape(-1, 3) @ turn).reshape(6, n, n)
        alone, _ = io.read_measured(out / "work" / f"cubemap_{name}.exr", cube=True)
        off = np.abs(alone.values / truth / usual - 1.0).max(axis=-1)
        assert np.nanmedian(off[before]) > 0.5  # there they stand
        assert np.quantile(error[before], 0.9) < 0.05
