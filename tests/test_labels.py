"""Names of columns in scripts that the default font lacks: pictures without warnings, with an installed font or with the role."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen
from matplotlib import font_manager
from matplotlib.figure import Figure

from hystfit.data import Record
from hystfit.results.labels import column_label, substitute_missing_glyphs, use_available_fonts, write
from hystfit.results.preisach_plots import plot_curves

CHARACTERS = "电压位移記録"


@pytest.fixture
def font(tmp_path: Path) -> Iterator[str]:
    """A font that has some Chinese characters, known to matplotlib for one test."""
    box = TTGlyphPen(None)
    for move, point in (
        (box.moveTo, (50, 0)),
        (box.lineTo, (50, 700)),
        (box.lineTo, (650, 700)),
        (box.lineTo, (650, 0)),
    ):
        move(point)
    box.closePath()
    names = [".notdef", *(f"uni{ord(c):04X}" for c in CHARACTERS)]
    builder = FontBuilder(1000, isTTF=True)
    builder.setupGlyphOrder(names)
    builder.setupCharacterMap({ord(c): f"uni{ord(c):04X}" for c in CHARACTERS})
    glyph = box.glyph()
    builder.setupGlyf(dict.fromkeys(names, glyph))
    builder.setupHorizontalMetrics(dict.fromkeys(names, (700, 50)))
    builder.setupHorizontalHeader(ascent=800, descent=-200)
    builder.setupNameTable({"familyName": "Test CJK", "styleName": "Regular"})
    builder.setupOS2(sTypoAscender=800, sTypoDescender=-200, usWinAscent=800, usWinDescent=200)
    builder.setupPost()
    path = tmp_path / "test.ttf"
    builder.save(path)
    known = list(font_manager.fontManager.ttflist)
    font_manager.fontManager.addfont(path)
    yield "Test CJK"
    font_manager.fontManager.ttflist[:] = known


@pytest.fixture
def bare() -> Iterator[None]:
    """Only the fonts that come with matplotlib."""
    known = list(font_manager.fontManager.ttflist)
    font_manager.fontManager.ttflist[:] = [entry for entry in known if "mpl-data" in entry.fname]
    yield
    font_manager.fontManager.ttflist[:] = known


def _drawn(figure: Figure, folder: Path) -> None:
    """Draw with warnings as errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(folder / "a.png")
        figure.savefig(folder / "a.svg")


def test_names_without_a_font_are_replaced_by_their_role(bare: None, tmp_path: Path) -> None:
    ax = Figure().subplots()
    column_label(ax, "x", "电压_V", "V", "input")
    column_label(ax, "y", "位移", "微米", "output")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("input [V]", "output")
    _drawn(ax.figure, tmp_path)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["τάση", "напряжение", "Spannung", "H µ₀"])
def test_names_that_the_default_font_has_are_kept(name: str, bare: None, tmp_path: Path) -> None:
    ax = Figure().subplots()
    column_label(ax, "x", name, "kV", "input")
    assert ax.get_xlabel() == f"{name} [kV]"
    assert ax.xaxis.label.get_fontfamily() == ["sans-serif"]
    _drawn(ax.figure, tmp_path)  # type: ignore[arg-type]


def test_an_installed_font_is_used_for_the_characters_that_it_has(bare: None, font: str, tmp_path: Path) -> None:
    ax = Figure().subplots()
    column_label(ax, "x", "电压", "V", "input")
    column_label(ax, "y", "磁矩", "emu", "output")  # not in the font
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("电压 [V]", "output [emu]")
    assert ax.xaxis.label.get_fontfamily() == ["sans-serif", font]
    _drawn(ax.figure, tmp_path)  # type: ignore[arg-type]


def test_names_of_records_in_ticks_and_titles_are_legible(bare: None, tmp_path: Path) -> None:
    ax = Figure().subplots()
    ax.set_yticks([0, 1], [substitute_missing_glyphs("offset@記録"), "gain"])
    ax.set_title("記録 1")
    write(ax.xaxis.label, "位移", "output")
    use_available_fonts(ax.figure)
    assert [ax.get_title(), ax.get_yticklabels()[0].get_text(), ax.get_xlabel()] == ["?? 1", "offset@??", "output"]
    _drawn(ax.figure, tmp_path)  # type: ignore[arg-type]


def test_pictures_of_curves_with_chinese_names(bare: None, tmp_path: Path) -> None:
    u = np.linspace(0.0, 1.0, 9)
    records = [Record(u, u**k, u_name="电压", y_name="位移", u_unit="V", y_unit="um", name=f"曲线 {k}") for k in (1, 2)]
    ax = plot_curves(records, ax=Figure().subplots())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("input [V]", "output [um]")
    _drawn(ax.figure, tmp_path)


def test_numbers_of_a_field_do_not_touch():
    """Fields to 20000 Oe at the size of the pictures of a report."""
    figure = Figure(layout="constrained")
    ax = figure.subplots()
    ax.plot([-20000, 20000], [0, 1])
    column_label(ax, "x", "Field", "Oe", "input")
    figure.canvas.draw()
    boxes = [label.get_window_extent() for label in ax.get_xticklabels() if label.get_text()]
    assert all(left.x1 + 4 < right.x0 for left, right in itertools.pairwise(boxes))
