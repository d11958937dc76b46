"""The pages that verbs write beside their result.json, all in the style of the report on a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hystfit.cli.verbs import as_options
from hystfit.outcome import Note, Status, Table
from hystfit.outcome.table import number
from hystfit.results.webpage import Block, Page, Picture


def page_of(
    title: str,
    status: Status | str,
    verb: str,
    answer: Sequence[tuple[str, str]],
    sections: Sequence[tuple[str, Sequence[Block]]],
) -> Page:
    """A page whose status is explained in the words of its verb.

    Args:
        title: one line.
        status: of the result.
        verb: that made it.
        answer: names and values at the top.
        sections: heading and blocks of each.
    """
    status = Status(status)
    words = "Usable." if status.usable else f"Not usable as it is: {as_options(status.advice(verb))}."
    return Page(title, words, status.usable, answer, sections)


def notes_of(notes: Sequence[Note]) -> list[str]:
    """Notes in the words of the shell."""
    return [as_options(str(note)) for note in notes]


def forc_page(
    title: str,
    how: str,
    table: Table,
    numbers: Any,
    units: Mapping[str, str],
    notes: Sequence[str],
    figures: Mapping[str, Any],
) -> Page:
    """The page of `hystfit forc`.

    Args:
        title: the curves in words.
        how: the density was found.
        table: all numbers.
        numbers: `ForcNumbers`.
        units: of the curves.
        notes: on the curves.
        figures: forc, coercivity and curves.
    """
    unit = units["u"]
    answer = [
        ("Median coercivity", f"{number(numbers.median_coercivity)} {unit}".rstrip()),
        ("Interaction of the ridge", f"{number(numbers.ridge)} {unit}".rstrip()),
        ("Density", how),
        ("Next", "hystfit fit LOOP --model preisach-forc"),
    ]
    captions = {
        "forc": f"FORC diagram ({how}); red: positive, blue: negative; contours of a smoothed copy",
        "coercivity": "Coercivity distribution: the density integrated over the interaction",
        "curves": "Reversal curves",
    }
    shown = [Picture(figures[name], caption) for name, caption in captions.items()]
    return page_of(
        title, Status.OK, "forc", answer, [("Pictures", [shown]), ("Numbers", [table]), ("Notes", [list(notes)])]
    )
