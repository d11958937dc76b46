"""A process that is killed, a full disk, a folder that vanishes: what is on disk is the old result, the new one, or none."""

import contextlib
import errno
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.errors import DataError, HystfitError
from hystfit.results.saving import folders

from .hard import faults
from .saved_examples import fitted, posterior_of


class Killed(BaseException):
    """Stands for the end of the process: from then on, nothing can be written or removed."""


class Faults:
    """Makes the k-th change of a folder fail, and with `Killed` all later ones."""

    def __init__(self, folder: Path, k: int, fault: type[BaseException]):
        self.folder, self.k, self.fault, self.count = str(folder), k, fault, 0

    @property
    def reached(self) -> bool:
        return self.count >= self.k

    def see(self, event: str, values: tuple) -> None:
        if event == "open":
            path, mode, flags = values
            writes = any(c in (mode or "") for c in "wax+") or (flags or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        else:
            path, writes = values[0], event in ("os.rename", "os.mkdir", "os.remove", "os.rmdir")
        if not writes or isinstance(path, int) or not str(path).startswith((self.folder, "result", "m", "r", "p", ".")):
            return
        self.count += 1
        if self.count == self.k and self.fault is OSError:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self.count >= self.k and self.fault is Killed:
            raise Killed


_active: Faults | None = None


def _hook(event: str, values: tuple) -> None:
    if _active is not None and event in ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir"):
        _active.see(event, values)


sys.addaudithook(_hook)  # it cannot be removed, and does nothing while `_active` is None


@contextlib.contextmanager
def failing(folder: Path, k: int, fault: type[BaseException]) -> Iterator[Faults]:
    """Within the body, the k-th change of the folder fails; the error that follows ends the body."""
    global _active
    _active = faults = Faults(folder, k, fault)
    try:
        with contextlib.suppress(Killed, HystfitError):
            yield faults
    finally:
        _active = None


def moments(fault: type[BaseException], folder: Path, act) -> Iterator[int]:
    """Run `act` with a fault at its first, second, ... change of the folder, until there are no more; yields after each."""
    for k in range(1, 200):
        with failing(folder, k, fault) as faults:
            act()
        if not faults.reached:
            assert k > 5  # the hook has seen something
            return
        yield k
    raise AssertionError("no end")


@pytest.fixture(scope="module")
def old() -> hf.FitResult:
    return fitted()


@pytest.fixture(scope="module")
def new() -> hf.FitResult:
    return fitted(offset=3.0)


FILES = {"result.json", "model.json", "records.npz", "manifest.json"}
both = pytest.mark.parametrize("fault", [Killed, OSError])


@both
def test_a_fault_while_a_fit_is_replaced_leaves_the_old_one_or_the_new_one(old, new, tmp_path, fault):
    folder, seen = tmp_path / "fit", set()
    before, after = old.to_dict(), new.to_dict()
    old.save(folder, report=False)
    for _ in moments(fault, folder, lambda: new.save(folder, report=False)):
        opened = hf.load_fit(folder).to_dict()
        assert opened in (before, after)
        seen.add(opened == after)
        if fault is OSError and opened == before:
            assert {path.name for path in folder.iterdir()} == FILES  # no litter
        old.save(folder, report=False)  # the next run succeeds, and leaves nothing of the run before
        assert hf.load_fit(folder).to_dict() == before
        assert {path.name for path in folder.iterdir()} == FILES
    assert seen == {False, True}
    assert hf.load_fit(folder).to_dict() == after


@both
def test_a_fault_while_a_first_fit_is_saved_leaves_it_or_none(new, tmp_path, fault):
    folder, whole = tmp_path / "fit", new.to_dict()
    for _ in moments(fault, folder, lambda: new.save(folder, report=False)):
        if (folder / "result.json").exists() or (folder / ".hystfit-commit").exists():
            assert hf.load_fit(folder).to_dict() == whole
        else:
            with pytest.raises(DataError, match="holds no fit"):
                hf.load_fit(folder)
            assert fault is Killed or not folder.exists()
        shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.parametrize("fault", [Killed, pytest.param(OSError, marks=pytest.mark.slow)])
def test_a_fault_while_a_posterior_is_replaced_mixes_nothing(old, new, tmp_path, fault):
    before, after, folder = posterior_of(old), posterior_of(new), tmp_path / "draws"
    pair = lambda posterior: (posterior.to_dict(), posterior.result.to_dict())
    pairs, fits = (pair(before), pair(after)), (old.to_dict(), new.to_dict())
    whole = before.save(tmp_path / "whole")
    shutil.copytree(whole, folder)
    for _ in moments(fault, folder, lambda: after.save(folder)):
        assert pair(hf.load_posterior(folder)) in pairs
        with contextlib.suppress(DataError):  # the fit of a posterior opens alone
            assert hf.load_fit(folder / "fit").to_dict() in fits
        shutil.rmtree(folder)
        shutil.copytree(whole, folder)


RUNS = {
    "nuts": {"sampler": "nuts", "chains": 1, "draws": 60, "extend": 1, "warmup": 50},
    "emcee": {"sampler": "emcee", "walkers": 14, "draws": 60},
}


@pytest.mark.slow
@pytest.mark.parametrize("sampler", RUNS)
@both
def test_a_run_resumes_with_the_same_draws_after_any_fault(old, tmp_path, sampler, fault):
    draw = lambda: hf.sample(old, folder=tmp_path / "run", seed=1, noise="iid", **RUNS[sampler])
    whole = draw().draws
    shutil.rmtree(tmp_path / "run")
    for _ in moments(fault, tmp_path / "run", draw):
        np.testing.assert_array_equal(draw().draws, whole)
        assert not [path for path in (tmp_path / "run").iterdir() if path.name.startswith(".")]  # no litter
        shutil.rmtree(tmp_path / "run")


@pytest.mark.slow
@both
def test_a_study_resumes_with_the_same_ranks_after_any_fault(old, tmp_path, fault):
    study = lambda: hf.calibrate(old.model, old.data, noise="iid", replicates=10, folder=tmp_path / "run", seed=1)
    whole = study().ranks
    shutil.rmtree(tmp_path / "run")
    for _ in moments(fault, tmp_path / "run", study):
        np.testing.assert_array_equal(study().ranks, whole)
        shutil.rmtree(tmp_path / "run")


@pytest.mark.parametrize("sampler", [pytest.param("nuts", marks=pytest.mark.slow), "emcee"])
def test_a_folder_that_vanishes_ends_a_run_in_words(old, tmp_path, sampler):
    remove = lambda *_: shutil.rmtree(tmp_path / "run", ignore_errors=True)
    settings = RUNS[sampler] | {"draws": 600}
    with pytest.raises(HystfitError, match="run"):
        hf.sample(old, folder=tmp_path / "run", seed=1, noise="iid", progress=remove, **settings)


@pytest.mark.parametrize(
    ("sampler", "names"),
    [
        pytest.param("nuts", ("nuts-0-00001.npz", "nuts-0-warm.npz"), marks=pytest.mark.slow),
        ("emcee", ("emcee-00000.npz",)),
    ],
)
def test_a_run_file_that_is_damaged_is_computed_again(old, tmp_path, sampler, names):
    run = tmp_path / sampler
    draw = lambda: hf.sample(old, folder=run, seed=1, noise="iid", **RUNS[sampler])
    whole = draw().draws
    for name in names:
        content = (run / name).read_bytes()
        for damaged in (b"no archive", *(content[:cut] for cut in (0, 10, len(content) // 2, len(content) - 20))):
            (run / name).write_bytes(damaged)
            np.testing.assert_array_equal(draw().draws, whole)
    (run / "run.json").write_text("{")
    with pytest.raises(DataError, match="damaged: remove"):
        draw()


def test_runs_of_shell_verbs_are_judged_by_what_they_leave(old, tmp_path):
    """The judge of `tests.hard.faults`, whose full form runs each verb dozens of times."""
    judge = lambda status, said="hystfit: no space left": faults.fault_of("fit", tmp_path / "fit", status, said)
    assert judge(2) == judge(130, "") == ""
    for status, said in ((0, ""), (-11, ""), (2, "Traceback (most recent call last): ..."), (2, "")):
        assert judge(status, said)
    old.save(tmp_path / "fit", report=False)
    assert judge(0, "") == judge(130, "") == ""
    (tmp_path / "fit" / "records.npz").write_bytes(b"")
    assert "records.npz" in judge(130, "")


@pytest.mark.slow
def test_a_fit_survives_full_disks_interrupts_and_a_second_run():
    assert faults.main(2, list(faults.KINDS), ["fit"]) == 0


@pytest.mark.parametrize("moved", [False, True])
def test_a_result_that_is_removed_while_it_is_written_is_no_success(moved, tmp_path, monkeypatch):
    """Removed before its pictures are written, or just after all files were moved in place."""
    out, move = tmp_path / "fit", folders._move_pending

    def removed(target: Path) -> None:
        move(target)
        (target / "result.json").unlink(missing_ok=True)

    if moved:
        monkeypatch.setattr(folders, "_move_pending", removed)

    def write() -> None:
        with folders.writing(out) as scratch:
            (scratch / "result.json").write_text("{}")
            if not moved:
                shutil.rmtree(out)
                scratch.mkdir(parents=True)
            (scratch / "report.html").write_text("")

    with pytest.raises(HystfitError, match="another program removed files of the result"):
        write()
    assert not list(out.glob(".hystfit*"))
