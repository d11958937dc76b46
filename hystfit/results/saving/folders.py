"""Folders written whole or not at all, by one process at a time, and JSON that any reader accepts."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import filelock

from hystfit.errors import DataError, HystfitError
from hystfit.reading.files.file_bytes import is_zarr
from hystfit.results.saving.manifest import MANIFEST, PENDING

_LOCK, _SCRATCH, _WHOLE = ".hystfit-lock", ".hystfit-new-", ".hystfit-whole"
_OF_DISKS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)
_LOST = "cannot write to {!r}: another program removed files of the result while it was written"
_PATIENCE = 5.0  # seconds to wait for another process that moves its files in place


@contextlib.contextmanager
def alone(folder: str | Path, patience: float = 0.0) -> Iterator[None]:
    """Lock a folder while the body runs; the lock is released when the process ends, however it ends.

    A folder that did not exist is made, and removed if the body leaves nothing in it.
    """
    folder = Path(folder)
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as held:
            try:
                held.enter_context(filelock.FileLock(folder / _LOCK, timeout=patience, is_singleton=False))
            except filelock.Timeout as error:
                raise HystfitError(
                    f"another process is writing to {str(folder)!r}: wait for it, or choose another folder"
                ) from error
            except NotImplementedError:  # a file system without locks
                pass
            try:
                yield
            finally:
                with contextlib.suppress(OSError):  # an open file on Windows
                    (folder / _LOCK).unlink(missing_ok=True)
                if made:
                    with contextlib.suppress(OSError):  # not empty
                        folder.rmdir()
    except OSError as error:
        within = error.filename is not None and Path(str(error.filename)).is_relative_to(folder)
        if within or (error.filename is None and error.errno in _OF_DISKS):
            raise refused(folder, error) from error
        raise


class writing:
    """Context manager that yields a scratch folder within the target, and moves its files in place when all are written.

    One rename makes the scratch folder the pending result; then its files are moved, manifests last. A process that is killed before
    the rename changes nothing, and one that is killed after it has written the new result: readers take what is not yet moved from the
    pending folder (`hystfit.results.saving.manifest`), and the next writer moves it. After an error or an interrupt nothing remains: no
    scratch folder, and no target that did not exist before.

    Raises:
        HystfitError: the target cannot be made or written, or another program removes files of the result meanwhile; the message names
            the folder and the reason.
    """

    def __init__(self, target: str | Path):
        self.target = Path(target)

    def __enter__(self) -> Path:
        self.created = not self.target.exists()
        self.held = contextlib.ExitStack()
        try:
            self.target.mkdir(exist_ok=True)
            self.held.enter_context(alone(self.target, _PATIENCE))
            _move_pending(self.target)
            for left in self.target.glob(f"{_SCRATCH}*"):  # by a process that was killed
                shutil.rmtree(left, ignore_errors=True)
            self.scratch = Path(tempfile.mkdtemp(prefix=_SCRATCH, dir=self.target))
            (self.scratch / _WHOLE).touch()  # where it is missing at the end, files written before may be missing too
        except BaseException as error:
            if "scratch" in vars(self):
                shutil.rmtree(self.scratch, ignore_errors=True)
            self._leave(remove=self.created)
            if isinstance(error, OSError):
                raise refused(self.target, error) from error
            raise
        return self.scratch

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        """Move the files, or remove them after an error."""
        committed = False
        try:
            if kind is None:
                if not (self.scratch / _WHOLE).exists():
                    raise HystfitError(_LOST.format(str(self.target)))
                (self.scratch / _WHOLE).unlink()
                _refuse_clashes(self.scratch, self.target)
                names = [path.relative_to(self.scratch) for path in self.scratch.rglob("*") if path.is_file()]
                os.rename(self.scratch, self.target / PENDING)
                committed = True
                _move_pending(self.target)
                if not all((self.target / name).exists() for name in names if name.name != _LOCK):
                    raise HystfitError(_LOST.format(str(self.target)))
        except OSError as failure:
            raise refused(self.target, failure) from failure
        finally:
            try:
                shutil.rmtree(self.scratch, ignore_errors=True)
            finally:
                self._leave(remove=self.created and not committed)
        if isinstance(error, OSError):
            raise refused(self.target, error) from error

    def _leave(self, *, remove: bool) -> None:
        self.held.close()
        if remove:
            shutil.rmtree(self.target, ignore_errors=True)


@contextlib.contextmanager
def writing_file(path: str | Path) -> Iterator[Path]:
    """The place of a file or Zarr store within a scratch folder, from which it is moved when it is written; errors as for `writing`."""
    path = Path(path)
    if not path.parent.is_dir():
        raise DataError(f"cannot write {str(path)!r}: the folder {str(path.parent)!r} does not exist; make it first")
    if path.parent.name.startswith(_SCRATCH):  # its files are moved together
        yield path
        return
    with writing(path.parent) as scratch:
        yield scratch / path.name


def refused(target: Path, error: OSError) -> HystfitError:
    """Why a folder cannot be written, in words."""
    if isinstance(error, FileNotFoundError) and not target.parent.is_dir():
        return HystfitError(
            f"cannot write to {str(target)!r}: the folder {str(target.parent)!r} does not exist; make it first"
        )
    if isinstance(error, FileExistsError | NotADirectoryError):
        return HystfitError(f"cannot write to {str(target)!r}: it is a file, and a folder is needed")
    return HystfitError(f"cannot write to {str(target)!r}: {error.strerror or error}")


def _refuse_clashes(source: Path, target: Path) -> None:
    """Refuse a target in which a folder has the name of a file, or the other way round, before anything is moved."""
    for entry in source.iterdir():
        place = target / entry.name
        if place.exists() and place.is_dir() != entry.is_dir():
            kind = "folder" if place.is_dir() else "file"
            raise HystfitError(
                f"cannot write {str(place)!r}: a {kind} has this name; move it away, or choose another folder"
            )
        if is_zarr(entry) and place.is_dir() and not is_zarr(place):
            raise HystfitError(f"cannot write {str(place)!r}: this folder is no Zarr store; choose another name")
        if entry.is_dir() and place.is_dir():
            _refuse_clashes(entry, place)


def _move_pending(target: Path) -> None:
    """Move the files of the pending result in place, where there is one: also one that a killed process has left."""
    pending = target / PENDING
    if pending.is_dir():
        _move(pending, target)
        shutil.rmtree(pending)


def _move(source: Path, target: Path) -> None:
    """Move the files of a folder into another, and those of its folders into theirs; manifests last.

    A Zarr store replaces an older one as a whole, of which other arrays would remain.
    """
    for entry in sorted(source.iterdir(), key=lambda entry: (entry.name == MANIFEST, entry.name)):
        if entry.name == _LOCK:
            continue
        if is_zarr(entry):
            shutil.rmtree(target / entry.name, ignore_errors=True)
            os.replace(entry, target / entry.name)
        elif entry.is_dir():
            (target / entry.name).mkdir(exist_ok=True)
            _move(entry, target / entry.name)
        else:
            os.replace(entry, target / entry.name)


def check_writable(target: str | Path) -> None:
    """Refuse a folder that could not be written later, before long work begins, as `writing` does; nothing is left behind."""
    attempt = writing(target)
    attempt.__enter__()
    shutil.rmtree(attempt.scratch, ignore_errors=True)
    attempt._leave(remove=attempt.created)


def dump_json(path: Path, content: dict[str, Any]) -> None:
    """Write strict JSON, without NaN and infinity."""
    try:
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except (TypeError, ValueError) as error:
        raise HystfitError(f"{path.name} would hold a value that JSON cannot represent: {error}") from error
