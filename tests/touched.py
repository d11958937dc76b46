"""Types and tests of the files changed since a commit, for the loop while working: `make quick`.

    python -m tests.touched [COMMIT]

Tested are the test files that changed, and those that belong to a changed module: they import from it or carry its name. Without
COMMIT the comparison is with main where HEAD has left it, and with HEAD otherwise. Files that are not yet tracked count as changed.
"""

import re
import subprocess
import sys
from pathlib import Path


ROOT = Path(__file__).resolve().parents[1]
TESTS = ROOT / "tests"


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


def belongs(test: str, text: str, module: str) -> bool:
    """Whether a test file imports from a module of hystfit or has its name."""
    *_, stem = module.split(".")
    return stem in test.removesuffix(".py") or re.search(rf"\b{re.escape(module)}\b", text) is not None


def tests_of(files: list[Path]) -> list[Path]:
    """The test files of changed files."""
    chosen = {path for path in files if path.parent == TESTS and path.name.startswith("test_")}
    library = [path.relative_to(ROOT).with_suffix("") for path in files if path.is_relative_to(ROOT / "hystfit")]
    modules = [".".join(path.parts).removesuffix(".__init__") for path in library]
    for test in TESTS.glob("test_*.py"):
        text = test.read_text(encoding="utf-8")
        if any(belongs(test.name, text, module) for module in modules):
            chosen.add(test)
    return sorted(chosen)


def main() -> int:
    """Check types of the changed files and run their tests; the first exit status that is not 0."""
    files = changed(sys.argv[1] if len(sys.argv) > 1 else base())
    typed = [path for path in files if path.is_relative_to(ROOT / "hystfit")]
    tests = tests_of(files)
    print(f"{len(files)} changed files: types of {len(typed)}, {len(tests)} test files", flush=True)
    binaries = Path(sys.executable).parent
    commands = [[binaries / "basedpyright", *typed]] if typed else []
    if tests:
        commands.append(
            [sys.executable, "-m", "pytest", "-n", "2", "--dist", "load", "-q", "-x", "-m", "not slow", *tests]
        )
    statuses = [subprocess.run([*map(str, command)], cwd=ROOT).returncode for command in commands]
    return next((status for status in statuses if status), 0)


if __name__ == "__main__":
    sys.exit(main())
