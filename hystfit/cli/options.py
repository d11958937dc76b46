"""Options that several verbs share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Group, Parameter

from hystfit.errors import DataError, ParameterError

FILE = Group("Reading the file", sort_key=1)
SPLIT = Group("What is fitted, what is tested", sort_key=2)
Text = Annotated[str | None, Parameter(group=FILE)]
Part = Annotated[str | None, Parameter(group=SPLIT)]
Flag = Annotated[bool, Parameter(group=SPLIT)]


@Parameter(name="*")
@dataclass(frozen=True)
class Reading:
    """How a file is read.

    Args:
        time: column of time, by name or number from 0; "none" reads without time. Guessed, and said, where not given.
        input: column of the input.
        output: column of the output.
        by: column whose values tell several curves apart.
        only: which curves: values (3,4) or positions from 0 (1::4).
        where: rows to read, as column=value.
        gaps: "split" makes a record of each piece where the input is missing; "error" refuses.
        sheet: sheet of a workbook.
        delimiter: of text, where the one found is wrong.
        decimal: mark, "." or ",".
        encoding: of text.
    """

    time: Text = None
    input: Text = None
    output: Text = None
    by: Text = None
    only: Text = None
    where: Text = None
    gaps: Annotated[str, Parameter(group=FILE)] = "error"
    sheet: Text = None
    delimiter: Text = None
    decimal: Text = None
    encoding: Text = None


@Parameter(name="*")
@dataclass(frozen=True)
class Split:
    """Which samples are fitted and which are kept for the test.

    Args:
        window: fit only samples in start:stop (seconds, or sample numbers without time); 5:25, :27, 25:.
        test_window: report the error on these samples, which are not fitted.
        test: another file (or data set) to report the error on.
        test_only: curves to report the error on (with --by), which are not fitted.
        rest: input on which the device rested before each record began, such as 0; the first input of the record where not given.
        refit_offset: shift the prediction of each test record to its mean (another zero of the sensor).
    """

    window: Part = None
    test_window: Part = None
    test: Part = None
    test_only: Part = None
    rest: Annotated[float | None, Parameter(group=SPLIT)] = None
    refit_offset: Flag = False


def limits(text: str | None) -> tuple[float | None, float | None] | None:
    """Start and stop of a window written as start:stop.

    Raises:
        DataError: it is not of that form.
    """
    if text is None:
        return None
    parts = text.split(":")
    try:
        start, stop = (float(part) if part.strip() else None for part in parts)
    except ValueError:
        raise DataError(f"a window is start:stop, such as 5:25, 25: or :27; got {text!r}") from None
    if start is not None and stop is not None and not start < stop:
        raise DataError(f"window {text!r} is empty: its start must lie before its stop")
    return start, stop


def held(pairs: list[str]) -> dict[str, float | None]:
    """Parameters to hold from NAME (at its starting value) and NAME=VALUE.

    Raises:
        ParameterError: a value is not a number, or a name comes twice.
    """
    found: dict[str, float | None] = {}
    for pair in pairs:
        name, mark, value = (part.strip() for part in pair.partition("="))
        if not name or name in found:
            raise ParameterError(f"expected NAME or NAME=VALUE, each name once; got {pair!r}")
        try:
            found[name] = float(value) if mark else None
        except ValueError:
            raise ParameterError(f"{pair!r}: {value!r} is not a number") from None
    return found
