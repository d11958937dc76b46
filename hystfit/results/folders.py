"""Folders written whole or not at all, and JSON that any reader accepts."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hystfit.errors import HystfitError


class writing:
    """Context manager that yields a scratch folder beside the target and moves its files in place when all are written.

    After an error or an interrupt nothing remains: no scratch folder, and no target that did not exist before.

    Raises:
        HystfitError: the target cannot be made or written; the message names the folder and the reason.
    """

    def __init__(self, target: str | Path):
        self.target = Path(target)

    def __enter__(self) -> Path:
        """Make the scratch folder."""
        self.created = not self.target.exists()
        try:
            self.target.mkdir(exist_ok=True)
            self.scratch = Path(tempfile.mkdtemp(prefix=".hystfit-", dir=self.target))
        except OSError as error:
            raise self._refused(error) from error
        return self.scratch

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Move the files, or remove them after an error."""
        try:
            if kind is None:
                _move(self.scratch, self.target)
        except OSError as failure:
            raise self._refused(failure) from failure
        finally:
            shutil.rmtree(self.scratch, ignore_errors=True)
            if self.created and kind is not None:
                shutil.rmtree(self.target, ignore_errors=True)
        if isinstance(error, OSError):
            raise self._refused(error) from error

    def _refused(self, error: OSError) -> HystfitError:
        if isinstance(error, FileNotFoundError) and not self.target.parent.is_dir():
            return HystfitError(
                f"cannot write to {str(self.target)!r}: the folder {str(self.target.parent)!r} does not exist; make it first"
            )
        if isinstance(error, FileExistsError):
            return HystfitError(f"cannot write to {str(self.target)!r}: it is a file, and a folder is needed")
        return HystfitError(f"cannot write to {str(self.target)!r}: {error.strerror or error}")


def _move(source: Path, target: Path) -> None:
    """Move the files of a folder into another, and those of its folders into theirs."""
    for entry in sorted(source.iterdir()):
        if entry.is_dir():
            (target / entry.name).mkdir(exist_ok=True)
            _move(entry, target / entry.name)
        else:
            os.replace(entry, target / entry.name)


def check_writable(target: str | Path) -> None:
    """Refuse a folder that could not be written later, before long work begins; nothing is left behind.

    Raises:
        HystfitError: as `writing`.
    """
    attempt = writing(target)
    attempt.__enter__()
    shutil.rmtree(attempt.scratch, ignore_errors=True)
    if attempt.created:
        attempt.target.rmdir()


def dump_json(path: Path, content: dict[str, Any]) -> None:
    """Write JSON that any reader takes: no NaN, no infinity.

    Raises:
        HystfitError: the content is not JSON-able.
    """
    try:
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except (TypeError, ValueError) as error:
        raise HystfitError(f"{path.name} would hold a value that JSON cannot represent: {error}") from error
