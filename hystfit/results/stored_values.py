"""Values of a stored JSON file, each read with its type: a file changed by hand is refused in words."""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from hystfit.errors import DataError
from hystfit.outcome import Note

E = TypeVar("E", bound=enum.StrEnum)
_KINDS = {dict: "an object", list: "a list", str: "text", bool: "true or false", type(None): "null"}


def parse(content: bytes | str, place: str, *, finite: bool = True) -> Stored:
    """The object of a JSON file.

    Args:
        finite: refuse NaN and infinity.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) != len(pairs):
            raise ValueError("a name occurs twice in an object")
        return dict(pairs)

    def constant(text: str) -> float:
        if finite:
            raise ValueError(f"{text} is no JSON number")
        return float(text)

    try:
        stored = json.loads(content, object_pairs_hook=unique, parse_constant=constant)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{place} is damaged ({error}): restore it, or fit again") from error
    return Stored(stored, place)


class Stored:
    """An object of a JSON file; its methods read a member of a type, or raise a DataError that names file and member."""

    def __init__(self, content: Any, place: str):
        self.place = place
        if not isinstance(content, dict):
            raise self._type_error("", "an object", content)
        self.content: dict[str, Any] = content

    def _type_error(self, key: str, expected: str, value: Any) -> DataError:
        found = _KINDS.get(type(value), "") or f"{value!r:.40}"
        member = f" {key!r}" if key else ""
        return DataError(f"{self.place}:{member} is {found} instead of {expected}; restore the file, or fit again")

    def _value(self, key: str) -> Any:
        if key not in self.content:
            raise DataError(f"{self.place} has no {key!r}: restore the file, or fit again")
        return self.content[key]

    def _read(self, key: str, expected: str, fits: Callable[[Any], bool], optional: bool = False) -> Any:
        value = self._value(key)
        if not (fits(value) or (optional and value is None)):
            raise self._type_error(key, expected, value)
        return value

    def part(self, key: str) -> Stored:
        """An object."""
        return Stored(self._value(key), f"{self.place}: {key}")

    def optional_part(self, key: str) -> Stored | None:
        """An object, or null."""
        return None if self._value(key) is None else self.part(key)

    def parts(self) -> Iterator[tuple[str, Stored]]:
        """Name and object of every member, each an object."""
        return ((key, self.part(key)) for key in self.content)

    def listed(self, key: str) -> list[Any]:
        """A list."""
        return self._read(key, "a list", lambda value: isinstance(value, list))

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        words = "a list of texts"
        return tuple(self._read(key, words, lambda v: isinstance(v, list) and all(isinstance(one, str) for one in v)))

    def text(self, key: str) -> str:
        """Text."""
        return self._read(key, "text", lambda value: isinstance(value, str))

    def optional_text(self, key: str) -> str | None:
        """Text, or null."""
        return self._read(key, "text or null", lambda value: isinstance(value, str), optional=True)

    def flag(self, key: str) -> bool:
        """True or false."""
        return self._read(key, "true or false", lambda value: isinstance(value, bool))

    def optional_flag(self, key: str) -> bool | None:
        """True, false or null."""
        return self._read(key, "true, false or null", lambda value: isinstance(value, bool), optional=True)

    def number(self, key: str) -> float:
        """A finite number."""
        return self._read(key, "a number", is_number)

    def optional_number(self, key: str) -> float | None:
        """A finite number, or null."""
        return self._read(key, "a number or null", is_number, optional=True)

    def whole(self, key: str) -> int:
        """A whole number."""
        return self._read(key, "a whole number", lambda value: type(value) is int and is_number(value))

    def optional_whole(self, key: str) -> int | None:
        """A whole number, or null."""
        fits = lambda value: type(value) is int and is_number(value)
        return self._read(key, "a whole number or null", fits, optional=True)

    def numbers(self, key: str) -> dict[str, float]:
        """An object whose members are numbers."""
        part = self.part(key)
        return {name: part.number(name) for name in part.content}

    def words(self, key: str) -> dict[str, str]:
        """An object whose members are texts."""
        part = self.part(key)
        return {name: part.text(name) for name in part.content}

    def member(self, key: str, kind: type[E]) -> E:
        """A member of an enumeration."""
        value = self.text(key)
        if value not in list(kind):
            raise self._type_error(key, f"one of {', '.join(kind)}", value)
        return kind(value)

    def notes(self, key: str) -> tuple[Note, ...]:
        """Notes."""
        try:
            return tuple(Note.of(note) for note in self.listed(key))
        except (KeyError, ValueError, TypeError) as error:
            raise DataError(f"{self.place}: {key!r} holds something else than notes ({error})") from error


def is_number(value: Any) -> bool:
    """Whether a value of a JSON file is a number that a float can hold."""
    if type(value) is int:
        return abs(value) <= 2**1023
    return type(value) is float and math.isfinite(value)
