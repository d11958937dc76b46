"""HTML pages of all verbs in one style: self-contained, with pictures that enlarge, for screen, phone, dark mode and print."""

from __future__ import annotations

import base64
import dataclasses
import functools
import html
import io
import json
import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hystfit.outcome import Note, Table

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Picture:
    """A figure of matplotlib on a page; the caption is also its text for readers who do not see it.

    A `wide` one, of several panels, is as wide as the page; `name` is that of the same picture as a file beside the page, "" for none.
    """

    figure: Figure
    caption: str
    wide: bool = False
    name: str = ""

    @functools.cached_property
    def svg(self) -> bytes:
        """The figure as vector graphics, laid out once."""
        return svg(self.figure)

    def write_png(self, folder: Path) -> None:
        """Write the figure as NAME.png; the page shows it as it is laid out here."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.figure.dpi = 150
        FigureCanvasAgg(self.figure).print_png(folder / f"{self.name}.png", pil_kwargs={"compress_level": 1})
        self.figure.dpi = 100
        self.figure.set_layout_engine("none")

    def html(self) -> str:
        """As vector graphics within the page."""
        source = base64.b64encode(self.svg).decode("ascii")
        panels = html.escape(json.dumps(_panels(self.figure)), quote=True)
        words, mark = html.escape(self.caption, quote=True), ' class="wide"' if self.wide else ""
        return (
            f'<figure{mark}><img alt="{words}" tabindex="0" data-panels="{panels}" src="data:image/svg+xml;base64,{source}">'
            f"<figcaption>{words}</figcaption></figure>"
        )


@dataclasses.dataclass(frozen=True)
class Markup:
    """HTML as it is."""

    html: str


Block = str | Table | Markup | Sequence[Note | str] | Sequence[Picture]


@dataclasses.dataclass(frozen=True)
class Page:
    """A page: a sentence on its status, what a reader came for as names and values, and sections of blocks.

    "Next" in the answer holds commands. Blocks are paragraphs, tables, lists of notes and pictures; empty ones are skipped.
    """

    title: str
    status: str
    good: bool
    answer: Sequence[tuple[str, str | Markup]]
    sections: Sequence[tuple[str, Sequence[Block]]]

    def write(self, folder: Path) -> None:
        """Write report.html, and the pictures that have names as PNG."""
        lists = [block for _, blocks in self.sections for block in blocks if isinstance(block, Sequence)]
        for picture in (item for items in lists for item in items if isinstance(item, Picture) and item.name):
            picture.write_png(folder)
        (folder / "report.html").write_text(self.render(), encoding="utf-8")

    def render(self) -> str:
        """The page as one file that loads nothing else."""
        import jinja2

        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("hystfit.results"), autoescape=True, trim_blocks=True, lstrip_blocks=True
        )
        shown = [(heading, [block_html(block) for block in blocks if block]) for heading, blocks in self.sections]
        kept = [(heading, blocks) for heading, blocks in shown if blocks]
        enlarges = any("<img" in block for _, blocks in kept for block in blocks)
        answer = [
            (name, value.html if isinstance(value, Markup) else html.escape(value)) for name, value in self.answer
        ]
        parts = {"status": words_html(self.status), "answer": answer, "sections": kept, "enlarges": enlarges}
        return environment.get_template("page.html").render(page=self, **parts)


def block_html(block: Block) -> str:
    """A block as HTML; all text is escaped."""
    if isinstance(block, Table):
        return f'<div class="scroll">{block.html()}</div>'
    if isinstance(block, Markup):
        return block.html
    if isinstance(block, str):
        return f"<p>{words_html(block)}</p>"
    if isinstance(block[0], Picture):
        return '<div class="pictures">' + "".join(one.html() for one in block if isinstance(one, Picture)) + "</div>"
    return "<ul>" + "".join(f"<li>{words_html(str(item))}</li>" for item in block if str(item)) + "</ul>"


_OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*(?: \w+)?")


def words_html(text: str) -> str:
    """Text as HTML; no line ends within an option, or between it and its value."""
    return _OPTION.sub(r'<span class="option">\g<0></span>', html.escape(text))


def link(address: str, text: str) -> Markup:
    """A link to a page beside this one."""
    return Markup(f'<a href="{html.escape(address, quote=True)}">{html.escape(text)}</a>')


def svg(figure: Figure) -> bytes:
    """A figure as vector graphics, laid out once; its axes can be found by their identifiers."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    for k, ax in enumerate(figure.axes):
        ax.set_gid(f"axes-{k}")
    buffer = io.StringIO()
    FigureCanvasSVG(figure).print_svg(buffer)
    return buffer.getvalue().encode("utf-8")


POINTS = 72  # of vector graphics in an inch


def _panels(figure: Figure) -> list[dict[str, Any]]:
    """Place and data coordinates of the axes of a figure that was drawn, for the script that rescales them."""
    height, k = figure.get_figheight() * POINTS, POINTS / figure.dpi
    panels = []
    for ax in figure.axes:
        if ax.get_label() == "<colorbar>" or ax.name != "rectilinear":
            continue
        box = ax.get_window_extent()
        sides = [_side(ax, ax.xaxis, ax.get_shared_x_axes()), _side(ax, ax.yaxis, ax.get_shared_y_axes())]
        place = {"id": ax.get_gid(), "box": [box.x0 * k, height - box.y1 * k, box.x1 * k, height - box.y0 * k]}
        panels.append(place | {key: [side[key] for side in sides] for key in sides[0]})
    return panels


def _side(ax: Axes, axis: Any, families: Any) -> dict[str, Any]:
    """Limits of one axis, logarithms where it is logarithmic, and how its ticks are labelled; one with fixed ticks does not move."""
    import numpy as np
    from matplotlib.ticker import FixedLocator, ScalarFormatter

    log, ends = axis.get_scale() == "log", axis.get_view_interval()
    return {
        "limits": list(map(float, np.log10(ends) if log else ends)),
        "log": log,
        "labels": _units(axis) if isinstance(axis.get_major_formatter(), ScalarFormatter) else [0.0, 1.0],
        "moves": not isinstance(axis.get_major_locator(), FixedLocator),
        "shared": [other.get_gid() for other in families.get_siblings(ax) if other is not ax],
    }


def _units(axis: Any) -> list[float]:
    """Offset and power of ten that stand at an axis: value = offset + power * label."""
    places = axis.get_majorticklocs()
    words = axis.get_major_formatter().format_ticks(places) if len(places) > 1 else []
    known = [
        (float(place), float(word.replace("\N{MINUS SIGN}", "-")))
        for place, word in zip(places, words, strict=False)
        if word
    ]
    if not known or known[0][1] == known[-1][1]:
        return [0.0, 1.0]
    (low, first), (high, last) = known[0], known[-1]
    power = 10.0 ** round(math.log10((high - low) / (last - first)))
    offset = low - power * first
    return [offset if abs(offset) > 1e-6 * (high - low) else 0.0, power]
