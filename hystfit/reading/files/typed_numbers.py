"""Numbers that a program printed with the name of their type: np.float64(1.5), tensor(1.5), Decimal('1.5')."""

from __future__ import annotations

import re

from hystfit.outcome import Code, Note

_NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf)"
_TYPED = re.compile(
    rf"\b(?:(?:np|numpy)\.(?:float|int|uint)\d+|tensor|Decimal)\(\[?['\"]?({_NUMBER})['\"]?\]?"
    r"(?:, ?(?:dtype|device|weak_type|grad_fn|requires_grad)=[^()]*(?:\([^()]*\))?)?\)"
)
_NAMES = ("np.", "numpy.", "tensor(", "Decimal(")


def without_types(content: str) -> tuple[str, list[Note]]:
    """A text with its numbers alone, and a note that says what stood around them."""
    if not any(name in content for name in _NAMES) or (first := _TYPED.search(content)) is None:
        return content, []
    text = f"numbers printed with the name of their type, such as {first[0]}, are read as numbers"
    return _TYPED.sub(r"\1", content), [Note(Code.FILE_FORMAT, text)]
