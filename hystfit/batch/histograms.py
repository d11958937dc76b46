"""Histograms as small SVG pictures, drawn in the colors of the page that holds them."""

from __future__ import annotations

import html

import numpy as np

from hystfit.outcome.table import number

_WIDTH, _HEIGHT, _FOOT = 240, 96, 18
_FEWEST, _MOST = 5, 30  # bars


def histogram(values: np.ndarray, heading: str) -> str:
    """An SVG picture with a bar for each bin, the median as a line, and the ends of the range below.

    Args:
        values: shape (n,), finite, not empty.
    """
    bars = int(np.clip(np.sqrt(values.size) * 1.5, _FEWEST, _MOST))
    counts, edges = np.histogram(values, bins=bars if np.ptp(values) > 0 else 1)
    low, high, middle = float(edges[0]), float(edges[-1]), float(np.median(values))
    width, floor = _WIDTH / counts.size, _HEIGHT - _FOOT
    place = lambda value: _WIDTH * (value - low) / (high - low)
    shapes = []
    for k, count in enumerate(counts):
        tall = (floor - 4) * count / counts.max()
        title = f"<title>{number(edges[k])} to {number(edges[k + 1])}: {count}</title>"
        corner = f'x="{k * width + 0.5:.1f}" y="{floor - tall:.1f}"'
        shapes.append(
            f'<rect class="bar" {corner} width="{max(width - 1, 0.5):.1f}" height="{tall:.1f}">{title}</rect>'
        )
    at = f"{place(middle):.1f}"
    shapes.append(f'<line class="median" x1="{at}" x2="{at}" y1="0" y2="{floor}"/>')
    shapes.append(f'<text x="0" y="{_HEIGHT - 4}">{number(low)}</text>')
    shapes.append(f'<text x="{_WIDTH}" y="{_HEIGHT - 4}" text-anchor="end">{number(high)}</text>')
    label = html.escape(heading, quote=True)
    return f'<svg role="img" aria-label="{label}" viewBox="0 0 {_WIDTH} {_HEIGHT}">{"".join(shapes)}</svg>'
