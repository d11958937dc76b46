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
        self._update, self._names, self._done, self._lock = update, set(names), set[str](), threading.Lock()
        update(f"{len(names)} to try: {', '.join(names)}", 0.0)

    def step(self, name: str, text: str) -> None:
        """Report the step that a model has reached."""
        with self._lock:
            self._show(name, text)

    def done(self, name: str) -> None:
        """Report that a model is finished; one that is fitted again counts once."""
        with self._lock:
            self._done.add(name)
            self._show(name, f"done ({len(self._done)} of {len(self._names | self._done)})")

    def _show(self, name: str, text: str) -> None:
        self._names.add(name)  # models join on the way
        self._update(f"{name}: {text}", len(self._done) / len(self._names))
