"""Pictures in the two color schemes of the site."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

SCHEMES = {"light": "#3b4046", "dark": "#c9ced6"}  # color of text and axes
LINES = ["#9ecae1", "#2f86c9", "#d95f0e"]  # low, middle, high value of a parameter


@contextlib.contextmanager
def scheme(text: str) -> Iterator[None]:
    """Matplotlib with a transparent background and text of one color.

    Args:
        text: color of text and axes.
    """
    colors = {f"{part}.color": text for part in ("xtick", "ytick", "text")}
    settings = {
        **colors,
        "axes.labelcolor": text,
        "axes.edgecolor": text,
        "axes.facecolor": "none",
        "figure.facecolor": "none",
        "savefig.facecolor": "none",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlesize": "medium",
        "font.size": 9,
        "legend.frameon": False,
        "svg.fonttype": "path",
        "svg.hashsalt": "hystfit",
    }
    with plt.rc_context(settings):
        yield


def save_both(draw: Callable[[], Figure], target: Path) -> None:
    """Draw a figure once, and write it as NAME.light.svg and, with the other color of text and axes, as NAME.dark.svg.

    Args:
        draw: makes the figure.
        target: path without a suffix.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    light, content = SCHEMES["light"], io.StringIO()
    with scheme(light):
        figure = draw()
        figure.savefig(content, format="svg", metadata={"Date": None})
        plt.close(figure)
    for name, text in SCHEMES.items():
        Path(f"{target}.{name}.svg").write_text(content.getvalue().replace(light, text), encoding="utf-8")


def both(path: str, alt: str) -> str:
    """Markdown that shows the picture of the reader's scheme.

    Args:
        path: from the page, without a suffix.
        alt: description of the picture.
    """
    shown: Any = (f"```{{image}} {path}.{name}.svg\n:alt: {alt}\n:class: only-{name}\n```" for name in SCHEMES)
    return "\n\n".join(shown)
