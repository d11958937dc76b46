"""`hystfit check`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading, command_words
from hystfit.cli.records import load
from hystfit.cli.verbs import as_options
from hystfit.cli.write import finish, items, progress
from hystfit.outcome import Code, Note, Status
from hystfit.outcome.note import has

if TYPE_CHECKING:
    from hystfit.quality.check import QualityReport


def check(
    *loops: Loop,
    data_only: bool = False,
    preisach: bool = False,
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Check the quality of a record, which models it can determine, and which one a fit takes.

    Args:
        data_only: do not compare models, which takes nearly all of the time.
        preisach: also test the assumptions of a Preisach model: wiping-out, congruency, higher-order reversals, and whether
            reversal curves of one family cross or fail to close. Exit status 1: the data can test none of them.
    """
    from hystfit.fitting.data_check import check as judge
    from hystfit.results.measured.loop_values import MEASURED, quantities
    from hystfit.results.provenance import provenance

    output.check()
    data = load(loops, reading)
    with progress("checking"):
        report = judge(data, data_only=data_only)
    determined = any(item.verdict != "no" and item.model != "creep" for item in report.determines)
    determined |= report.advice is not None and has(report.findings, Code.CROSSING)  # by a model that is not judged
    status = Status.OK if determined else Status.NO_MODEL
    content = {"schema": "hystfit.check/1", "status": str(status), **report.to_dict()}
    content["reading"] = {record.name: [note.to_dict() for note in record.notes] for record in data}
    content["provenance"] = provenance(data, None)
    told = {note.text for note in report.findings}
    remarks = dict.fromkeys(note for record in data for note in record.notes if note.text not in told)
    text = "\n".join([report.text().rstrip(), *(["", "Reading of the file", *items(remarks)] if remarks else [])])
    measured = quantities(data)
    content["measured"] = measured.to_dict()
    if any(measured.rows.values()):
        text += f"\n\n{MEASURED}\n{measured!r}"
    if preisach:
        from hystfit.models.preisach import check_family

        with progress("testing Preisach properties"):
            properties = check_family(data)
        content["preisach"] = properties.to_dict()
        text += f"\n\n{properties.text()}"
        status = Status.UNTESTED if properties.outcome == "untested" else Status.OK
    if report.advice is not None or any(note.option for note in report.findings) or _sound_part(report) is not None:
        text += _next_command(loops, reading, remarks, report)

    def save(folder: Path) -> None:
        (folder / "check.txt").write_text(as_options(text) + "\n", encoding="utf-8")

    return finish(text, content, output, save, status=status)


def _next_command(loops: Sequence[str], reading: Reading, remarks: Iterable[Note], report: QualityReport) -> str:
    """The command that follows, and that which reads the file in the other way that its notes propose."""
    changed = dict(note.option for note in report.findings if note.option is not None)
    apart = dict(note.option for note in remarks if note.option is not None)  # the advice is for the records as read
    following = _following(loops, reading, report, changed)
    if not apart:
        return following
    command = command_words(loops, dataclasses.replace(reading, **_values(changed | apart)))
    return f"{following}\nor check the parts as records of their own\nhystfit check {command}"


def _values(options: Mapping[str, str]) -> dict[str, str | bool]:
    """Options of reading by name, those that are switched on as True."""
    return {name: True if value == "true" else value for name, value in options.items() if name != "window"}


def _following(loops: Sequence[str], reading: Reading, report: QualityReport, changed: Mapping[str, str]) -> str:
    """The command that follows, with the options that the findings propose."""
    window = changed.get("window")  # an option of a fit
    command = command_words(loops, dataclasses.replace(reading, **_values(changed)))
    if window is not None:
        return f"\n\nNext: fit the stretch at one level\nhystfit fit {command} --window={window}"
    if report.advice is None and not changed and (part := _sound_part(report)) is not None:
        return f"\n\nNext: fit the part before the {part[0]}\nhystfit fit {command} --window=:{part[1]:.10g}"
    if changed or report.advice is None:  # the advice is for the record before the proposed change
        return f"\n\nNext: check the records with the changes proposed above\nhystfit check {command}"
    return f"\n\nNext: fit this model\nhystfit fit {command} --model {report.advice.model}"


def _sound_part(report: QualityReport) -> tuple[str, float] | None:
    """The end of the undamaged part of a single record: its cause ("failure" or "damage") and its place; None where nothing is damaged."""
    ends = {"failure": report.records[0].fails_at, "damage": report.records[0].whole_until}
    known = [(cause, end) for cause, end in ends.items() if end is not None]
    return known[0] if known and len(report.records) == 1 else None
