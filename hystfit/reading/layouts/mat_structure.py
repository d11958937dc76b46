"""Structure of MATLAB 5 files, checked before scipy reads them: it trusts types and counts, and damaged ones end the process."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator

from hystfit.errors import DataError
from hystfit.reading.files.file_bytes import allowed
from hystfit.reading.limits import DEEPEST

_MATRIX, _COMPRESSED = 14, 15
_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}  # bytes of a number, by element type
_TEXT_TYPES = frozenset({1, 2, 3, 4, 16, 17, 18})
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
_NUMERIC = range(6, 16)
_COMPLEX = 0x800


def check_structure(raw: bytes) -> None:
    """Refuse a MATLAB 5 file whose elements do not fit each other, or that unpacks to many times its size; pass others."""
    order = {b"IM": "<", b"MI": ">"}.get(raw[126:128])
    if order is None:
        return
    left = allowed(len(raw))
    for kind, data in _elements(raw[128:], order):
        if kind == _COMPRESSED:
            data = _unpacked(data, left)
            left -= len(data)
            parts = list(_elements(data, order))
            if len(parts) != 1:
                raise DataError(
                    f"a compressed element holds {len(parts)} elements, not one: it is damaged, save it again"
                )
            kind, data = parts[0]
        if kind == _MATRIX:
            _check_matrix(data, order, 0)


def _unpacked(data: bytes, most: int) -> bytes:
    try:
        content = zlib.decompressobj().decompress(data, most + 1)
    except zlib.error as error:
        raise DataError(f"a compressed element cannot be unpacked ({error}): it is damaged, save it again") from error
    if len(content) > most:
        raise DataError("it unpacks to many times its size: it is damaged or not a measurement")
    return content


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and content of the elements that follow each other; short ones share their tag with the content."""
    place = 0
    while place + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, place)
        if kind >> 16:
            kind, length, start = kind & 0xFFFF, kind >> 16, place + 4
            end = place + 8
            if length > 4:
                raise DataError(f"a short element has {length} bytes: it is damaged, save it again")
        else:
            start = place + 8
            end = start + length + (-length % 8 if kind != _COMPRESSED else 0)
        if start + length > len(data):
            raise DataError(
                f"an element of {length} bytes ends after the file: it is damaged or cut off, copy it again"
            )
        yield kind, data[start : start + length]
        place = end


def _check_matrix(data: bytes, order: str, depth: int) -> None:
    """Refuse a variable whose parts do not agree with its class and shape."""
    if not data:
        return  # an empty cell
    if depth > DEEPEST:
        raise DataError(f"variables are nested more than {DEEPEST} times: save arrays of numbers")
    parts = list(_elements(data, order))
    if not parts or parts[0][0] != 6 or len(parts[0][1]) != 8:
        raise _damaged("flags")
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    group = flags & 0xFF
    if group not in (_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, *_NUMERIC):
        if group not in (16, 17):  # functions and other objects, which are not read
            raise _damaged("class")
        return
    if len(parts) < 3 or parts[1][0] not in (5, 6) or len(parts[1][1]) % 4 or len(parts[1][1]) < 8:
        raise _damaged("shape")
    shape = struct.unpack(f"{order}{len(parts[1][1]) // 4}i", parts[1][1])
    if min(shape) < 0:
        raise _damaged("shape")
    count, rest = math.prod(shape), parts[3:]
    if group in _NUMERIC:
        _check_numbers(rest, count, 2 if flags & _COMPLEX else 1)
    elif group == _CHAR:
        if any(kind not in _TEXT_TYPES for kind, _ in rest) or (count and not rest):
            raise _damaged("text")
    elif group == _SPARSE:
        if len(rest) < 3 or any(kind not in _SIZES for kind, _ in rest):
            raise _damaged("sparse matrix")
    else:
        _check_members(rest, count, order, group, depth)


def _check_numbers(parts: list[tuple[int, bytes]], count: int, least: int) -> None:
    """Refuse numbers of another count than the shape has, for real and imaginary part."""
    if len(parts) < (least if count else 0):
        raise _damaged("numbers")
    for kind, content in parts:
        if kind not in _SIZES or len(content) != count * _SIZES[kind]:
            raise _damaged("numbers")


def _check_members(parts: list[tuple[int, bytes]], count: int, order: str, group: int, depth: int) -> None:
    """Refuse cells and structures of another number of members than their shape and fields have."""
    if group == _OBJECT:
        parts = parts[1:]
    if group != _CELL:
        if len(parts) < 2 or parts[0][0] != 5 or len(parts[0][1]) != 4 or parts[1][0] not in (1, 2):
            raise _damaged("fields")
        length = struct.unpack(f"{order}i", parts[0][1])[0]
        if length <= 0 or len(parts[1][1]) % length:
            raise _damaged("fields")
        count *= len(parts[1][1]) // length
        parts = parts[2:]
    if len(parts) != count or any(kind != _MATRIX for kind, _ in parts):
        raise _damaged("members")
    for _, content in parts:
        _check_matrix(content, order, depth + 1)


def _damaged(what: str) -> DataError:
    return DataError(f"the {what} of a variable cannot be read: it is damaged, save it again")
