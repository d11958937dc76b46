"""Single cells of a text file: numbers, missing values, time stamps and text."""

from __future__ import annotations

import datetime
import functools
import itertools
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hystfit.errors import DataError
from hystfit.outcome import Code, Note
from hystfit.reading.limits import JUMP, LONGEST

NUMBER, MISSING, STAMP, TEXT = "N", "M", "D", "T"

_MISSING_WORDS = frozenset(
    """nan +nan -nan nan(ind) -nan(ind) na n/a #n/a #na null none nil - -- --- ---- . .. ... ? * ** *** **** missing
    #value! #div/0! #ref! #num! #name? #null! 1.#qnan -1.#qnan 1.#ind -1.#ind 1.#nan ol +ol -ol o.l. over +over -over
    overflow underflow overload overrange overrun ovf +ovf -ovf ovl ovld ovrflw ovr sat saturated err error bad invalid
    nodata n.d. nd n.v. unavailable unknown""".split()
) | {""}
SWITCH = {"on": 1.0, "off": 0.0, "true": 1.0, "false": 0.0}  # states among numbers
_BLANKED = re.compile(r"[-.*#?]+")  # ---.-- and #####
_INFINITE = {"inf": np.inf, "infinity": np.inf, "∞": np.inf, "1.#inf": np.inf}

_STAMP = re.compile(
    r"""(?:(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})
            |(?P<p>\d{1,2})[-/.*](?P<q>\d{1,2})[-/.*](?P<yy>\d{4}|\d{2})))?
        (?P<gap>[T ,]*)
        (?:(?P<hh>\d{1,5}):(?P<mm>\d{2})(?::(?P<ss>\d{1,2}(?:[.,]\d*|:\d{3})?))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?
           |(?P<min>\d{1,3}):(?P<sec>\d{2}[.,]\d+))?
        (?P<zone>Z|[+-]\d{2}:?\d{2})?""",
    re.VERBOSE | re.ASCII,
)
_MONTHS = "jan feb mar|mär|mrz apr may|mai jun jul aug sep o[ck]t nov de[cz]".split()  # English and German
_NAMED_MONTH = re.compile(
    rf"(\d{{1,2}})[-/. ]{{1,2}}(?:{'|'.join(f'({month})' for month in _MONTHS)})[a-z]*[-/.,: ]{{1,2}}(\d{{4}}|\d{{2}})(?!\d)",
    re.IGNORECASE,
)

_DAYS = re.compile(r"(\d{1,4}) ?d(?:ays?)?,? ?(\d{1,2})(?=:\d\d:)", re.IGNORECASE)


@functools.cache
def patterns(decimal: str) -> tuple[re.Pattern[str], re.Pattern[str], re.Pattern[str]]:
    """Patterns of a plain number, one with the other mark between thousands, and one with spaces between them."""
    mark, group = re.escape(decimal), re.escape("," if decimal == "." else ".")
    tail = rf"(?:{mark}\d*)?"  # no exponent, before which nobody separates thousands
    plain = rf"[+-]?(?:\d+{mark}?\d*|{mark}\d+)(?:[eEdD][+-]?\d+)?"
    grouped = rf"[+-]?[1-9]\d{{0,2}}(?:{group}\d{{3}})+{tail}"
    spaced = rf"[+-]?[1-9]\d{{0,2}}(?:[ '’\u00a0\u2009\u202f]\d{{3}})+{tail}"
    return re.compile(plain, re.ASCII), re.compile(grouped, re.ASCII), re.compile(spaced, re.ASCII)


_THREE_DIGITS = re.compile(r"([+-]?\d*[.,]\d{3,})([+-]\d{3})", re.ASCII)  # 1.234-103: Fortran leaves the E out
# Minus signs and dashes, and the digits and marks of full width of Chinese and Japanese text.
_AS_ASCII = (
    dict.fromkeys(map(ord, "−–﹣－"), "-") | {0xFF10 + k: str(k) for k in range(10)} | {ord("．"): ".", ord("，"): ","}
)
EPOCH_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}  # and how many of them a second has
_THIS_AGE = 6e8, 4e9  # s from 1970 to the years 1989 and 2096


def clean(cell: str) -> str:
    """A cell without surrounding blanks and quotes, the apostrophe of text in Excel, and the error behind ±, with an ASCII minus sign."""
    cell = cell.strip(" \t\r\f\v\u00a0\ufeff")
    if len(cell) >= 2 and cell[0] == cell[-1] and cell[0] in "\"'":
        cell = cell[1:-1].strip()
    if cell[:1] == "'" or "±" in cell:
        cell = cell.removeprefix("'").partition("±")[0].strip() or cell
    return cell if cell.isascii() else cell.translate(_AS_ASCII)


def _matched(cell: str) -> re.Match[str] | None:
    """A date, a time of day or both in a cleaned cell: the month may be a name (01-May-2010), and days may have passed (2d 03:04:05)."""
    if named := _NAMED_MONTH.match(cell):
        day, *months, year = named.groups()
        number = next(k for k, month in enumerate(months, 1) if month)
        cell = f"{year if len(year) == 4 else f'20{year}'}-{number}-{day}{cell[named.end() :]}"
    elif passed := _DAYS.match(cell):
        days, hours = map(int, passed.groups())
        cell = f"{24 * days + hours}{cell[passed.end() :]}"
    return _STAMP.fullmatch(cell)


def is_stamp(cell: str) -> bool:
    """Whether a cleaned cell is a date, a time of day or both."""
    match = _matched(cell) if cell[:1].isdigit() and len(cell) <= LONGEST else None
    if not match:
        return False
    clock = match["min"] is not None or (match["hh"] is not None and match["ss"] is not None)
    date = match["y"] is not None or match["p"] is not None
    return clock or date


def is_missing(cell: str) -> bool:
    """Whether a cleaned cell stands for a missing value: empty, a word of an instrument such as OVF, or marks only."""
    return not cell or (len(cell) <= 20 and (cell.lower() in _MISSING_WORDS or _BLANKED.fullmatch(cell) is not None))


def is_word(cell: str) -> bool:
    """Whether a cell holds one short word, as instruments write in place of a number."""
    return len(cell) < 40 and len(clean(cell)) <= 12 and not re.search(r"\s", clean(cell))


def are_dates(column: Sequence[str]) -> bool:
    """Whether every cell holds a date without time of day, or nothing."""
    matches = [_matched(clean(cell)) for cell in column if cell.strip()]
    return bool(matches) and all(m and (m["y"] or m["p"]) and not (m["hh"] or m["min"]) for m in matches)


def are_clocks(column: Sequence[str]) -> bool:
    """Whether every cell holds a time of day without date, or nothing."""
    matches = [_matched(clean(cell)) for cell in column if cell.strip()]
    return bool(matches) and all(m and (m["hh"] or m["min"]) and not (m["y"] or m["p"]) for m in matches)


def _accounting_number(cell: str) -> str:
    """The number in (1.5) or 1.5-; "" for other cells."""
    if cell.endswith("-") or (cell.startswith("(") and cell.endswith(")")):
        inner = cell[:-1].strip("( ")
        return inner if inner[:1].isdigit() or inner[:1] in (".", ",") else ""
    return ""


def number(cell: str, decimal: str) -> float | None:
    """The number in a cleaned cell; None for missing values and text. Negative ones may be (1.5) or 1.5-, as in accounts."""
    if len(cell) > LONGEST:
        return None
    plain, grouped, spaced = patterns(decimal)
    if unsigned := _accounting_number(cell):
        value = number(unsigned, decimal)
        return None if value is None else -value
    if plain.fullmatch(cell):
        return float(cell.replace(decimal, ".").replace("D", "e").replace("d", "e"))
    if grouped.fullmatch(cell):
        return float(cell.replace("," if decimal == "." else ".", "").replace(decimal, "."))
    if spaced.fullmatch(cell):
        return float(re.sub(r"[^\d.,eE+-]", "", cell).replace(decimal, "."))
    if (match := _THREE_DIGITS.fullmatch(cell)) and decimal in cell:
        return float(f"{match[1].replace(decimal, '.')}e{match[2]}")
    lower = cell.lower()
    if lower.lstrip("+-") in _INFINITE:
        return -np.inf if lower.startswith("-") else np.inf
    return None


def kind(cell: str, decimal: str) -> str:
    """Kind of a cell: NUMBER, MISSING, STAMP or TEXT."""
    if patterns(decimal)[0].fullmatch(cell):
        return NUMBER
    cell = clean(cell)
    if is_missing(cell):
        return MISSING
    if number(cell, decimal) is not None:
        return NUMBER
    return STAMP if is_stamp(cell) else TEXT


def parse(cells: Sequence[str], decimal: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of a column, NaN where there is none, and the kind of every cell; both of shape (rows,)."""
    parts = [_parse_chunk(cells[k : k + 2048], decimal) for k in range(0, len(cells), 2048)]
    values, kinds = np.concatenate([part for part, _ in parts]), np.concatenate([part for _, part in parts])
    over = np.isinf(values)  # "1e400", beyond the range of a double, and "inf"
    return np.where(over, np.nan, values), np.where(over, MISSING, kinds)


def _parse_chunk(cells: Sequence[str], decimal: str) -> tuple[np.ndarray, np.ndarray]:
    joined = "\x00".join(cells)
    if "_" not in joined and not (decimal == "," and "." in joined):  # float() accepts 1_0; 1.234 may be a thousand
        try:
            values = np.array([float(cell) for cell in joined.replace(decimal, ".").split("\x00")])
        except ValueError:
            pass  # a header, a missing value or a number in another notation: one by one
        else:
            return values, np.where(np.isnan(values), MISSING, NUMBER)
    plain = patterns(decimal)[0].fullmatch
    parsed = [
        (float(cell.replace(decimal, ".")), NUMBER)
        if plain(cell) and "d" not in cell.lower()
        else _parse_unusual(cell, decimal)
        for cell in cells
    ]
    return np.array([value for value, _ in parsed]), np.array([kind for _, kind in parsed])


@functools.lru_cache(maxsize=8192)
def _parse_unusual(cell: str, decimal: str) -> tuple[float, str]:
    """Number (NaN where there is none) and kind of a cell that is not a plain number; the same words occur again and again."""
    cell = clean(cell)
    value = number(cell, decimal)
    value = SWITCH.get(cell.lower()) if value is None else value
    if value is not None:
        return value, NUMBER
    return np.nan, MISSING if is_missing(cell) else TEXT


def whole_from_first(cells: Sequence[str]) -> np.ndarray | None:
    """A column of whole numbers too large for a double, as differences to the first; None if it is not such a column."""
    try:
        whole = [int(clean(cell)) for cell in cells]
        return np.array([float(value - whole[0]) for value in whole])
    except (ValueError, OverflowError):
        return None


def unit_of_epoch(first: float, last: float) -> str:
    """The unit of a time since 1970 by its least and largest value, where that is no second; "" for other times."""
    units = (
        unit for unit, second in EPOCH_UNITS.items() if _THIS_AGE[0] * second < first <= last < _THIS_AGE[1] * second
    )
    return next(units, "")


def is_since_1970(first: float, last: float) -> bool:
    """Whether these are the first and last of times of our age since 1970, in any unit."""
    return _THIS_AGE[0] < first <= last < _THIS_AGE[1] or unit_of_epoch(first, last) != ""


def dots_are_doubtful(delimiter: str | None) -> bool:
    """Whether a file with this delimiter may come from a language in which dots separate thousands (and commas decimals)."""
    return delimiter in (";", "\t")


def may_be_thousands(cell: str, mark: str) -> bool:
    """Whether a mark in a cleaned cell may separate thousands, as in 12.345: one to three digits before it, three after."""
    return re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(?:{re.escape(mark)}\d{{3}})+", cell, re.ASCII) is not None


def thousands(cells: Sequence[str], decimal: str) -> tuple[bool, bool, bool, bool]:
    """Evidence on the separators in a column: (other mark doubtful, comma doubtful, proven, comma is decimal).

    The mark that is not the decimal one is doubtful in "1.234" beside decimal commas. A decimal comma is doubtful in
    "1,234", and certain once there is a "0,5" or a "12,34". "1.234,5" and "1,234,567" prove that thousands are separated.
    """
    other = "," if decimal == "." else "."
    joined = "\x00".join(cells)
    grouped = [clean(cell) for cell in cells if other in cell] if other in joined else []
    grouped = [cell for cell in grouped if number(cell, decimal) is not None]
    proven = any(decimal in cell or cell.count(other) > 1 for cell in grouped)
    if decimal == "." or "," not in joined:
        return bool(grouped), False, proven, False
    maybe = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
    commas = [cell for cell in cells if "," in cell]
    certain = any(not maybe.fullmatch(clean(cell)) for cell in commas)
    return bool(grouped), not certain, proven, certain


class _Stamp(NamedTuple):
    """A time stamp.

    Attributes:
        date: year, month and day, then the three numbers of a date such as 3/4/2024; "" for each that is not there.
        clock: seconds of the day.
    """

    date: tuple[str, str, str, str, str, str]
    clock: float


def seconds(cells: Sequence[str], where: str) -> tuple[np.ndarray, list[Note]]:
    """Time stamps as seconds from the first one, shape (rows,), NaN where a cell is none; and what was assumed."""
    stamps = [_stamp(text) if is_stamp(text := clean(cell)) else None for cell in cells]
    there = [stamp for stamp in stamps if stamp is not None]
    notes: list[Note] = []
    try:
        readings = [_passed(stamps, day_first) for day_first in _day_orders(there)]
    except ValueError as error:
        raise DataError(f"{where}: a time stamp is not a valid date ({error}); correct it") from error
    values = readings[0] if len(readings) == 1 else _likelier(there, readings, where)
    if not any(any(stamp.date) for stamp in there):
        turns = np.concatenate([[0.0], np.cumsum(np.diff(values) < -43200.0)])
        if turns[-1]:
            text = f"{where}: the clock passes midnight {int(turns[-1])} times; a day was added each time"
            notes.append(Note(Code.FILE_FORMAT, text))
        values = values + 86400.0 * turns
    first = values[np.isfinite(values)]
    return values - (first[0] if first.size else 0.0), notes


def _passed(stamps: Sequence[_Stamp | None], day_first: bool) -> np.ndarray:
    """Seconds from the day of the first stamp, shape (rows,), NaN where there is none."""
    days = np.array([0 if stamp is None else _day(stamp.date, day_first) for stamp in stamps])
    clocks = np.array([np.nan if stamp is None else stamp.clock for stamp in stamps])
    first = int(np.argmax(np.isfinite(clocks)))
    return 86400.0 * (days - days[first]) + clocks


def _day_orders(stamps: Sequence[_Stamp]) -> tuple[bool, ...]:
    """Whether the day is the first number of dates such as 3/4/2024; both answers where the dates do not tell."""
    dates = {(int(stamp.date[3]), int(stamp.date[4])) for stamp in stamps if stamp.date[3]}
    if any(first > 12 for first, _ in dates) or len(dates) <= 1:
        return (not any(second > 12 for _, second in dates),)
    return (False,) if any(second > 12 for _, second in dates) else (True, False)


def _likelier(stamps: Sequence[_Stamp], readings: Sequence[np.ndarray], where: str) -> np.ndarray:
    """The reading of dates in which the samples go on from one date to the next as they do within a date."""
    steps = [np.abs(np.diff(values[np.isfinite(values)])) for values in readings]
    within = np.array([one.date == other.date for one, other in itertools.pairwise(stamps)])
    if within.any():
        most = JUMP * steps[0][within].max()
        fit = [values for values, step in zip(readings, steps, strict=True) if (step <= most).all()]
        if len(fit) == 1:
            return fit[0]
    shown = "/".join(min(stamp.date for stamp in stamps)[3:5])
    raise DataError(
        f"{where}: dates such as {shown} are ambiguous (day or month first); write them as 2025-01-31, or read without time "
        "(time=False, --time none)"
    )


@functools.lru_cache(maxsize=1024)
def _day(date: tuple[str, str, str, str, str, str], day_first: bool) -> int:
    """Number of a day; 0 for a stamp without date."""
    if date[0]:
        return datetime.date(*map(int, date[:3])).toordinal()
    if not date[3]:
        return 0
    day, month = map(int, date[3:5] if day_first else date[4:2:-1])
    return datetime.date(int(date[5]) + (2000 if len(date[5]) == 2 else 0), month, day).toordinal()


@functools.lru_cache(maxsize=1024)
def _same(date: tuple[str, str, str, str, str, str]) -> tuple[str, str, str, str, str, str]:
    """One object for all stamps of a date."""
    return date


def _stamp(cell: str) -> _Stamp | None:
    """The date and the clock in a cell."""
    stamp = _matched(cell)
    if stamp is None:
        return None
    clock = 0.0
    if stamp["min"] is not None:
        clock = 60.0 * int(stamp["min"]) + float(stamp["sec"].replace(",", "."))
    elif stamp["hh"] is not None:
        hour = int(stamp["hh"])
        if stamp["half"]:
            hour = hour % 12 + (12 if stamp["half"][0] in "pP" else 0)
        clock = (
            3600.0 * hour + 60.0 * int(stamp["mm"]) + float((stamp["ss"] or "0").replace(",", ".").replace(":", "."))
        )
    zone = stamp["zone"]
    if zone and zone != "Z":
        clock -= (1 if zone[0] == "+" else -1) * 60.0 * (60 * int(zone[1:3]) + int(zone[-2:]))
    year, month, day, one, other, last = (stamp[key] or "" for key in ("y", "m", "d", "p", "q", "yy"))
    return _Stamp(_same((year, month, day, one, other, last)), clock)
