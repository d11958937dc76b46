"""Types and tests of the files changed since a commit, for the loop while working: `make quick`.

    python -m tests.touched [COMMIT]

Tested are the test files that changed, and those of a changed module: they carry its name, or import from it. A module that many
test files import is tested by those with its name alone, and one without tests of its own by those of its room. Without COMMIT the
comparison is with main where HEAD has left it, and with
HEAD otherwise. Files that are not yet tracked count as changed.
"""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"
MANY = 6  # test files that import a module: beyond, as for `errors` or `models`, they test other things through it


def git(*arguments: str) -> list[str]:
    """Lines of the output of git."""
    ended = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return ended.stdout.splitlines()


def base() -> str:
    """The commit at which HEAD has left main, or HEAD."""
    if not git("branch", "--list", "main"):
        return "HEAD"
    return git("merge-base", "HEAD", "main")[0]


def changed(commit: str) -> list[Path]:
    """Python files that differ from a commit, tracked or not."""
    names = git("diff", "--name-only", "--diff-filter=d", commit) + git("ls-files", "--others", "--exclude-standard")
    return sorted({ROOT / name for name in names if name.endswith(".py")})


def tests_of(files: list[Path]) -> list[Path]:
    """The test files of changed files."""
    texts = {path: path.read_text(encoding="utf-8") for path in TESTS.glob("test_*.py")}
    chosen = {path for path in files if path in texts}
    for path in files:
        if path.is_relative_to(ROOT / "hystfit"):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            name = module.rpartition(".")[2]
            importers = {test for test, text in texts.items() if re.search(rf"\b{re.escape(module)}\b", text)}
            own = {test for test in texts if name in test.stem} | (importers if len(importers) <= MANY else set())
            chosen |= own or {test for test in texts if path.parent.name in test.stem}
    return sorted(chosen)


def main() -> int:
    """Check types of the changed files and run their tests; the first exit status that is not 0."""
    files = changed(sys.argv[1] if len(sys.argv) > 1 else base())
    typed = [path for path in files if path.is_relative_to(ROOT / "hystfit")]
    tests = tests_of(files)
    print(f"{len(files)} changed files: types of {len(typed)}, {len(tests)} test files", flush=True)
    binaries = Path(sys.executable).parent
    commands = [[binaries / "pyrefly", "check", "--min-severity", "error", *typed]] if typed else []
    if tests:
        commands.append(
            [sys.executable, "-m", "pytest", "-n", "2", "--dist", "load", "-q", "-x", "-m", "not slow", *tests]
        )
    statuses = [subprocess.run([*map(str, command)], cwd=ROOT).returncode for command in commands]
    return next((status for status in statuses if status), 0)


if __name__ == "__main__":
    sys.exit(main())
