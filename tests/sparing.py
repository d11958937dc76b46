"""What the quick form of the tests does once where the full form repeats it: checks of shapes, and drawing."""

from __future__ import annotations

import functools
import io
import os
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

SHAPE_CHECKS = 8  # calls of a function in one test whose shapes are checked


class ShapeChecks:
    """`jaxtyping.jaxtyped` that checks only the first calls of each function in a test.

    Checks of host functions, which a test calls thousands of times with the same shapes, took up to a quarter of its time.

    Attributes:
        test: number of the test that runs.
    """

    def __init__(self, checks: Callable[..., Any]):
        self.checks = checks
        self.test = 0

    def __call__(self, fn: Any = None, **options: Any) -> Any:
        if fn is None:
            return functools.partial(self, **options)
        checked = self.checks(fn, **options)
        if not isinstance(fn, types.FunctionType):
            return checked
        test = calls = 0

        @functools.wraps(fn)
        def sparing(*args: Any, **kwargs: Any) -> Any:
            nonlocal test, calls
            __tracebackhide__ = True
            if test != self.test:
                test, calls = self.test, 0
            calls += 1
            return (checked if calls <= SHAPE_CHECKS else fn)(*args, **kwargs)

        return sparing


class Pictures:
    """Pictures of the commands: each kind is drawn once a test file, and that one written again where only the data differ.

    With every fit, ten of them are written twice, which took a third of the time of the tests of commands.

    Attributes:
        all_drawn: whether every picture is drawn.
        kept: the bytes of each kind.
    """

    def __init__(self) -> None:
        self.all_drawn = False
        self.kept: dict[tuple[Any, ...], bytes] = {}

    def draw_few(self) -> None:
        """From now on, canvases of matplotlib draw what is not yet kept."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        FigureCanvasAgg.print_png = self._sparing(FigureCanvasAgg.print_png)
        FigureCanvasSVG.print_svg = self._sparing(FigureCanvasSVG.print_svg)

    def _sparing(self, draw: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(draw)
        def drawn(canvas: Any, target: Any, **options: Any) -> None:
            if self.all_drawn or "draw" in vars(canvas.figure):  # matplotlib asks for its renderer by such a call
                draw(canvas, target, **options)
                return
            words = [
                (ax.get_title(), ax.get_xlabel(), ax.get_xscale(), ax.get_ylabel(), ax.get_yscale())
                for ax in canvas.figure.axes
            ]
            kind = (draw, *canvas.figure.get_size_inches(), *words)
            if kind not in self.kept:
                draw(canvas, stream := io.BytesIO(), **options)
                self.kept[kind] = stream.getvalue()
            if isinstance(target, str | os.PathLike):
                Path(target).write_bytes(self.kept[kind])
            else:
                target.write(self.kept[kind].decode() if isinstance(target, io.TextIOBase) else self.kept[kind])

        return drawn
