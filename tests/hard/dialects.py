"""Text files with known numbers in random dialects: delimiters, marks, headers, stamps, encodings, missing cells, left-out lines."""

from __future__ import annotations

import bz2
import dataclasses
import datetime
import gzip
import lzma
from typing import Any

import numpy as np

_NAMES = {  # time, input, output, and the encodings in which they can be written
    "plain": (("t", "u", "y"), ("utf-8", "cp1252", "utf-16", "utf-8-sig")),
    "words": (("Time", "Voltage", "Displacement"), ("utf-8", "cp1252", "utf-16", "utf-8-sig")),
    "steel": (("time", "strain", "stress"), ("utf-8", "cp1252")),
    "field": (("Time", "Field", "Moment"), ("utf-8", "utf-16-le")),
    "german": (("Zeit", "Spannung", "Weg"), ("utf-8", "cp1252")),
    "chinese": (("时间", "电压", "位移"), ("utf-8", "gb18030", "utf-16")),
    "japanese": (("時間", "電圧", "変位"), ("utf-8", "cp932")),
}
_UNITS = {"plain": ("s", "V", "um"), "words": ("s", "V", "um"), "steel": ("s", "%", "MPa"), "field": ("s", "Oe", "emu")}
_WORDS = ("nan", "NaN", "", "OVF", "OL", "---", "#N/A", "-9999", "9.91e37", "overrange", "1e99", "?!", "Err_3", "inf")


@dataclasses.dataclass(frozen=True)
class Case:
    """A file, how it is read, and the numbers that were written in it.

    Attributes:
        content: of the file; suffix: of its name.
        arguments: of `hystfit.read`.
        t, u, y: the truth, shape (T,); t is None where the file has no time, y is NaN where it is missing.
        traits: what is odd in the file.
    """

    content: bytes
    suffix: str
    arguments: dict[str, Any]
    t: np.ndarray | None
    u: np.ndarray
    y: np.ndarray
    traits: tuple[str, ...]


class _Writer:
    """One random dialect."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng([7, seed])
        self.traits: list[str] = []
        self.arguments: dict[str, Any] = {}

    def chance(self, probability: float, trait: str) -> bool:
        """Whether the file has a trait, which is noted."""
        hit = bool(self.rng.random() < probability)
        if hit:
            self.traits.append(trait)
        return hit

    def pick(self, *choices: Any) -> Any:
        """One of some choices."""
        return choices[int(self.rng.integers(len(choices)))]

    def case(self) -> Case:
        """The file."""
        rng = self.rng
        self.delimiter = self.pick(",", ",", ";", ";", "\t", "\t", " ", "   ", "|", ", ")
        self.traits.append(f"delimiter {self.delimiter!r}")
        self.decimal = "," if "," not in self.delimiter and self.chance(0.35, "decimal comma") else "."
        self.rows = int(rng.integers(4, 60))
        self.numbers()
        self.stamps()
        columns, names = self.columns()
        lines = self.lines(columns)
        lines = self.spoiled(lines)
        text = self.header(names) + lines + self.footer()
        return self.packed(text)

    def numbers(self) -> None:
        """The truth, as numbers of a few decimals."""
        rng, n = self.rng, self.rows
        digits = int(rng.integers(1, 7))
        phase = np.linspace(0, rng.uniform(3, 40), n)
        scale_u, scale_y = 10.0 ** rng.uniform(-1, 4, 2)
        self.digits = digits
        self.style = self.pick("fixed", "fixed", "general", "exponent")
        self.u = self.rounded(scale_u * np.sin(phase) * rng.uniform(0.5, 1) + scale_u * rng.normal(0, 0.01, n))
        self.y = self.rounded(scale_y * np.sin(phase - 0.4) + scale_y * rng.choice([0.0, 0.5, 3.0]))
        self.dt = float(self.pick(0.005, 0.01, 0.1, 0.5, 1.0, 2.0))
        self.t = np.round(self.dt * np.arange(n), 6) + self.pick(0.0, 0.0, 10.0)
        self.has_time = not self.chance(0.2, "no time")
        if np.unique(self.u).size < 3 or np.unique(self.y).size < 3:
            self.u, self.y = self.rounded(np.sin(phase) * 1e3), self.rounded(np.cos(phase) * 1e3)
        self.account = self.pick(None, None, None, None, None, "(", "-")
        self.grouped = self.style == "fixed" and self.chance(0.12, "thousands")
        self.unicode_minus = self.chance(0.04, "Unicode minus")
        self.plus = self.chance(0.05, "plus signs")
        self.exponent_d = self.style == "exponent" and self.chance(0.1, "exponent D")

    def rounded(self, values: np.ndarray) -> np.ndarray:
        """Values as they are written."""
        return np.array([float(self.plain(v)) for v in values])

    def plain(self, value: float) -> str:
        """A number with a decimal point."""
        forms = {
            "fixed": f"{value:.{self.digits}f}",
            "general": f"{value:.{self.digits + 2}g}",
            "exponent": f"{value:.{self.digits}e}",
        }
        return forms[self.style]

    def written(self, value: float) -> str:
        """A number in this dialect."""
        text = self.plain(value)
        negative, text = text.startswith("-"), text.lstrip("-")
        if self.exponent_d:
            text = text.replace("e", "D")
        whole, point, rest = text.partition(".")
        if self.grouped and whole.isdigit():
            whole = f"{int(whole):,}".replace(",", "." if self.decimal == "," else ",")
        text = whole + (self.decimal if point else "") + rest
        if negative and self.account:
            return f"({text})" if self.account == "(" else f"{text}-"
        minus = "\u2212" if self.unicode_minus else "-"
        text = (minus if negative else "+" if self.plus else "") + text
        quoted = self.delimiter.strip() != "" and (self.delimiter.strip() in text)
        return f'"{text}"' if quoted else text

    def stamps(self) -> None:
        """Cells of the time column, or of a date and a clock."""
        kind = self.pick("seconds", "seconds", "seconds", "iso", "two", "clock", "german", "ampm", "minutes")
        self.clock: list[list[str]] = []
        if not self.has_time:
            return
        if kind == "seconds":
            keep = self.account, self.plus, self.grouped, self.exponent_d
            self.account = None
            places = 3 if self.style != "general" else 6
            self.clock = [[self.pointed(f"{t:.{places}f}")] for t in self.t]
            self.account, self.plus, self.grouped, self.exponent_d = keep
            return
        self.traits.append(f"stamps {kind}")
        begin = datetime.datetime(2024, int(self.rng.integers(1, 13)), int(self.rng.integers(13, 28)), 23, 59, 50)
        begin = begin.replace(hour=int(self.pick(3, 10, 23)))
        if kind == "minutes":
            self.t = 60.0 * np.arange(self.rows)
        moments = [begin + datetime.timedelta(seconds=float(t)) for t in self.t]
        self.t = self.t - self.t[0]
        fraction = lambda m: f".{m.microsecond // 1000:03d}"
        for m in moments:
            clock = f"{m:%H:%M:%S}" + fraction(m)
            cells = {
                "iso": [f"{m:%Y-%m-%d}" + self.iso_gap() + clock],
                "two": [f"{m:%Y-%m-%d}", clock],
                "clock": [clock],
                "german": [f"{m:%d.%m.%Y} {m:%H:%M:%S}" + fraction(m).replace(".", self.pointed("."))],
                "ampm": [f"{m:%Y-%m-%d} {m:%I:%M:%S}{fraction(m)} {m:%p}"],
                "minutes": [f"{m:%Y-%m-%d}", f"{m:%H:%M}"],
            }[kind]
            quote = "," in self.delimiter and any("," in cell for cell in cells)
            self.clock.append([f'"{cell}"' for cell in cells] if quote else cells)

    def iso_gap(self) -> str:
        """What separates date and clock in one cell."""
        return "T" if self.delimiter.strip() == "" else " "

    def pointed(self, text: str) -> str:
        """Text with the decimal mark of the dialect."""
        return text.replace(".", self.decimal)

    def columns(self) -> tuple[list[list[str]], list[str]]:
        """Cells of all rows, and a name for each column."""
        self.family = self.pick(*_NAMES)
        names, self.encodings = _NAMES[self.family]
        extra = self.pick("", "", "", "temperature", "index", "text", "constant")
        u, y = [self.written(v) for v in self.u], [self.written(v) for v in self.y]
        self.missing_y = np.zeros(self.rows, dtype=bool)
        if self.chance(0.25, "missing outputs"):
            word = str(self.pick(*_WORDS))
            word = word if word or self.delimiter.strip() or self.delimiter == "\t" else "nan"
            self.traits.append(f"missing {word!r}")
            self.missing_y = self.rng.random(self.rows) < 0.1
            self.missing_y[0] = False
            y = [word if gone else cell for cell, gone in zip(y, self.missing_y, strict=True)]
        table = [*zip(*self.clock, strict=True)] if self.has_time else []
        titles = ([names[0]] if len(table) == 1 else ["date", names[0]]) if table else []
        pair = [(u, names[1]), (y, names[2])]
        named = not self.chance(0.2, "no header")
        self.named = named
        if self.chance(0.15, "output first"):
            pair.reverse()
        if named and extra:
            self.traits.append(f"beside: {extra}")
            cells = {
                "temperature": [self.pointed(f"{20 + 0.1 * k:.1f}") for k in range(self.rows)],
                "index": [str(k + 1) for k in range(self.rows)],
                "text": [self.pick("on", "off") for _ in range(self.rows)],
                "constant": ["7"] * self.rows,
            }[extra]
            title = {"temperature": "Temperature", "index": "No", "text": "state", "constant": "flag"}[extra]
            pair.insert(int(self.rng.integers(3)), (cells, title))
        columns = [list(column) for column in table] + [cells for cells, _ in pair]
        titles += [title for _, title in pair]
        if "output first" in self.traits and not named:
            position = len(table)
            if table and not self.delimiter.strip() and self.delimiter != "\t":
                position = sum(len(cells[0].split()) for cells in table)
            self.arguments |= {"input": position + 1, "output": position}
        if named and self.chance(0.2, "columns by name"):
            self.arguments |= {"input": names[1], "output": names[2]}
        return columns, titles

    def lines(self, columns: list[list[str]]) -> list[str]:
        """The rows as text."""
        end = self.delimiter if self.delimiter.strip() and self.chance(0.07, "trailing delimiters") else ""
        if self.delimiter.strip() == "" and self.delimiter != "\t" and self.chance(0.3, "aligned"):
            width = [max(map(len, column)) for column in columns]
            columns = [[cell.rjust(w) for cell in column] for column, w in zip(columns, width, strict=True)]
        self.end = end
        return [self.delimiter.join(row) + end for row in zip(*columns, strict=True)]

    def spoiled(self, lines: list[str]) -> list[str]:
        """The rows with comments between, blank lines at the end, or a cut last row."""
        if self.chance(0.06, "comments within"):
            for _ in range(2):
                lines.insert(int(self.rng.integers(1, len(lines))), str(self.pick("# pause", "% note 3", "// checked")))
        return lines

    def header(self, names: list[str]) -> list[str]:
        """Lines above the rows."""
        rng = self.rng
        above = []
        if self.chance(0.3, "metadata"):
            stock = (
                "Operator: Kim",
                "Gain = 3",
                "Sample;4711",
                "Rate\t200",
                "Date: 2024-03-01",
                "made by hand",
                "Comment,none",
            )
            above = [str(self.pick(*stock)) for _ in range(int(rng.integers(1, 6)))]
            above += [""] * int(rng.integers(0, 2))
        if not self.named:
            return above
        units = _UNITS.get(self.family)
        form = self.pick("plain", "plain", "comment", "units row", "bracketed", "quoted", "lines")
        mark = self.delimiter
        titles = [*names]
        if units and form in ("units row", "bracketed", "lines"):
            known = dict(zip(_NAMES[self.family][0], units, strict=True))
            self.traits.append(f"header: {form}")
            if form == "bracketed":
                gap = "" if not mark.strip() else " "
                titles = [f"{name}{gap}[{known[name]}]" if name in known else name for name in titles]
            elif form == "lines" and mark.strip():
                titles = [f'"{name}\n[{known[name]}]"' if name in known else f'"{name}"' for name in titles]
            elif form == "units row":
                row = [known.get(name, "-") for name in titles]
                return [*above, mark.join(titles) + self.end, mark.join(row) + self.end]
        elif form == "comment":
            self.traits.append("header: comment")
            lead = self.pick("#", "# ", "%", "% ", "//", "!")
            return [*above, lead + self.pick(mark, " ", mark).join(titles)]
        elif form == "quoted" and mark.strip():
            titles = [f'"{name}"' for name in titles]
        if self.chance(0.03, "numbers above the header") and not above:
            above = [mark.join(self.pointed(f"{k}.5") for k in range(len(titles)))]
        return [*above, mark.join(titles) + self.end]

    def footer(self) -> list[str]:
        """Lines below the rows."""
        return ["", "End of test"] if self.chance(0.05, "footer") else [""] if self.chance(0.1, "blank end") else []

    def packed(self, lines: list[str]) -> Case:
        """The bytes of the file."""
        ends = self.pick("\n", "\n", "\r\n", "\r")
        text = ends.join(lines) + (ends if not self.chance(0.1, "no last line end") else "")
        encoding = self.pick(*self.encodings)
        self.traits.append(encoding)
        raw = text.encode(encoding, "replace")
        suffix = str(self.pick(".csv", ".txt", ".dat"))
        if self.unicode_minus and encoding not in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "gb18030"):
            raw = text.encode("utf-8")
        packing = self.pick(*[""] * 9, ".gz", ".xz", ".bz2")
        if packing:
            raw = {".gz": gzip.compress, ".xz": lzma.compress, ".bz2": bz2.compress}[packing](raw)
            self.traits.append(packing)
        y = np.where(self.missing_y, np.nan, self.y)
        return Case(
            raw, suffix + packing, self.arguments, self.t if self.has_time else None, self.u, y, tuple(self.traits)
        )


def case_of(seed: int) -> Case:
    """The file of a seed."""
    return _Writer(seed).case()
