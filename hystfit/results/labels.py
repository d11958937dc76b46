"""Labels of pictures in fonts that have their characters: names of columns may be Chinese, Japanese or Korean.

The font of matplotlib has Latin, Greek and Cyrillic letters. For other characters an installed font is searched; where there is
none, an axis is named by its role, and the name of the column stays in the text of the report.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from hystfit.params.units import axis_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Text

_TICKS = 7  # intervals between the numbers of an input
_LIKELY = re.compile(
    r"CJK|Han Sans|WenQuanYi|SimHei|YaHei|Gothic|Hiragino|PingFang|Meiryo|Unicode|Nanum|Malgun|IPA", re.IGNORECASE
)


def column_label(ax: Axes, side: str, name: str, unit: str, role: str) -> None:
    """Label an axis by the name and unit of a column, or by its role where no font has the characters of the name."""
    generic = axis_label(role, unit)
    if side == "x":  # numbers of six characters, such as those of fields in Oe, touch where there are more
        ax.locator_params(axis="x", nbins=_TICKS)
    write(getattr(ax, f"{side}axis").label, axis_label(name, unit), generic if _families(generic) is not None else role)


def write(target: Text, text: str, instead: str) -> None:
    """Set a text in a font that has its characters, or another text where no font has them."""
    families = _families(text)
    target.set_text(instead if families is None else text)
    if families:
        target.set_fontfamily(families)


def use_available_fonts(figure: Any) -> None:
    """Give every text of a figure a font that has its characters; without one, a question mark takes their place."""
    for text in _texts(figure):
        if not text.get_text().isascii():
            write(text, text.get_text(), substitute_missing_glyphs(text.get_text()))


def _texts(artist: Any) -> Iterator[Text]:
    """Texts of an artist; of ticks those that exist, for making all ticks takes as long as the rest of a picture."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text

    if isinstance(artist, Text):
        yield artist
    if isinstance(artist, Axis):
        parts = [artist.label, *(label for tick in artist.majorTicks for label in (tick.label1, tick.label2))]
    else:
        parts = artist.get_children()
    for part in parts:
        yield from _texts(part)


def substitute_missing_glyphs(text: str) -> str:
    """A text in which question marks stand for characters that no installed font has."""
    return text if _families(text) is not None else "".join("?" if c in _lacking(text) else c for c in text)


def _lacking(text: str) -> frozenset[str]:
    """Characters that the default font does not have."""
    if text.isascii():
        return frozenset()
    from matplotlib import font_manager

    font = font_manager.get_font(font_manager.findfont(font_manager.FontProperties()))
    return frozenset(c for c in text if c != "\n" and not font.get_char_index(ord(c)))


def _families(text: str) -> list[str] | None:
    """Families of fonts that have the characters of a text: none besides the default one where that has them; None without any."""
    lacking = _lacking(text)
    if not lacking:
        return []
    import matplotlib
    from matplotlib import font_manager

    family = _family_with(lacking, len(font_manager.fontManager.ttflist))
    return None if family is None else [*matplotlib.rcParams["font.family"], family]


@functools.lru_cache(maxsize=64)
def _family_with(characters: frozenset[str], _fonts: int) -> str | None:
    """An installed family that has these characters; `_fonts`, the number of fonts, tells when the list has changed."""
    from matplotlib import font_manager
    from matplotlib.ft2font import FT2Font

    for entry in sorted(font_manager.fontManager.ttflist, key=lambda font: not _LIKELY.search(font.name)):
        if entry.name.startswith("Last Resort"):  # comes with matplotlib and draws a box for every character
            continue
        try:
            font = FT2Font(entry.fname)
        except (OSError, RuntimeError):  # removed, or of a kind that FreeType does not read
            continue
        if all(font.get_char_index(ord(c)) for c in characters):
            return entry.name
    return None
