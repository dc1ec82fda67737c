"""Reports of fits and of tables: the figures people read are those that scripts get."""

from __future__ import annotations

import pytest
from test_report import words

from calibration import evaluate
from pipeline import report
from pipeline.errors import InputError
from pipeline.fitting import plots


@pytest.mark.slow
def test_the_report_of_a_fit_has_its_figures_and_pictures(tmp_path, sixlight):
    from test_fit_plots import fitted

    made = fitted()
    page = plots.page(made, "M_S.toml")
    seen = words(page)
    figures = made.transform.figures
    assert f"as fitted {figures['training_delta_e']['mean']:.2f}" in seen
    for amplified in figures["noise_amplification"]:
        assert f"{amplified:.1f}" in seen
    for value in made.transform.matrix.ravel():
        assert f"{value:.4g}" in seen
    assert page.count("<svg") == len(plots.figures(made))
    assert "<script" not in page
    assert "mathdefault" not in page
    assert plots.page(made, "M_S.toml") == page


def test_the_report_of_tables_has_every_cell():
    figures = {"n": 24, "mean": 0.123, "sd": 0.456, "max": 7.89, "p90": 1.01}
    paper = {"mean": 1.0, "sd": 2.0, "max": 3.0, "p90": 4.0}
    rows = [
        evaluate.Row(
            1, evaluate.FULL, "XYZ", None, "surfaces <b>", "lights", **figures, paper=paper
        ),
        evaluate.Row(3, evaluate.FULL, "XYZ", None, "surfaces", "lamps", **figures),
    ]
    (first, second) = evaluate.sections(rows)
    assert first.cells[1][-2:] == ["0.12 / 0.46 / 7.89 / 1.01", "1.0 / 2.0 / 3.0 / 4.0"]
    page = report.render("tables.html", title="t", sections=[first, second], pictures=[])
    assert "surfaces <b>" not in page
    seen = words(page)
    for section in (first, second):
        assert section.title in seen
        for cells in section.cells:
            assert all(cell in seen for cell in cells)


def test_a_page_replaces_a_page_and_nothing_else(tmp_path):
    path = tmp_path / "new" / "M_S.html"
    report.check(path)
    report.store(path, report.render("tables.html", title="t", sections=[], pictures=[]))
    report.check(path)
    path.write_text("a diary")
    with pytest.raises(InputError, match="exists and is not ours"):
        report.check(path)
    report.check(path, force=True)
