"""Values of a stored JSON file, each read with its type: a file changed by hand is refused in words."""

from __future__ import annotations

import dataclasses
import enum
import json
import math
from collections.abc import Iterator
from types import NoneType
from typing import Any, TypeVar, get_args, get_type_hints

from hystfit.errors import DataError
from hystfit.outcome import Note

E = TypeVar("E", bound=enum.StrEnum)
T = TypeVar("T")
_KINDS = {dict: "an object", list: "a list", str: "text", bool: "true or false", type(None): "null"}


def parse(content: bytes | str, place: str, *, finite: bool = True) -> Stored:
    """The object of a JSON file, without NaN and infinity where it must be finite."""

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

    def get(self, key: str, kind: Any) -> Any:
        """A member of a type (str, bool, int, a finite float), or of one of several (`float | None`)."""
        kinds, value = get_args(kind) or (kind,), self._value(key)
        if not any(_TYPES[one][1](value) for one in kinds):
            raise self._type_error(key, " or ".join(_TYPES[one][0] for one in kinds), value)
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
        value = self._value(key)
        if not isinstance(value, list):
            raise self._type_error(key, "a list", value)
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        values = self.listed(key)
        if not all(isinstance(one, str) for one in values):
            raise self._type_error(key, "a list of texts", values)
        return tuple(values)

    def mapping(self, key: str, kind: type[T]) -> dict[str, T]:
        """An object whose members are of one type."""
        part = self.part(key)
        return {name: part.get(name, kind) for name in part.content}

    def read(self, kind: type[T], **given: Any) -> T:
        """A data class whose fields are members of their types, but for those that are given."""
        hints = get_type_hints(kind)
        names = [field.name for field in dataclasses.fields(kind) if field.name not in given]  # type: ignore[arg-type]
        return kind(**{name: self.get(name, hints[name]) for name in names}, **given)

    def member(self, key: str, kind: type[E]) -> E:
        """A member of an enumeration."""
        value = self.get(key, str)
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


# Types of members: the words, and whether a value is of the type.
_TYPES = {
    str: ("text", lambda value: isinstance(value, str)),
    bool: ("true or false", lambda value: isinstance(value, bool)),
    int: ("a whole number", lambda value: type(value) is int and is_number(value)),
    float: ("a number", is_number),
    NoneType: ("null", lambda value: value is None),
}
