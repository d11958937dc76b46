"""`hystfit check`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystfit.cli.options import DEFAULT_READING, STDOUT, Loop, Output, Reading
from hystfit.cli.records import load
from hystfit.cli.write import finish, items, progress
from hystfit.outcome import Status

if TYPE_CHECKING:
    from hystfit.data.record import Dataset

_MOST_GROUPS, _MOST_NAMES = 8, 5  # of Preisach properties and of records in a line, in the text


def check(*loops: Loop, preisach: bool = False, reading: Reading = DEFAULT_READING, output: Output = STDOUT) -> int:
    """Check the quality of a record and which models it can determine.

    Args:
        preisach: also test the assumptions of a Preisach model: wiping-out, congruency, higher-order reversals, and whether
            reversal curves of one family cross or fail to close. Exit status 1: the data can test none of them.
    """
    from hystfit.models.data_check import check as judge
    from hystfit.results.result import provenance

    output.check()
    data = load(loops, reading)
    with progress("checking"):
        report = judge(data)
    determined = any(item.verdict != "no" and item.model != "creep" for item in report.determines)
    status = Status.OK if determined else Status.NO_MODEL
    content = {"schema": "hystfit.check/1", "status": str(status), **report.to_dict()}
    content["reading"] = {record.name: [note.to_dict() for note in record.notes] for record in data}
    content["provenance"] = provenance(data, None)
    remarks = dict.fromkeys(note for record in data for note in record.notes)
    text = "\n".join([report.text().rstrip(), *(["", "Reading of the file", *items(remarks)] if remarks else [])])
    if preisach:
        properties, content["preisach"] = _properties(data)
        text += f"\n\n{properties}"
        status = Status.UNTESTED if content["preisach"]["status"] == Status.UNTESTED else Status.OK

    def save(folder: Path) -> None:
        (folder / "check.txt").write_text(text + "\n", encoding="utf-8")

    return finish(text, content, output, save, status=status)


def _properties(data: Dataset) -> tuple[str, dict[str, Any]]:
    """Preisach properties of every record: as text, and for result.json."""
    from hystfit.models.preisach import check_preisach
    from hystfit.quality.reversal_curves import recognize_family

    with progress("testing Preisach properties"):
        checks = [check_preisach(record, model=True) for record in data]
    tested = [one for one in checks if one.tested]
    family = recognize_family(data)
    fails = any(outcome == "fails" for one in tested for outcome in one.outcomes.values())
    status = "untested" if not tested else "fails" if fails else "holds"
    lines = ["Preisach properties (limit: 2 % of the output's range)"]
    if family is not None:
        status = "holds" if status == "untested" and not family.notes else "fails" if family.notes else status
        lines += [f"  {family.words()}", *(f"    - {note}" for note in family.notes)]
        if not family.notes:
            lines.append("    - the curves close and do not cross: weights >= 0 can reproduce them")
    groups: dict[str, list[str]] = {}  # names of the records with one and the same text
    for one in tested or checks:
        groups.setdefault(one.text(), []).append(one.record)
    for text, names in list(groups.items())[:_MOST_GROUPS]:
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        lines += [f"  {', '.join(names[:_MOST_NAMES])}{more}", text]
    if not tested and family is None:
        lines.append(f"  not tested: {Status.UNTESTED.advice('check')}")
    if len(groups) > _MOST_GROUPS:
        lines.append(f"  ({len(groups) - _MOST_GROUPS} more groups of records are in result.json)")
    return "\n".join(lines), {"status": status, "records": {one.record: one.to_dict() for one in checks}}
