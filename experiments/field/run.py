"""A benchmark of the field: public measured loops, the outputs that a program predicts, and its errors beside those of others.

    python experiments/field/run.py [--quick] [--out FOLDER] [--only TASK ...]
    python experiments/field/run.py --write FOLDER          each task as CSV: record, t, u, y (empty where it is asked)
    python experiments/field/run.py --score FOLDER          errors of the same files with column y filled in, by any program

The tasks, with the data by address, revision and SHA-256, are in tasks.toml; `entrants.py` holds the programs that run here. The quick form
takes three tasks and leaves out the search, the differential evolution and the network. Writes results.json and the tables to out/ and,
in the full form with all data, RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import argparse
import sys
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from common import Results, table
from entrants import ENTRANTS
from tasks import DEFINITION, HERE, VERSION, Task, of_name

import hystfit as hf
from hystfit.errors import DataError, HystfitError

QUICK_TASKS = ("piezo-continued", "u-damper", "ferrite-loop")
QUICK_ENTRANTS = ("hystfit, model by name", "straight line", "last cycle", "ten plays")
NAMES = tuple(DEFINITION["tasks"])
ENTRIES = tomllib.loads((HERE / "entries.toml").read_text(encoding="utf-8"))["entries"]
RULES = """
A program gets the input of every record and some of its outputs, and predicts the others. The error is the root mean square error of the
predicted outputs in percent of their range. Nothing of the asked outputs may be used, and no setting may be chosen by them. "free" means
that the zero of the sensor is another one in the predicted record: its mean error does not count.

"Model by name" is the model that is known to suit such data: no blind choice.

To enter: `python experiments/field/run.py --write FOLDER` writes each task as a CSV file of records, times, inputs and outputs, empty where
they are asked. Fill in the column `y`, and `--score FOLDER` prints the errors. State the version, the program with its version, the number
of fitted parameters and the time; an entry is a section of entries.toml.
"""


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="three tasks, without downloads")
    parser.add_argument("--out", type=Path, default=None, help="folder for results.json")
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES, help="these tasks")
    parser.add_argument("--write", type=Path, default=None, metavar="FOLDER", help="write the tasks as CSV")
    parser.add_argument("--score", type=Path, default=None, metavar="FOLDER", help="score predictions")
    return parser.parse_args()


def enter(task: Task, results: Results, entrants: Sequence[str]) -> tuple[list, list]:
    """Rows of errors and of parameters and seconds, one cell an entrant."""
    errors, costs = [], []
    for name in entrants:
        began = time.perf_counter()
        try:
            prediction = ENTRANTS[name](task)
        except HystfitError as error:
            print(f"  {task.name}, {name}: {error}")
            errors.append(None)
            costs.append(None)
            continue
        errors.append(results.add(f"{task.name}: {name}", task.score(prediction.outputs)))
        costs.append(f"{prediction.parameters} / {time.perf_counter() - began:.1f}")
    return [task.name, *errors], [task.name, *costs]


def best_known(errors: Sequence[list], entrants: Sequence[str]) -> str:
    """The entries of other programs, and the least error of each task with the program that has it."""
    rows = []
    for name, *own in errors:
        others = [entry["errors"].get(name) for entry in ENTRIES]
        known = zip([*own, *others], [*entrants, *(entry["program"] for entry in ENTRIES)], strict=True)
        least, program = min((error, program) for error, program in known if error is not None)
        rows.append([name, *others, least, program])
    return table(["task", *(f"{entry['program']} ({entry['who']})" for entry in ENTRIES), "best known", "by"], rows)


def sources(tasks: Sequence[Task]) -> str:
    """What is measured, given and asked, and where the data are."""
    rows = []
    for task in tasks:
        origin = {f"{record.source} {record.sha256 or ''}".strip() for record in task.records}
        given, asked = (sum(int(mask.sum()) for mask in masks) for masks in (task.given, task.asked))
        rows.append(
            [task.name, task.about, given, asked, "free" if task.offset_free else "", "; ".join(sorted(origin))]
        )
    return table(["task", "given; asked", "outputs given", "asked", "offset", "data"], rows)


def main() -> None:
    """Run, check and write the page; or write or score the tasks."""
    options = arguments()
    hf.enable_x64()
    if options.write or options.score:
        folder = options.write or options.score
        folder.mkdir(parents=True, exist_ok=True)
        for name in options.only:
            task, path = of_name(name), folder / f"{name}.csv"
            if options.write:
                task.write(path)
            elif path.exists():
                print(f"{name:<24} {task.score(task.read(path)):.4g} %")
        return
    results = Results(HERE, options.quick, options.out)
    entrants = QUICK_ENTRANTS if options.quick else tuple(ENTRANTS)
    tasks, errors, costs = [], [], []
    for name in QUICK_TASKS if options.quick else options.only:
        try:
            task = of_name(name, download=not options.quick)
        except DataError as error:
            results.skipped[name] = str(error)
            print(f"  skipped: {name}: {error}")
            continue
        rows = enter(task, results, entrants)
        tasks.append(task)
        errors.append(rows[0])
        costs.append(rows[1])
    if options.only == NAMES:
        head = ["task", *entrants]
        results.publish(
            f"Benchmark of the field, version {VERSION}",
            "experiments/field/run.py",
            {"Rules": RULES, "Errors, %": table(head, errors), "Entries of other programs, %": best_known(errors, entrants),
             "Fitted parameters / seconds": table(head, costs), "Tasks": sources(tasks)},
        )  # fmt: skip
    results.finish()


if __name__ == "__main__":
    main()
