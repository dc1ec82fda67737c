"""The report says what result.json says, in one page that asks for nothing and runs nothing."""

from __future__ import annotations

import copy
import html
import json
import re

import pytest

from pipeline.report import envmap
from pipeline.verdict import learnt, verdict


@pytest.fixture(scope="session")
def result(finished_once):
    return json.loads((finished_once / "result.json").read_text())


@pytest.fixture(scope="session")
def page(finished_once):
    return (finished_once / "report.html").read_text()


def words(page: str) -> str:
    """What a reader sees, without the drawings."""
    text = re.sub(r"<(style|svg)\b.*?</\1>", " ", page, flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", text)).split())


def test_figures_are_those_of_result_json(page, result):
    seen = words(page)
    assert result["verdict"]["grade"].capitalize() in seen
    for finding in result["verdict"]["findings"]:
        assert finding["found"] in seen
    steps = result["steps"]
    x, y = steps["align"]["learnt"]["shifts"][1]
    assert f"{x:.3f} {y:.3f}" in seen
    for light in steps["illuminants"]["learnt"]["lights"]:
        assert f"{100 * light['share']:.1f} %" in seen
        assert f"{light['xy'][0]:.4f} {light['xy'][1]:.4f}" in seen
    for value in steps["normalise"]["learnt"]["white_delta_e_noise"]["facing"].values():
        assert f"{value:.2f}" in seen
    for name, told in learnt(result, "merge").items():
        gain, read = told["noise_gain_and_read"][0]
        assert f"{name} {1 / gain:.0f} {read / gain:.1f}" in seen
    for name, digest in result["inputs"].items():
        assert f"{name} {digest}" in seen


def test_the_page_asks_for_nothing_and_runs_nothing(page):
    assert "<script" not in page
    assert "default-src 'none'" in page
    linked = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]*)""", page)
    assert all(link.startswith(("data:", "#")) for link in linked), linked
    assert not re.search(r"\son\w+\s*=", page)


def test_a_hostile_name_stays_text(finished_once, result):
    hostile = copy.deepcopy(result)
    hostile["name"] = name = "<script>alert('$x_1$')</script>\N{RIGHT-TO-LEFT OVERRIDE}&amp;"
    merged = hostile["steps"].pop("merge cyan")
    hostile["steps"]["merge <img src=x>"] = merged
    hostile["capture"]["filters"][0] = hostile["capture"]["brackets"][0]["name"] = "<img src=x>"
    lost = hostile["steps"]["unwrap"]["learnt"]["lost"]
    lost["<img src=x>"] = lost.pop("cyan")
    page = envmap.page(finished_once, hostile)
    assert "<script" not in page
    assert "<img src=x" not in page
    assert html.escape(name, quote=True).replace("&#x27;", "&#39;") in page


def test_the_same_result_gives_the_same_page(finished_once, result, page):
    assert envmap.page(finished_once, result) == page


@pytest.mark.slow
def test_a_capture_without_calibration_has_a_report_too(small, tmp_path, sixlight):
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().split("[calibration]")[0])
    out = tmp_path / "out"
    assert sixlight("envmap", small, "-o", out, "--quiet").status == 0
    seen = words((out / "report.html").read_text())
    assert "there is no calibration" in seen


def test_the_worst_finding_is_the_grade_and_stands_first(result):
    spoilt = copy.deepcopy(result)
    assert verdict(spoilt) == result["verdict"]
    spoilt["steps"]["align"]["learnt"]["error_px"] = [0.0, 0.4]
    spoilt["steps"]["unwrap"]["learnt"]["lost"]["cyan"]["of_light"] = 0.1
    told = verdict(spoilt)
    assert told["grade"] == "do not trust"
    assert told["findings"][0]["about"] == "clipped"
    assert "sphere moved" in [f["about"] for f in told["findings"]]
