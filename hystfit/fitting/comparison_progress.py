"""Progress of models that are fitted side by side."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence


class ShownProgress:
    """Progress of models that are fitted side by side: each line names a model, its step, and how many are done.

    Args:
        update: called with a line of text and the fraction done.
        names: of the models.
    """

    def __init__(self, update: Callable[..., object], names: Sequence[str]):
        self._update, self._count, self._done, self._lock = update, len(names), 0, threading.Lock()
        update(f"{self._count} to try: {', '.join(names)}", 0.0)

    def step(self, name: str, text: str) -> None:
        """Report the step that a model has reached."""
        with self._lock:
            self._update(f"{name}: {text}", self._done / self._count)

    def done(self, name: str) -> None:
        """Report that a model is finished."""
        with self._lock:
            self._done += 1
            self._update(f"{name}: done ({self._done} of {self._count})", self._done / self._count)
