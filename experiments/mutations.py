"""Deliberate faults in the library or in a surrogate, each of which must make an expectation of an experiment fail.

    python experiments/mutations.py [EXPERIMENT ...] [--only TEXT] [--list]

Every `experiments/EXPERIMENT/mutations.py` holds a tuple MUTATIONS of `common.Mutation`. Each runs in a process of its own, on the
quick form of its part; each part also runs without a fault, which must meet its expectations. Writes the tables of the experiments
named (all by default) to MUTATIONS.md, except with --only. Exit status: 0 every fault was noticed, 1 a fault survived or a part
fails without one.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parent))

from common import Mutation, Results, table

import hystfit as hf

HERE = Path(__file__).resolve().parent
PAGE, SHOWN = "MUTATIONS.md", 4  # entries named in a row
SOUND = -1  # number of the run without a fault, of the part of mutation k: SOUND - k
HEAD = """# Mutations

Written by `python experiments/mutations.py`: each fault was put into the library or the surrogate, and the named entries of
`expected.json` failed in the quick form. Numbers are those of the faulty run.

"""


def gather(folder: Path) -> tuple[Mutation, ...]:
    """The mutations of an experiment, with its modules on the path."""
    sys.path.insert(0, str(folder))
    spec = importlib.util.spec_from_file_location(f"mutations_of_{folder.name}", folder / "mutations.py")
    if spec is None or spec.loader is None:
        raise FileNotFoundError(folder / "mutations.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where `substitute` looks
    spec.loader.exec_module(module)
    return module.MUTATIONS


def run_one(folder: Path, number: int, out: Path) -> None:
    """Numbers, failed entries and error of one mutation, or of its part without the fault, as JSON in `out`."""
    hf.enable_x64()
    mutations = gather(folder)
    mutation = mutations[number if number > SOUND else SOUND - number]
    if number > SOUND:
        mutation.apply()
    results, error = Results(folder, quick=True, out=out), None
    try:
        mutation.part(results)
    except Exception as raised:
        error = f"{type(raised).__name__}: {raised}"
    failed = [name for name in results.numbers if name in results.expected and not results.passes(name)]
    content = {"numbers": results.numbers, "failed": failed, "error": error}
    (out / "one.json").write_text(json.dumps(content), encoding="utf-8")


def started(folder: Path, number: int) -> dict[str, Any]:
    """`run_one` in a process of its own.

    Raises:
        RuntimeError: the process ended without a result.
    """
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, str(Path(__file__)), str(folder), "--one", str(number), "--out", place]
        ended = subprocess.run(command, capture_output=True, text=True)
        result = Path(place) / "one.json"
        if not result.is_file():
            raise RuntimeError(f"{' '.join(command)} ended with {ended.returncode}:\n{ended.stderr}")
        return json.loads(result.read_text(encoding="utf-8"))


def judge(folder: Path, chosen: list[int], mutations: tuple[Mutation, ...]) -> tuple[list[list[object]], bool]:
    """Rows of the table of an experiment, and whether every fault was noticed.

    Args:
        folder: of the experiment.
        chosen: numbers of the mutations to run.
        mutations: of the experiment.
    """
    rows, passed, sound = [], True, {}
    for number in chosen:
        mutation = mutations[number]
        if mutation.part not in sound:
            sound[mutation.part] = started(folder, SOUND - number)
            if sound[mutation.part]["failed"] or sound[mutation.part]["error"]:
                print(f"MISSED without a fault: {sound[mutation.part]}", flush=True)
                passed = False
        found = started(folder, number)
        failed = [f"{name}: {found['numbers'][name]:.3g}" for name in found["failed"]]
        if found["error"]:
            failed.append(f"stops with {found['error'].splitlines()[0]}")
        passed &= bool(failed)
        print(f"{'noticed' if failed else 'SURVIVED'}: {folder.name}: {mutation.name}: {'; '.join(failed)}", flush=True)
        more = [f"and {len(failed) - SHOWN} more"] if len(failed) > SHOWN else []
        rows.append([mutation.name, mutation.breaks, "<br>".join(failed[:SHOWN] + more) or "**none**"])
    return rows, passed


def write(name: str, body: str) -> None:
    """Replace the section of an experiment in the page, and keep the others."""
    page = HERE / PAGE
    parts = page.read_text(encoding="utf-8").split("\n## ")[1:] if page.is_file() else []
    sections = {part.partition("\n")[0]: part.partition("\n")[2].strip() for part in parts} | {name: body.strip()}
    text = (f"## {name}\n\n{section}\n" for name, section in sorted(sections.items()))
    page.write_text(HEAD + "\n".join(text), encoding="utf-8")


def main() -> None:
    """Run the mutations of the experiments named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("experiments", nargs="*", help="names or folders; all by default")
    parser.add_argument("--only", default="", help="mutations whose name contains this; MUTATIONS.md stays")
    parser.add_argument("--list", action="store_true", help="names only")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    folders = [path if (path := Path(name)).is_dir() else HERE / name for name in options.experiments]
    folders = [folder.resolve() for folder in folders] or sorted(path.parent for path in HERE.glob("*/mutations.py"))
    if options.one is not None:
        return run_one(folders[0], options.one, options.out)
    if len(folders) > 1:  # modules of two experiments share names
        rest = (["--list"] if options.list else []) + ["--only", options.only]
        sys.exit(max(subprocess.call([sys.executable, __file__, str(folder), *rest]) for folder in folders))
    hf.enable_x64()
    mutations = gather(folders[0])
    chosen = [k for k, mutation in enumerate(mutations) if options.only in mutation.name]
    if options.list:
        return print(*(f"{folders[0].name}: {mutations[k].name}" for k in chosen), sep="\n")
    rows, passed = judge(folders[0], chosen, mutations)
    if not options.only:
        write(folders[0].name, table(["fault", "what it breaks", "entries that fail"], rows))
    sys.exit(not passed)


if __name__ == "__main__":
    main()
