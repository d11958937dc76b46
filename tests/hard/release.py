"""Checks of a release on a clean clone: version, archives, their metadata, and the first fit in a new environment.

    python -m tests.hard.release [--out FOLDER]

The archives are built twice from a clone of HEAD: they have to agree bit for bit. The wheel and the source archive are installed in
environments of their own, which fit a bundled record. Exit status 1 where a step fails.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAME = "hystfit-jax"
FIRST_FIT = ("fit", "stage-sweep", "--model", "bouc-wen", "--starts", "1", "--json")


def run(*command: str | Path, cwd: Path, **variables: str) -> str:
    """Standard output of a command; its whole output is printed where it fails."""
    environment = {**os.environ, "PYTHONPATH": "", **variables}
    ended = subprocess.run([*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True)
    if ended.returncode:
        sys.exit(f"failed: {' '.join(map(str, command))}\n{ended.stdout}{ended.stderr}")
    return ended.stdout


def stated_version(clone: Path) -> str:
    """The version of the source, which the changelog and the citation have to state too."""
    (version,) = re.findall(r'^__version__ = "(.+)"$', (clone / "hystfit/version.py").read_text(), re.MULTILINE)
    (cited,) = re.findall(r"^version: (.+)$", (clone / "CITATION.cff").read_text(), re.MULTILINE)
    newest = re.findall(r"^## (\S+)", (clone / "CHANGELOG.md").read_text(), re.MULTILINE)[0]
    if {version, cited, newest} != {version}:
        sys.exit(f"failed: version.py states {version}, CITATION.cff {cited}, CHANGELOG.md {newest}")
    return version


def archives(clone: Path, folder: Path) -> dict[str, str]:
    """SHA-256 of wheel and source archive, built from the clone."""
    epoch = run("git", "log", "-1", "--format=%ct", cwd=clone).strip()
    run(sys.executable, "-m", "build", "--outdir", folder, ".", cwd=clone, SOURCE_DATE_EPOCH=epoch)
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def first_fit(archive: Path, folder: Path) -> str:
    """Install an archive in a new environment and fit a bundled record there: the status of the fit."""
    venv.create(folder, with_pip=True, clear=True)
    binaries = folder / ("Scripts" if os.name == "nt" else "bin")
    constraints = ["--constraint", ROOT / "constraints.txt"] if sys.version_info[:2] == (3, 11) else []
    run(binaries / "python", "-m", "pip", "install", "--quiet", *constraints, archive, cwd=folder)
    installed = run(binaries / "python", "-m", "pip", "show", "--files", NAME, cwd=folder)
    if "hystfit/py.typed" not in installed or "hystfit/_bundled" not in installed:
        sys.exit(f"failed: {archive.name} lacks the type marker or the bundled records")
    run(binaries / "hystfit", "--version", cwd=folder)
    return json.loads(run(binaries / "hystfit", *FIRST_FIT, cwd=folder))["status"]


def main() -> None:
    """Clone, build, check and install."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "build/release")
    out = parser.parse_args().out.resolve()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    clone = out / "clone"
    run("git", "clone", "--quiet", "--no-hardlinks", ROOT, clone, cwd=out)
    print("version", stated_version(clone), flush=True)
    first, second = archives(clone, out / "dist"), archives(clone, out / "again")
    if first != second:
        sys.exit(f"failed: two builds differ: {first} {second}")
    print("two builds agree:", *first, flush=True)
    built = sorted((out / "dist").iterdir())
    print(run(sys.executable, "-m", "twine", "check", "--strict", *built, cwd=out).strip(), flush=True)
    wheel = next(path for path in built if path.suffix == ".whl")
    with zipfile.ZipFile(wheel) as content:
        print(f"{wheel.name}: {len(content.namelist())} files, {wheel.stat().st_size / 2**20:.1f} MiB", flush=True)
    for archive in built:
        status = first_fit(archive, out / f"environment-{archive.suffix.lstrip('.')}")
        print(f"{archive.name}: first fit {status}", flush=True)
        if status != "ok":
            sys.exit(f"failed: the first fit of {archive.name} ends with {status}")


if __name__ == "__main__":
    main()
