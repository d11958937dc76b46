"""Text of tables: columns with their names and units in the styles of people and instruments, and the bytes of a file."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import numpy as np

from .drawing import Draw
from .truth import Loop

# Spellings of a unit, by its spelling in hystfit.
SPELLINGS = {
    "um": ("um", "µm", "μm", "um", "micron"),
    "nm": ("nm",),
    "mm": ("mm", "mm", "mm", "millimeter"),
    "in": ("in", "in", "inch", "inches"),
    "A/m": ("A/m", "A/m", "A_per_meter", "A/m"),
    "kA/m": ("kA/m",),
    "Oe": ("Oe", "Oe", "Oersted"),
    "T": ("T", "T", "Tesla", "tesla"),
    "mT": ("mT", "mT", "millitesla"),
    "emu": ("emu",),
    "A*m^2": ("Am2", "A·m²", "Am²", "A m^2", "A*m^2"),
    "emu/g": ("emu/g",),
    "Am2/kg": ("Am2/kg", "A m2/kg", "Am²/kg"),
    "uC/cm2": ("uC/cm2", "µC/cm²", "uC/cm^2", "µC/cm^2"),
    "kV/cm": ("kV/cm",),
    "V": ("V", "V", "V", "Volt", "volts"),
    "kN": ("kN",),
    "N": ("N", "N", "N", "Newton"),
    "lbf": ("lbf", "lbf", "lb"),
    "kip": ("kip", "kips"),
    "MPa": ("MPa",),
    "degC": ("°C", "degC", "C", "°C"),
    "s": ("s", "s", "sec", "Sec", "seconds"),
    "%": ("%",),
    "A": ("A", "A", "Amp"),
    "mAh": ("mAh",),
    "Ah": ("Ah",),
}
STYLES = {
    "parentheses": "{name} ({unit})",
    "tight": "{name}({unit})",
    "brackets": "{name} [{unit}]",
    "slash": "{name} / {unit}",
    "comma": "{name}, {unit}",
    "in": "{name} in {unit}",
    "underscore": "{name}_{unit}",
    "blank": "{name} {unit}",
}


def engineering(value: float) -> str:
    """A number of seven digits with an exponent that is a multiple of three, as MicroMag writes it."""
    power = 3 * math.floor(math.log10(abs(value)) / 3) if value else 0
    mantissa = value / 10.0**power
    places = 6 - (len(str(int(abs(mantissa)))) - 1)
    return f"{mantissa:+.{places}f}E{power:+03d}"


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: without its unit.
        values: numbers, or texts, shape (rows,); NaN is an empty cell.
        unit: as hystfit spells it.
        form: format of the numbers, or a function that writes one.
        spelled: the unit as written; None picks none and writes `unit`.
    """

    name: str
    values: np.ndarray
    unit: str = ""
    form: str | Callable[[float], str] = ".6g"
    spelled: str | None = None

    @property
    def shown_unit(self) -> str:
        """The unit as written."""
        return self.unit if self.spelled is None else self.spelled

    @functools.cached_property
    def cells(self) -> list[str]:
        """The values as text with a decimal point."""
        if self.values.dtype.kind in "US":
            return [str(value) for value in self.values]
        form = self.form
        write = form if callable(form) else lambda value: format(value, form)
        return ["" if np.isnan(value) else write(float(value)) for value in self.values]

    @functools.cached_property
    def written(self) -> np.ndarray:
        """The numbers that the text stands for."""
        return np.array([float(cell) if cell else np.nan for cell in self.cells])

    def renamed(self, name: str) -> Column:
        """The column under another name."""
        return dataclasses.replace(self, name=name)


def loop(u: Column, y: Column, t: Column | None = None, rows: slice | np.ndarray = slice(None)) -> Loop:
    """The record of two columns.

    Args:
        t: a time in seconds that a reader has to find.
        rows: those of the record.
    """
    clock = None if t is None else t.written[rows] - t.written[rows][0]
    return Loop(u.written[rows], y.written[rows], u.unit, y.unit, clock)


@dataclasses.dataclass(frozen=True)
class Dialect:
    """How a table is written.

    Attributes:
        delimiter, decimal: marks.
        style: of units: a key of `STYLES`, "row", "row in parentheses", "row in brackets", or "none".
        quoted: whether names are in quotes.
        trailing: whether lines end in a delimiter.
        lead: before the line of names, such as "% ".
    """

    delimiter: str = ","
    decimal: str = "."
    style: str = "parentheses"
    quoted: bool = False
    trailing: bool = False
    lead: str = ""


def spelled(draw: Draw, columns: Sequence[Column], dialect: Dialect) -> list[Column]:
    """The columns with their units in one of the spellings that this dialect can hold, the same in all columns."""
    chosen: dict[str, str] = {}
    for unit in dict.fromkeys(column.unit for column in columns):
        choices = SPELLINGS.get(unit, (unit,))
        if dialect.style in ("underscore", "slash", "comma", "in"):
            choices = tuple(c for c in choices if c.isascii() and c.isalnum()) or (unit,)
        if dialect.delimiter.strip() == "":
            choices = tuple(c for c in choices if " " not in c)
        chosen[unit] = draw.pick(*choices)
    return [c if c.spelled is not None else dataclasses.replace(c, spelled=chosen[c.unit]) for c in columns]


def titles(columns: Sequence[Column], dialect: Dialect) -> list[str]:
    """The lines of names and units."""
    row = lambda cells: dialect.delimiter.join(f'"{c}"' if dialect.quoted else c for c in cells)
    names = [column.name for column in columns]
    units = [column.shown_unit for column in columns]
    end = dialect.delimiter if dialect.trailing else ""
    if dialect.style in STYLES:
        form = STYLES[dialect.style]
        return [
            dialect.lead + row(form.format(name=n, unit=u) if u else n for n, u in zip(names, units, strict=True)) + end
        ]
    if dialect.style == "none":
        return [dialect.lead + row(names) + end]
    around = {"row in parentheses": "({})", "row in brackets": "[{}]"}.get(dialect.style, "{}")
    under = [
        around.format(u) if u else "" if dialect.delimiter.strip() or dialect.delimiter == "\t" else "-" for u in units
    ]
    return [dialect.lead + row(names) + end, dialect.lead + row(under) + end]


def rows(columns: Sequence[Column], dialect: Dialect) -> list[str]:
    """The lines of numbers; columns that end early leave empty cells."""
    length = max(len(column.cells) for column in columns)
    table = []
    for column in columns:
        numbers = column.values.dtype.kind not in "US"
        cells = [cell.replace(".", dialect.decimal) if numbers else cell for cell in column.cells]
        cells = [f'"{cell}"' if dialect.delimiter.strip() and dialect.delimiter in cell else cell for cell in cells]
        table.append(cells + [""] * (length - len(cells)))
    end = dialect.delimiter if dialect.trailing else ""
    return [dialect.delimiter.join(row) + end for row in zip(*table, strict=True)]


def table(draw: Draw, columns: Sequence[Column], dialect: Dialect) -> list[str]:
    """All lines of a table."""
    columns = spelled(draw, columns, dialect)
    return titles(columns, dialect) + rows(columns, dialect)


def packed(
    draw: Draw, lines: Sequence[str], encodings: Sequence[str] = ("utf-8", "utf-8", "utf-8-sig", "cp1252")
) -> bytes:
    """The bytes of lines; where a character is not in the encoding drawn, UTF-8."""
    end = draw.pick("\r\n", "\n")
    text = end.join(lines) + draw.pick(end, end, "", end * 2)
    try:
        return text.encode(draw.pick(*encodings))
    except UnicodeEncodeError:
        return text.encode("utf-8")
