"""Outcome of reading a generated file without options: right, half right, asked, refused uselessly, or wrong in silence."""

from __future__ import annotations

import re
import shlex
import traceback
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.data import Dataset, Record
from hystfit.errors import HystfitError
from hystfit.outcome import Code, Note, Severity
from hystfit.params.units import conversion
from hystfit.reading import read

from .truth import Layout, Loop, Records

RIGHT, HALF, ASKED, USELESS, SILENT = "right", "unit unknown", "asked", "refused uselessly", "wrong in silence"
_OPTIONS = (
    "time",
    "input",
    "output",
    "by",
    "only",
    "where",
    "units",
    "gaps",
    "delimiter",
    "decimal",
    "encoding",
    "rate",
)
_AT_SHELL = re.compile(rf"--({'|'.join(_OPTIONS)})[ =]('[^']*'|\"[^\"]*\"|[^\s,;()]+)")
_IN_PYTHON = re.compile(rf"\b({'|'.join(_OPTIONS)})=('[^']*'|\"[^\"]*\"|\d+)")
_TIME_ERROR = 0.01  # of the duration
_EXACT = 1e-9  # of the largest value: rounding of a conversion


def score(layout: Layout, folder: Path) -> tuple[str, str]:
    """Outcome and details of a layout, whose files are written into a folder."""
    for name, content in layout.files.items():
        (folder / name).write_bytes(content)
    paths = [folder / name for name in layout.files]
    path = paths[0] if len(paths) == 1 else paths
    try:
        return _scored(layout, path)
    except Exception:
        return USELESS, traceback.format_exc()
    finally:
        for one in paths:
            one.unlink()


def _scored(layout: Layout, path: Path | list[Path]) -> tuple[str, str]:
    try:
        data = _read(path)
    except HystfitError as error:
        return _of_refusal(layout, path, str(error))
    outcome, wrong = _of_data(layout, data)
    notes = [note for record in data for note in record.notes if note.severity is not Severity.INFO]
    told = "; ".join(
        dict.fromkeys([f"read {data[0].y_name!r} over {data[0].u_name!r}", *(note.text for note in notes)])
    )
    if layout.ask:
        told_choice = any(note.code is Code.COLUMN_CHOICE for note in notes)
        return (RIGHT if told_choice else SILENT), f"read without the question: {wrong}; {told}"
    if outcome in (RIGHT, HALF):
        return outcome, wrong
    if _told(layout, data, notes):
        return (RIGHT if layout.either_order or layout.may_ask else ASKED), f"{wrong}; {told}"
    remedies = [options for note in notes for options in _remedies(note.text)]
    remedies += [dict([note.option]) for note in notes if note.option]
    if any(_reads_right(layout, path, options) for options in remedies):
        return ASKED, f"{wrong}; {told}"
    return SILENT, f"{wrong}; {told}"


def _read(path: Any, options: Mapping[str, Any] = {}) -> Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return Dataset.of(read(path, **options))


def _of_refusal(layout: Layout, path: Any, message: str) -> tuple[str, str]:
    """Outcome of an error by its remedies."""
    if layout.ask:
        names = all(f"--{key}" in message or f"{key}=" in message for key in layout.answer)
        useful = names and _reads_right(layout, path, layout.answer)
        return (RIGHT if useful else USELESS), message
    remedies = _remedies(message)
    if layout.may_ask and layout.answer and all(f"--{key}" in message or f"{key}=" in message for key in layout.answer):
        remedies.append(dict(layout.answer))
    helps = any(_reads_right(layout, path, options) for options in remedies)
    return (USELESS if not helps else RIGHT if layout.may_ask else ASKED), message


def _remedies(message: str) -> list[dict[str, str]]:
    """The options that a message names, those of each reading together and each one alone."""
    found: list[dict[str, str]] = [{}]
    for match in [*_AT_SHELL.finditer(message), *_IN_PYTHON.finditer(message)]:
        key, value = match[1], match[2]
        value = shlex.split(value)[0] if value[0] in "'\"" and len(value) > 1 else value
        if key in found[-1]:
            found.append({})
        found[-1][key] = value
    alone = [{key: value} for options in found for key, value in options.items() if len(options) > 1]
    return [options for options in found + alone if options]


def _reads_right(layout: Layout, path: Any, options: Mapping[str, Any]) -> bool:
    try:
        return _of_data(layout, _read(path, options))[0] in (RIGHT, HALF)
    except HystfitError:
        return False


def _told(layout: Layout, data: Dataset, notes: Sequence[Note]) -> bool:
    """Whether a warning is on the very matter that is wrong: columns exchanged, curves not divided, or units assumed."""
    codes = {note.code for note in notes}
    exchanged = [tuple(Loop(one.y, one.u, one.y_unit, one.u_unit, one.t) for one in truth) for truth in layout.truths]
    if Code.COLUMN_CHOICE in codes and _best(exchanged, data)[0] in (RIGHT, HALF):
        return True
    whole = [(_concatenated(truth),) for truth in layout.truths]
    if Code.CURVES in codes and _best(whole, data)[0] in (RIGHT, HALF):
        return True
    bare = [tuple(Loop(one.u, one.y, slack=one.slack) for one in truth) for truth in layout.truths]
    without = [record.replace(u_unit="", y_unit="") for record in data]
    return Code.UNITS in codes and _best(bare, without)[0] in (RIGHT, HALF)


def _concatenated(truth: Records) -> Loop:
    """The records after each other as one."""
    first = truth[0]
    return Loop(
        np.concatenate([one.u for one in truth]), np.concatenate([one.y for one in truth]), first.u_unit, first.y_unit
    )


def _of_data(layout: Layout, data: Iterable[Record]) -> tuple[str, str]:
    return _best(layout.truths, data)


def _best(truths: Sequence[Records], data: Iterable[Record]) -> tuple[str, str]:
    """The best outcome over the truths, and what differs from the first."""
    data = list(data)
    found = [_against(truth, data) for truth in truths]
    return next((one for one in found if one[0] == RIGHT), next((one for one in found if one[0] == HALF), found[0]))


def _against(truth: Records, data: Sequence[Record]) -> tuple[str, str]:
    if len(data) != len(truth):
        return SILENT, f"{len(data)} records of {len(truth)}"
    found = [_of_record(one, record) for one, record in zip(truth, data, strict=True)]
    return next((one for one in found if one[0] == SILENT), next((one for one in found if one[0] == HALF), found[0]))


def _of_record(truth: Loop, record: Record) -> tuple[str, str]:
    """Outcome of one record, and what differs."""
    halves = []
    for role, true, unit in (("u", truth.u, truth.u_unit), ("y", truth.y, truth.y_unit)):
        values, read_unit = getattr(record, role), getattr(record, f"{role}_unit")
        name = f"{role} ({getattr(record, f'{role}_name')!r})"
        if values.size != true.size:
            return SILENT, f"{name} has {values.size} of {true.size} samples"
        factor = _factor(read_unit, unit)
        if factor is None:
            return SILENT, f"{name} is in {read_unit!r} instead of {unit!r}"
        if not _same(values * factor, true, truth.slack if role == "u" else 0.0):
            return SILENT, f"{name} differs: {values[:3] * factor} for {true[:3]}"
        if unit and not _known(read_unit, unit):
            halves.append(f"{name} in {read_unit!r} instead of {unit!r}")
    if truth.t is not None and (wrong := _of_time(truth.t, record)):
        if record.t is not None:
            return SILENT, wrong
        halves.append(wrong)
    return (HALF, "; ".join(halves)) if halves else (RIGHT, "")


def _known(unit: str, true: str) -> bool:
    """Whether the unit read is one that hystfit converts to the true one."""
    plain = [text.replace(".", "").replace("·", "").replace("µ", "u").replace(" ", "") for text in (unit, true)]
    if plain[0] == plain[1]:
        return True
    return bool(unit) and (unit, true) != ("C", "degC") and conversion(unit, true) is not None


def _factor(unit: str, true: str) -> float | None:
    """Factor from the unit read to the true one, 1 where one of them is not known; None where they are at odds.

    "C" of a temperature is as in the file, and not known.
    """
    if (unit, true) == ("C", "degC"):
        return 1.0
    try:
        return (conversion(unit, true) or 1.0) if unit and true else 1.0
    except HystfitError:
        return None


def _same(values: np.ndarray, true: np.ndarray, slack: float) -> bool:
    if slack:
        return bool(np.abs(values - values[0] - (true - true[0])).max() <= slack * np.ptp(true))
    size = float(np.nanmax(np.abs(true)))
    return bool(np.allclose(values, true, rtol=_EXACT, atol=_EXACT * size, equal_nan=True))


def _of_time(true: np.ndarray, record: Record) -> str:
    if record.t is None:
        return "without its time"
    seconds = (record.t - record.t[0]) * (conversion(record.t_unit or "s", "s") or 1.0)
    return (
        "" if np.abs(seconds - true).max() <= _TIME_ERROR * true[-1] else f"time differs: {seconds[:3]} for {true[:3]}"
    )
