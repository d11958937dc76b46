"""Faults in the library, put in by hand, each of which the tests of its room must notice.

    python -m tests.hard.library_faults [TEXT ...] [--workers 2]

Every fault of library_faults.toml replaces one piece of text in a module. Tests of a copy of the working tree run with the fault until
the first that fails. With TEXT only faults whose file or description holds one of these texts run. Writes the table to
build/hard/library_faults.md. Exit status: 0 every fault was noticed, 1 one survived.
"""

from __future__ import annotations

import argparse
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_suffix(".toml")
TABLE = ROOT / "build" / "hard" / "library_faults.md"
# Exit status of pytest; 2 also where an error while collecting ends it.
PASSED, FAILED, INTERRUPTED, NO_TEST = 0, 1, 2, 5


class Fault(NamedTuple):
    """One fault.

    Attributes:
        module: file of the library, relative to `hystfit`.
        sound, faulty: text of the module, which occurs there once, and what replaces it.
        breaks: what the fault breaks.
        tests: names of the test files, without `test_` and ending, that run until the first failure.
    """

    module: str
    sound: str
    faulty: str
    breaks: str
    tests: str


def faults() -> tuple[Fault, ...]:
    """All faults, in the order of the file."""
    return tuple(Fault(**row) for row in tomllib.loads(LIST.read_text(encoding="utf-8"))["fault"])


def place_of(fault: Fault, tree: Path = ROOT) -> Path:
    """The module of a fault in a tree.

    Raises:
        LookupError: the text does not occur there exactly once.
    """
    path = tree / "hystfit" / fault.module
    count = path.read_text(encoding="utf-8").count(fault.sound)
    if count != 1:
        raise LookupError(f"{fault.module} holds {fault.sound!r} {count} times: renew the fault")
    return path


@contextmanager
def put_in(fault: Fault, tree: Path) -> Iterator[None]:
    """The tree with a fault, and sound again afterwards."""
    path = place_of(fault, tree)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(fault.sound, fault.faulty), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(text, encoding="utf-8")


def copy_of_tree(folder: Path) -> Path:
    """A copy of all files that git knows."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, names.split("\x00")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def outcome(fault: Fault, tree: Path) -> str:
    """The first test that fails, a slow one where no other does, or "" where the fault survives."""
    with put_in(fault, tree):
        return _first_failure(fault, tree, "not slow") or _first_failure(fault, tree, "slow")


def _first_failure(fault: Fault, tree: Path, marked: str) -> str:
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", marked]
    ended = subprocess.run(
        [*command, *(f"tests/test_{name}.py" for name in fault.tests.split())],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
    )
    if ended.returncode in (PASSED, NO_TEST):
        return ""
    failed = [line for line in ended.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    if ended.returncode not in (FAILED, INTERRUPTED) or not failed:
        raise RuntimeError(f"{fault.breaks}: pytest ended with {ended.returncode}\n{ended.stdout}{ended.stderr}")
    return failed[0].split()[1]


def outcomes(faults: Sequence[Fault], workers: int) -> list[str]:
    """`outcome` of each fault, each worker with a copy of the tree of its own."""
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(workers) as pool:
        trees: queue.Queue[Path] = queue.Queue()
        for number in range(workers):
            trees.put(copy_of_tree(Path(place) / str(number)))

        def one(fault: Fault) -> str:
            tree = trees.get()
            try:
                found = outcome(fault, tree)
            finally:
                trees.put(tree)
            print(f"{'noticed ' if found else 'SURVIVED'} {fault.module}: {fault.breaks}  {found}", flush=True)
            return found

        return list(pool.map(one, faults))


def table(faults: Sequence[Fault], found: Sequence[str]) -> str:
    """Faults with the tests that notice them, as Markdown."""
    rows = [f"| {f.module} | {f.breaks} | {test or '**survived**'} |" for f, test in zip(faults, found, strict=True)]
    return "\n".join(["| module | what the fault breaks | first test that fails |", "| --- | --- | --- |", *rows, ""])


def main() -> int:
    """Run the faults that the arguments name; exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("text", nargs="*")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    chosen = [f for f in faults() if not given.text or any(text in f"{f.module} {f.breaks}" for text in given.text)]
    found = outcomes(chosen, given.workers)
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text(table(chosen, found), encoding="utf-8")
    survived = found.count("")
    print(f"{len(found) - survived} of {len(found)} faults noticed; table: {TABLE.relative_to(ROOT)}")
    return int(survived > 0)


if __name__ == "__main__":
    raise SystemExit(main())
