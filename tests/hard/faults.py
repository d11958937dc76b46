"""Shell verbs in hard use: full disks, folders that cannot be written or vanish, interrupts, kills, and two runs into one folder.

    python -m tests.hard.faults              # about 350 runs, some 30 minutes
    python -m tests.hard.faults --trials 2   # the moments of each fault; 12 in the full form

Each verb (fit, sample, batch, calibrate, profile, design, run) writes to a folder while something goes wrong. Afterwards the folder
holds a result that opens, or none; the verb has ended with an exit status of its own and without a traceback; and the same verb, run
again, succeeds and leaves no scratch files. Disks are full by a small file system in memory where mounting is allowed, else by a limit
on the size of files.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import hystfit as hf
from hystfit.errors import HystfitError

VERBS = ["fit", "sample", "batch", "calibrate", "profile", "design", "run"]
ENDS = {0, 1, 2, 130}  # exit statuses of the shell command
OPENED: dict[str, Callable[[Path], object]] = {"fit": hf.load_fit, "sample": hf.load_posterior}
RESULT = {"run": "run.json"}  # where it is not result.json
SIZES = (0, 4, 24, 120, 400)  # of a disk [KiB]


class Verbs:
    """The verbs, each with little work, on a folder with a record and a fit."""

    def __init__(self, place: Path, verbs: Sequence[str]):
        self.place = place
        self.environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(place / "programs"), "JAX_ENABLE_X64": "1"}
        place.mkdir(exist_ok=True)
        record = hf.datasets.load("stage-sine").window(0.0, 2.0).take(slice(None, None, 2))
        for number in range(3):
            rows = zip(record.t, record.u, record.y + 0.01 * number, strict=True)
            lines = [f"{t!r},{u!r},{y!r}" for t, u, y in ((float(t), float(u), float(y)) for t, u, y in rows)]
            (place / f"loop{number}.csv").write_text("t_s,u_V,y_um\n" + "\n".join(lines) + "\n")
        loop, fit = str(place / "loop0.csv"), str(place / "fit")
        self.arguments = {
            "fit": ["fit", loop, "--model", "bouc-wen", "--starts", "1"],
            "sample": ["sample", fit, "--noise", "iid", "--chains", "1", "--draws", "40", "--warmup", "50"],
            "batch": ["batch", str(place / "loop?.csv"), "--model", "bouc-wen", "--starts", "1", "--workers", "1"],
            "calibrate": ["calibrate", fit, "--noise", "iid", "--replicates", "10"],
            "profile": ["profile", fit, "--parameter", "c"],
            "design": ["design", fit, "--method", "families", "--samples", "200"],
        }
        self.seconds = {
            "fit": self.timed("fit", place / "fit")
        }  # of a run without a fault, its programs compiled before
        for verb in verbs:
            for name in ("warm", "timed"):
                self.seconds[verb] = self.timed(verb, place / name / verb)

    def timed(self, verb: str, out: Path) -> float:
        """Seconds of a run without a fault."""
        begun = time.monotonic()
        status, said = self.ended(self.begun(verb, out), patience=1800.0)  # it compiles
        if status not in (0, 1):
            raise RuntimeError(f"{verb} fails without a fault: {status}, {said}")
        return time.monotonic() - begun

    def begun(self, verb: str, out: Path, limit: int | None = None) -> subprocess.Popen[str]:
        """A process with the verb; `limit` is that of its files [bytes]."""
        out.parent.mkdir(parents=True, exist_ok=True)
        held = None if limit is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        words = self.study(out) if verb == "run" else [*self.arguments[verb], "--out", str(out)]
        return subprocess.Popen(
            [sys.executable, "-m", "hystfit", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environment,
            preexec_fn=held,
        )

    def study(self, out: Path) -> list[str]:
        """Arguments that run a study of one fit; its file lies beside the record, not on the disk with the fault."""
        file = self.place / f"{out.parent.name}-{out.name}.toml"
        step = {"loops": str(self.place / "loop0.csv"), "model": "bouc-wen", "starts": 1}
        lines = [f"out = {json.dumps(str(out))}", "[steps.fit]", *(f"{k} = {json.dumps(v)}" for k, v in step.items())]
        file.write_text("\n".join(lines) + "\n")
        return ["run", str(file)]

    def ended(self, process: subprocess.Popen[str], patience: float = 300.0) -> tuple[int, str]:
        """Exit status and standard error."""
        try:
            _, said = process.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return -1, f"did not end within {patience:.0f} s"
        return process.returncode, said


def fault_of(verb: str, out: Path, status: int, said: str) -> str:
    """What is wrong after a run with a fault; "" where nothing is."""
    if status not in ENDS:
        return f"exit status {status}: {said[-300:]}"
    if "Traceback" in said:
        return f"traceback: {said[-500:]}"
    # Lines of progress may come before the message.
    if status == 2 and not re.search("^hystfit: ", said, re.MULTILINE):
        return f"no message: {said[-300:]}"
    result = out / RESULT.get(verb, "result.json")
    if not result.exists():
        return "" if status not in (0, 1) else "the verb ended well, without a result"
    try:
        json.loads(result.read_text())
        if verb in OPENED:
            OPENED[verb](out)
    except (HystfitError, ValueError) as error:
        return f"a result that does not open: {error}"
    return ""


def again(verbs: Verbs, verb: str, out: Path) -> str:
    """What is wrong with the next run into the same folder; "" where it succeeds and leaves what a first run leaves."""
    status, said = verbs.ended(verbs.begun(verb, out))
    wrong = fault_of(verb, out, status, said)
    if wrong or status not in (0, 1):
        return f"the next run: {wrong or said}"
    left = {path.name for path in out.iterdir()} - {path.name for path in (verbs.place / "timed" / verb).iterdir()}
    return f"left behind: {left}" if left else ""


@contextlib.contextmanager
def disk(place: Path, size: int) -> Iterator[tuple[Path, int | None]]:
    """A folder on a file system of `size` KiB, or a limit on the size of files [bytes] where mounting is not allowed."""
    place.mkdir()
    options = f"size={max(size, 4)}k,nr_inodes=200" if size else "size=4k,nr_inodes=3"
    mounted = not subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)], capture_output=True
    ).returncode
    try:
        yield place, None if mounted else 1024 * size
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(place)], check=True)


def full_disks(verbs: Verbs, verb: str, scratch: Path, trials: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """The disk fills while the verb writes."""
    for number, size in enumerate(SIZES[:trials]):
        with disk(scratch / f"disk-{number}", size) as (place, limit):
            status, said = verbs.ended(verbs.begun(verb, place / "out", limit))
            yield f"ended {status}", fault_of(verb, place / "out", status, said)


def unwritable(verbs: Verbs, verb: str, scratch: Path, trials: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """A folder that does not allow writing: read-only file system for root, mode bits for others."""
    with disk(scratch / "fixed", 400) as (place, limit):
        if limit is None:
            subprocess.run(["mount", "-o", "remount,ro", str(place)], check=True)
        place.chmod(0o500) if limit is not None else None
        if os.access(place, os.W_OK):
            return
        begun = time.monotonic()
        status, said = verbs.ended(verbs.begun(verb, place / "out"))
        wrong = fault_of(verb, place / "out", status, said) or ("" if status == 2 else f"exit status {status}")
        late = time.monotonic() - begun > verbs.seconds[verb] + 5.0
        yield "refused", wrong or ("refused after the computation only" if late else "")
        place.chmod(0o700) if limit is not None else None


def interrupts(verbs: Verbs, verb: str, scratch: Path, trials: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """SIGINT at random moments, once or twice."""
    for number in range(trials):
        out = scratch / f"interrupted-{number}"
        process = verbs.begun(verb, out)
        time.sleep(rng.uniform(0.15, 1.0) * verbs.seconds[verb])
        process.send_signal(signal.SIGINT)
        if number % 3 == 2:
            time.sleep(0.05)
            process.send_signal(signal.SIGINT)
        status, said = verbs.ended(process)
        if status == -signal.SIGINT or (
            status in (1, 130) and "hystfit/__main__" in said and "KeyboardInterrupt" in said
        ):
            yield "interrupted before the verb began", "" if not out.exists() else f"{out} was made"
            continue
        wrong = fault_of(verb, out, status, said)
        yield f"ended {status}", wrong or (again(verbs, verb, out) if number % 2 == 0 else "")


def kills(verbs: Verbs, verb: str, scratch: Path, trials: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """SIGKILL at random moments."""
    for number in range(trials):
        out = scratch / f"killed-{number}"
        process = verbs.begun(verb, out)
        time.sleep(rng.uniform(0.3, 1.0) * verbs.seconds[verb])
        process.kill()
        status, said = verbs.ended(process)
        killed = status == -signal.SIGKILL
        wrong = fault_of(verb, out, 130 if killed else status, said)  # no more is asked than after an interrupt
        yield "killed" if killed else f"ended {status}", wrong or again(verbs, verb, out)


def vanishing(verbs: Verbs, verb: str, scratch: Path, trials: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """The folder above the target is removed at random moments."""
    for number in range(trials):
        out = scratch / f"vanishing-{number}" / "out"
        process = verbs.begun(verb, out)
        time.sleep(rng.uniform(0.4, 1.0) * verbs.seconds[verb])
        shutil.rmtree(out.parent, ignore_errors=True)
        status, said = verbs.ended(process)
        # The verb may make the folder anew, or end before.
        gone = status in (0, 1) and not out.parent.exists()
        yield f"ended {status}", "" if gone else fault_of(verb, out, status, said)


def together(verbs: Verbs, verb: str, scratch: Path, trials: int, rng: random.Random) -> Iterator[tuple[str, str]]:
    """Two runs write to one folder."""
    for number in range(trials):
        out = scratch / f"together-{number}"
        processes = [verbs.begun(verb, out)]
        time.sleep(rng.uniform(0.0, 0.3) * verbs.seconds[verb] * (number % 2))
        processes.append(verbs.begun(verb, out))
        with ThreadPoolExecutor() as pool:
            ends = list(pool.map(verbs.ended, processes))
        statuses = sorted(status for status, _ in ends)
        wrong = next((fault for status, said in ends if (fault := fault_of(verb, out, status, said))), "")
        if not wrong and statuses[0] == 2:
            wrong = "both were refused"
        yield f"ended {statuses}", wrong or (again(verbs, verb, out) if number == 0 else "")


KINDS = {
    "full disk": full_disks,
    "read-only folder": unwritable,
    "interrupt": interrupts,
    "kill": kills,
    "vanishing folder": vanishing,
    "two runs": together,
}


def main(trials: int, kinds: list[str], verbs: list[str], seed: int = 0) -> int:
    """Print the counts; 1 after any failure."""
    hf.enable_x64()
    rng, table, failures = random.Random(seed), Counter(), []
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        made = Verbs(Path(name) / "work", verbs)
        for kind in kinds:
            for verb in verbs:
                scratch = Path(name) / f"{kind}-{verb}".replace(" ", "-")
                scratch.mkdir()
                for said, wrong in KINDS[kind](made, verb, scratch, trials, rng):
                    table[kind, verb, "FAILED" if wrong else said] += 1
                    failures += [f"{kind}, {verb}: {wrong}"] if wrong else []
                    print(f"{time.monotonic() - begun:6.0f} s  {kind}, {verb}: {wrong or said}", flush=True)
    for (kind, verb, said), count in sorted(table.items()):
        print(f"{kind:<18} {verb:<10} {said:<36} {count:>4}")
    print(f"{sum(table.values())} runs, {len(failures)} failures, {time.monotonic() - begun:.0f} s")
    return 1 if failures else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--trials", type=int, default=12)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--verbs", nargs="+", default=VERBS)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.exit(main(options.trials, options.kinds, options.verbs, options.seed))
