"""HTML pages of all verbs in one style: self-contained, with pictures that enlarge, for screen, phone, dark mode and print."""

from __future__ import annotations

import base64
import dataclasses
import functools
import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hystfit.outcome import Note, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture on a page.

    Attributes:
        figure: matplotlib figure.
        caption: below it, and its text for readers who do not see it.
        wide: as wide as the page, for figures of several panels.
    """

    figure: Figure
    caption: str
    wide: bool = False

    @functools.cached_property
    def svg(self) -> bytes:
        """The figure as vector graphics, laid out once."""
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        buffer = io.StringIO()
        FigureCanvasSVG(self.figure).print_svg(buffer)
        return buffer.getvalue().encode("utf-8")

    def html(self) -> str:
        """As vector graphics within the page."""
        source = base64.b64encode(self.svg).decode("ascii")
        words, mark = html.escape(self.caption, quote=True), ' class="wide"' if self.wide else ""
        return (
            f'<figure{mark}><img alt="{words}" tabindex="0" src="data:image/svg+xml;base64,{source}">'
            f"<figcaption>{words}</figcaption></figure>"
        )


@dataclasses.dataclass(frozen=True)
class Markup:
    """HTML as it is."""

    html: str


Block = str | Table | Markup | Sequence[Note | str] | Sequence[Picture]


@dataclasses.dataclass(frozen=True)
class Page:
    """A page.

    Attributes:
        title: one line.
        status: a sentence on whether the result can be used.
        good: whether it can.
        answer: what a reader came for, as names and values.
        sections: heading and blocks of each: paragraphs, tables, lists of notes, pictures; empty ones are skipped.
    """

    title: str
    status: str
    good: bool
    answer: Sequence[tuple[str, str]]
    sections: Sequence[tuple[str, Sequence[Block]]]

    def render(self) -> str:
        """The page as one file that loads nothing else."""
        import jinja2

        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("hystfit.results"), autoescape=True, trim_blocks=True, lstrip_blocks=True
        )
        shown = [(heading, [block_html(block) for block in blocks if block]) for heading, blocks in self.sections]
        kept = [(heading, blocks) for heading, blocks in shown if blocks]
        enlarges = any("<img" in block for _, blocks in kept for block in blocks)
        return environment.get_template("page.html").render(page=self, sections=kept, enlarges=enlarges)


def block_html(block: Block) -> str:
    """A block as HTML; all text is escaped."""
    if isinstance(block, Table):
        return f'<div class="scroll">{block.html()}</div>'
    if isinstance(block, Markup):
        return block.html
    if isinstance(block, str):
        return f"<p>{html.escape(block)}</p>"
    if isinstance(block[0], Picture):
        return '<div class="pictures">' + "".join(one.html() for one in block if isinstance(one, Picture)) + "</div>"
    return "<ul>" + "".join(f"<li>{html.escape(str(item))}</li>" for item in block if str(item)) + "</ul>"
