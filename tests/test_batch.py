"""Many loops at once: the fits of `hystfit.fit`, a table with a row a loop, and runs that resume."""

import contextlib
import csv
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import distributed
import numpy as np
import pytest
import scipy.optimize
from threadpoolctl import threadpool_info, threadpool_limits

import hystfit as hf
from hystfit import cli
from hystfit.batch import bucketed, many, work
from hystfit.batch.many import Journal
from hystfit.batch.overview import histogram, overview
from hystfit.batch.sources import Source
from hystfit.errors import DataError, MissingExtraError, ParameterError
from hystfit.outcome import Code, Status

MAIN = [sys.executable, "-c", "from hystfit.cli import main; main()"]
QUICK = {"starts": 2}


def hysteresis(u, c, mu, tau, rho, offset):
    """The semi-implicit Bouc-Wen step written out on numbers: an oracle that shares no code with the model."""
    h, y, highest = 0.0, [], mu * c / (tau * (1 + rho))
    for before, after in zip([u[0], *u[:-1]], u, strict=True):
        dv = after - before
        x, sign = abs(dv), -1.0 if dv < 0 else 1.0
        below = min(max(-sign * h, 0.0), x * mu * c) / (mu * c) if mu * c > 0 else 0.0
        half = 0.5 * (tau * (1 + rho) * (x - below) + tau * (1 - rho) * below)
        h = min(max(((1 - half) * h + mu * c * dv) / (1 + half), -highest), highest)
        y.append(offset + c * after - h)
    return np.array(y)


def measured(number: int, samples: int, noise: float = 0.05) -> hf.Record:
    """A loop of some Bouc-Wen element, with measurement noise."""
    rng = np.random.default_rng(number)
    t = np.arange(samples) / samples
    u = 40 * np.sin(8 * np.pi * t + 0.05 * number) * np.linspace(0.4, 1.0, samples)
    c, tau = 1.0 + 0.1 * rng.uniform(-1, 1), 0.06 * np.exp(0.3 * rng.uniform(-1, 1))
    model = hf.BoucWen(c=c, mu=0.45, tau=tau, rho=0.4, offset=3.0 + rng.uniform())
    y = np.asarray(hf.simulate(model, u)[0]) + noise * rng.standard_normal(samples)
    return hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um", name=f"loop {number}")


def write(record: hf.Record, path: Path, head: str = "t_s,u_V,y_um") -> Path:
    table = np.column_stack([record.t, record.u, record.y])
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    return path


@pytest.fixture(scope="module")
def records() -> list[hf.Record]:
    """Two short loops, two of the same bucket, and two that are thinned for their starts."""
    return [measured(number, samples) for number, samples in enumerate((300, 340, 1500, 1400, 380, 1450))]


@pytest.fixture(scope="module")
def fits(records) -> hf.Fits:
    return hf.fit_many("bouc-wen", records, **QUICK)


@pytest.fixture
def folder(tmp_path) -> Path:
    """Eight files of short loops."""
    place = tmp_path / "loops"
    place.mkdir()
    for number in range(8):
        write(measured(number, 150), place / f"loop{number}.csv")
    return place


# -- the fits ------------------------------------------------------------------------------------------------------------------


def test_files_are_fitted_with_one_thread_of_linear_algebra(monkeypatch):
    """Two threads wait for each other at every small product: 1000 files took twice the processor time."""
    seen: list[set[int]] = []
    threads = lambda: {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}
    monkeypatch.setattr(work, "_read", lambda *_: seen.append(threads()) or [])
    with threadpool_limits(2, "blas"):
        work.fit_sources(work.Work.of("bouc-wen", {}, {}), [Source("loop", "loop.csv", None)])
    assert seen == [{1}]


def test_estimates_errors_and_verdicts_are_those_of_fit(fits, records):
    assert fits.status is Status.OK
    for row, record in zip(fits, records, strict=True):
        alone = hf.fit("bouc-wen", record, **QUICK)
        free = [p for p in alone.parameters if not p.fixed]
        np.testing.assert_allclose(list(row.values.values()), [p.value for p in free], rtol=1e-6)
        np.testing.assert_allclose(list(row.stderr.values()), [p.stderr for p in free], rtol=1e-4)
        assert list(row.values) == [p.name for p in free]
        assert (row.status, row.samples, row.model) == (alone.status, alone.train.n, "bouc-wen")
        assert row.codes == tuple(dict.fromkeys(str(note.code) for note in alone.notes))
        assert row.error_percent == pytest.approx(alone.train.nrmse_percent, rel=1e-9)
        assert {name: row.units[name] for name in row.values} == {p.name: p.unit for p in free}


def test_estimates_are_those_of_scipy_on_a_plain_loop(fits, records):
    for row, record in list(zip(fits, records, strict=True))[:2]:
        names = list(row.values)
        size = np.array([row.stderr[name] for name in names])
        miss = lambda v, record=record, names=names, size=size: (
            hysteresis(record.u, **dict(zip(names, v * size, strict=True))) - record.y
        )
        start = np.array([row.values[name] for name in names]) / size + 2.0
        found = scipy.optimize.least_squares(miss, start, xtol=1e-12, ftol=1e-12, gtol=1e-12)
        np.testing.assert_allclose(found.x * size, list(row.values.values()), atol=0.01 * size.min(), rtol=1e-5)
        rmse = np.sqrt(np.mean(miss(found.x) ** 2))
        assert row.rmse == pytest.approx(rmse, rel=1e-6)


def _task(record: hf.Record) -> bucketed.Task:
    from hystfit.fitting.fit_options import FitOptions
    from hystfit.fitting.fit_setup import set_up_fit, starting_vectors

    posed = set_up_fit(hf.BoucWen(), hf.Dataset((record,)), FitOptions())
    return bucketed.Task.of(posed.problem, starting_vectors(posed.problem, 2, 0, posed.points))


def test_loops_are_read_a_part_at_a_time(records, monkeypatch):
    together = []
    fit = work._fit
    monkeypatch.setattr(work, "_fit", lambda task, loops: together.append(len(loops)) or fit(task, loops))
    monkeypatch.setattr(work, "SAMPLES", 500)
    hf.fit_many("bouc-wen", records, **QUICK)
    assert together == [2, 1, 1, 2]


def test_a_fit_that_ends_on_a_bound_is_that_of_fit():
    t = np.arange(300) / 300
    u = 40 * np.sin(8 * np.pi * t) * np.linspace(0.4, 1.0, 300)
    y = hysteresis(u, 1.0, 0.45, 0.06, 0.999, 1.0) + 0.02 * np.random.default_rng(8).standard_normal(300)
    record = hf.Record(u=u, y=y, t=t)
    alone = hf.fit("bouc-wen", record, **QUICK)
    assert Code.AT_BOUND in {note.code for note in alone.notes}
    assert bucketed.solve_together([_task(record)]) == [None]
    row = hf.fit_many("bouc-wen", [record], **QUICK)[record.name]
    assert row.status == alone.status
    assert Code.AT_BOUND in row.codes
    np.testing.assert_allclose(list(row.values.values()), alone.x, rtol=1e-12)
    assert None in row.stderr.values()


@pytest.mark.parametrize("model", ["prandtl-ishlinskii:plays=4", hf.Preisach.of(n=6)], ids=["convex", "preisach"])
def test_models_with_another_estimator_are_fitted_one_by_one(model):
    record = measured(1, 150)
    row = hf.fit_many(model, [record])[record.name]
    alone = hf.fit(model, record)
    np.testing.assert_allclose(list(row.values.values()), alone.x, rtol=1e-9)
    assert row.status == alone.status


def test_settings_reach_the_fit():
    record = measured(2, 150)
    fits = hf.fit_many(hf.BoucWen, [record], fix={"rho": 0.3}, free=["h0"], noise="iid", loss="huber", **QUICK)
    alone = hf.fit(hf.BoucWen(), record, fix={"rho": 0.3}, free=["h0"], noise="iid", loss="huber", **QUICK)
    assert list(fits.names) == list(alone.free_names)
    np.testing.assert_allclose([fits.values(name, usable=False)[0] for name in fits.names], alone.x, rtol=1e-6)


def test_auto_compares_models_on_each_loop(monkeypatch):
    seen = []
    monkeypatch.setattr(work, "fit", lambda model, record, **options: seen.append(model) or _bouc_wen(record))
    fits = hf.fit_many("auto", [measured(1, 150)])
    assert seen == ["auto"]
    assert fits.rows[0].model == "bouc-wen"
    fits.result("loop 1")
    assert seen == ["auto", "bouc-wen"]  # the winner is not searched for again


def _bouc_wen(record: hf.Record) -> hf.FitResult:
    return hf.fit("bouc-wen", record, **QUICK)


def test_quantities_follow_from_the_fitted_loop(fits):
    row = fits.rows[0]
    low, high = fits.result(row.name).input_range
    u = np.concatenate([np.linspace(low, high, 2001), np.linspace(high, low, 2001)[1:]])
    y = hysteresis(np.concatenate([u, u[1:], u[1:]]), **row.values)[-4000:]
    rising, falling = y[:2000], y[2000:][::-1]
    area = np.trapezoid(falling - rising, np.linspace(low, high, 2000))
    assert row.quantities["loop_area"] == pytest.approx(abs(area), rel=5e-3)
    assert row.quantities["remanence"] == pytest.approx(0.5 * abs(falling - rising)[1000], rel=5e-3)
    assert row.units["loop_area"] == "um V"
    assert row.units["coercive_input"] == "V"


# -- loops that cannot be fitted ---------------------------------------------------------------------------------------------------


def test_a_loop_without_a_fit_is_a_row_with_its_reason(folder):
    (folder / "empty.csv").write_text("")
    (folder / "words.csv").write_text("one,two\nred,blue\n")
    write(measured(1, 150).take(slice(0, 4)), folder / "short.csv")
    write(measured(1, 150), folder / "columns.csv", "t_s,v_V,x_V")
    fits = hf.fit_many("bouc-wen", f"{folder}/*.csv", reading={"input": "u_V", "output": "y_um"}, **QUICK)
    assert fits.status is Status.PARTIAL
    assert len(fits) == 12
    for name in ("empty", "words", "short", "columns"):
        row = fits[f"{folder}/{name}.csv"]
        assert row.status is Status.FAILED
        assert row.reason
        assert (row.values, row.error_percent, row.samples) == ({}, None, None)
    assert "u_V" in fits[f"{folder}/columns.csv"].reason
    assert [row.status for row in fits.worst(4)] == [Status.FAILED] * 4
    assert fits.counts == {"ok": 8, "failed": 4}
    table = {name: column[-1] for name, column in fits.columns().items()}
    assert table["status"] == "failed"
    assert np.isnan([table[name] for name in ("c", "c_stderr", "rmse", "samples")]).all()


def test_a_curve_without_a_loop_is_a_row_and_the_others_of_its_file_are_fitted(tmp_path):
    path = tmp_path / "curves.csv"
    first, missing = measured(1, 150), np.full(150, np.nan)
    rows = [
        (k, *row) for k, y in enumerate([first.y, missing, first.y]) for row in zip(first.t, first.u, y, strict=True)
    ]
    lines = [",".join("" if np.isnan(value) else f"{value:.9g}" for value in row) for row in rows]
    path.write_text("\n".join(["specimen,t_s,u_V,y_um", *lines]))
    with pytest.raises(DataError, match="no finite value"):
        hf.read(path, by="specimen")
    fits = hf.fit_many("bouc-wen", path, reading={"by": "specimen"}, **QUICK)
    assert fits.counts == {"ok": 2, "failed": 1}
    (failed,) = [row for row in fits if not row.usable]
    assert "no finite value" in failed.reason
    assert "specimen=1" in failed.name


def test_a_loop_that_breaks_the_numerics_does_not_end_the_batch(monkeypatch, records):
    judge = work.judge

    def breaks(posed, estimate, *more):
        if posed.problem.data[0].name == "loop 1":
            raise np.linalg.LinAlgError("SVD did not converge")
        return judge(posed, estimate, *more)

    monkeypatch.setattr(work, "judge", breaks)
    fits = hf.fit_many("bouc-wen", records[:2], **QUICK)
    assert [row.status for row in fits] == [Status.OK, Status.FAILED]
    assert "SVD did not converge" in fits["loop 1"].reason


def test_loops_are_converted_to_the_units_of_the_first():
    first = measured(1, 150)
    milli = first.replace(u=1e3 * first.u, u_unit="mV", name="in mV")
    force = first.replace(u_unit="N", name="force")
    fits = hf.fit_many("bouc-wen", [first, milli, force], **QUICK)
    assert fits.units["u"] == "V"
    assert fits["in mV"].values["tau"] == pytest.approx(fits["loop 1"].values["tau"], rel=1e-6)
    assert Code.UNITS in fits["in mV"].codes
    assert fits["force"].status is Status.FAILED
    assert "N" in fits["force"].reason


def test_every_curve_of_a_file_is_a_loop(tmp_path):
    curves = [measured(number, 150) for number in (1, 2)]
    rows = [np.column_stack([np.full(150, k), r.u, r.y]) for k, r in enumerate(curves)]
    np.savetxt(tmp_path / "two.csv", np.concatenate(rows), delimiter=",", header="curve,u_V,y_um", comments="")
    fits = hf.fit_many("bouc-wen", [tmp_path / "two.csv"], reading={"by": "curve"}, **QUICK)
    assert len(fits) == 2
    alone = [hf.fit("bouc-wen", record, **QUICK).values["c"] for record in curves]
    np.testing.assert_allclose(fits.values("c"), alone, rtol=1e-6)


# -- bad input -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "words"), [(1, "1 loop:"), (2, "2 loops:")])
def test_loops_are_counted_in_the_singular_and_plural(fits, count, words):
    assert str(dataclasses.replace(fits, rows=fits.rows[:count])).startswith(f"bouc-wen fitted to {words}")


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(
    ("loops", "options", "error", "message"),
    [
        ([], {}, DataError, "no loops"),
        (["none/*.csv"], {}, DataError, "no file matches"),
        (["none.csv"], {}, DataError, r"no file 'none\.csv'"),
        ([measured(1, 100), measured(1, 100)], {}, DataError, "2 times"),
        (measured(1, 100), {}, DataError, "a list of loops"),
        ([1.0], {}, DataError, "a file or a Record"),
        ([measured(1, 100)], {"fix": ["nu"]}, ParameterError, "no parameter 'nu'"),
        ([measured(1, 100)], {"fix": ["c", "mu", "tau", "rho", "offset"]}, ParameterError, "every parameter is fixed"),
        ([measured(1, 100)], {"magic": 1}, ParameterError, "no setting 'magic'"),
        ([measured(1, 100)], {"method": "rls"}, ParameterError, "method"),
        ([measured(1, 100)], {"noise": "magic"}, ParameterError, "noise"),
        ([measured(1, 100)], {"starts": 0}, ParameterError, "start"),
        ([measured(1, 100)], {"seed": -1}, ParameterError, "seed"),
        ([measured(1, 100)], {"workers": 0}, ParameterError, "workers"),
        ([measured(1, 100)], {"reading": {"magic": 1}}, ParameterError, "magic"),
    ],
)
def test_what_no_loop_could_be_fitted_with_is_an_error(loops, options, error, message):
    with pytest.raises(error, match=message):
        hf.fit_many("bouc-wen", loops, **options)


def test_auto_refuses_settings_of_a_chosen_model():
    with pytest.raises(ParameterError, match="explicit model"):
        hf.fit_many("auto", [measured(1, 100)], fix={"rho": 0.1})


def test_a_column_that_no_file_has_is_an_error(folder):
    with pytest.raises(DataError, match=r"none of 8 loops can be read.*v_V"):
        hf.fit_many("bouc-wen", f"{folder}/*.csv", reading={"input": "v_V"})


def test_a_folder_is_no_loop(folder):
    with pytest.raises(DataError, match="is a folder"):
        hf.fit_many("bouc-wen", [folder])


# -- runs that resume ------------------------------------------------------------------------------------------------------------


def test_a_batch_resumes_and_takes_further_loops(folder, tmp_path, monkeypatch):
    run, computed = tmp_path / "run", []
    fit_sources = many.fit_sources
    counting = lambda task, sources: computed.extend(s.name for s in sources) or fit_sources(task, sources)
    monkeypatch.setattr(many, "fit_sources", counting)
    some = [str(folder / f"loop{number}.csv") for number in range(3)]
    first = hf.fit_many("bouc-wen", some, folder=run, **QUICK)
    every = hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=run, **QUICK)
    assert sorted(computed) == sorted(str(file) for file in folder.iterdir())
    assert every.rows[:3] == first.rows
    write(measured(50, 150), folder / "loop1.csv")  # other data under the same name
    changed = hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=run, **QUICK)
    assert computed[8:] == [str(folder / "loop1.csv")]
    assert changed.rows[1] != every.rows[1]
    with pytest.raises(DataError, match="another batch"):
        hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=run, starts=3)


def test_a_line_that_was_cut_short_is_ignored(folder, tmp_path):
    run = tmp_path / "run"
    whole = hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=run, **QUICK)
    file = run / "rows.jsonl"
    lines = file.read_bytes().splitlines(keepends=True)
    assert len(lines) == 8
    file.write_bytes(b"".join(lines[:3]) + b"not json\n" + lines[4] + lines[5][:40])
    journal = Journal(file)
    assert len(journal.rows) == 4
    assert file.read_bytes() == b"".join([*lines[:3], lines[4]])  # what is appended next starts a line of its own
    again = hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=run, **QUICK)
    assert again.rows == whole.rows


def test_a_killed_command_resumes_and_writes_the_same_table(tmp_path, monkeypatch, capsys):
    for number in range(48):
        write(measured(number, 150), tmp_path / f"loop{number}.csv")
    command = "batch loop*.csv --model bouc-wen --starts 2 --workers 1 --reports 0 --out".split()
    options = {"cwd": tmp_path, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "env": _plain(tmp_path)}
    running = subprocess.Popen([*MAIN, *command, "killed"], **options)
    rows = _first_rows(running, tmp_path / "killed")
    running.send_signal(signal.SIGKILL)
    running.communicate()
    done = len(rows.read_bytes().splitlines())
    assert 0 < done < 48
    monkeypatch.chdir(tmp_path)
    for out in ("killed", "whole"):
        assert cli.run([*command, out]) == 0
        # A slow machine adds lines of progress, and nothing else.
        said = capsys.readouterr().err.splitlines()
        assert [line for line in said if not re.fullmatch(r"fitting .*: .* \(\d+ s\)", line)] == []
    assert (tmp_path / "killed" / "fits.csv").read_bytes() == (tmp_path / "whole" / "fits.csv").read_bytes()
    assert len(rows.read_bytes().splitlines()) == 48


@pytest.mark.slow
def test_an_interrupt_ends_a_batch_of_several_processes(tmp_path):
    for number in range(64):
        write(measured(number, 150), tmp_path / f"loop{number}.csv")
    command = [*MAIN, "batch", "loop*.csv", "--model", "bouc-wen", "--starts", "2", "--workers", "2", "--out", "out"]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        running = subprocess.Popen(
            command, cwd=tmp_path, stderr=subprocess.PIPE, env=_plain(tmp_path), start_new_session=True
        )
    finally:
        signal.signal(signal.SIGINT, before)
    _first_rows(running, tmp_path / "out")
    os.killpg(running.pid, signal.SIGINT)  # as a terminal sends it
    error = running.communicate(timeout=60)[1].decode()
    assert running.returncode == 130
    assert "Traceback" not in error
    assert "the same command resumes" in error


def _first_rows(running: subprocess.Popen, out: Path) -> Path:
    """The file of rows of a running command, as soon as it has some."""
    rows, until = out / "run" / "rows.jsonl", time.monotonic() + 200
    while not (rows.exists() and rows.read_bytes()):
        assert running.poll() is None, running.stderr.read().decode()
        assert time.monotonic() < until
        time.sleep(0.01)
    return rows


def _plain(home: Path) -> dict[str, str]:
    """The environment without settings of this session, with its compiler flags and cache of compiled programs."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_ENABLE", "HYSTFIT_"))}
    return kept | {"HOME": str(home), "MPLCONFIGDIR": str(home)}


@pytest.mark.slow
def test_processes_and_dask_workers_make_the_same_rows(folder):
    alone = hf.fit_many("bouc-wen", f"{folder}/*.csv", **QUICK)
    assert hf.fit_many("bouc-wen", f"{folder}/*.csv", workers=2, **QUICK).rows == alone.rows
    with _cluster() as cluster:
        address = cluster.scheduler_address
        assert hf.fit_many("bouc-wen", f"{folder}/*.csv", scheduler=address, **QUICK).rows == alone.rows
        # Several tasks, as loops solved by themselves are: the worker is lost between the first and the last.
        by_scipy = {**QUICK, "method": "trf"}
        alone, first = hf.fit_many("bouc-wen", f"{folder}/*.csv", **by_scipy), cluster.workers[0].pid
        lost = hf.fit_many("bouc-wen", f"{folder}/*.csv", scheduler=address, progress=_lost(cluster), **by_scipy)
        assert lost.rows == alone.rows
        assert cluster.workers[0].pid != first


def _lost(cluster) -> Callable[[str, float], None]:
    """Kills the only worker of a cluster at the first progress of a run; its nanny starts another one."""
    killed = []

    def progress(text: str, fraction: float) -> None:
        if not killed:
            killed.append(cluster.workers[0].pid)
            os.kill(killed[0], signal.SIGKILL)

    return progress


@contextlib.contextmanager
def _cluster():
    settings = {"threads_per_worker": 1, "protocol": "tcp://", "dashboard_address": ":0"}
    with distributed.LocalCluster(n_workers=1, processes=True, **settings) as cluster:
        yield cluster


def test_a_task_that_ends_its_process_is_tried_again(folder, tmp_path, monkeypatch):
    fit_sources = many.fit_sources

    def ends(task, sources):
        raise MemoryError("out of memory")

    monkeypatch.setattr(many, "fit_sources", ends)
    broken = hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=tmp_path / "run", **QUICK)
    assert broken.status is Status.FAILED
    assert "out of memory" in broken.rows[0].reason
    monkeypatch.setattr(many, "fit_sources", fit_sources)
    assert hf.fit_many("bouc-wen", f"{folder}/*.csv", folder=tmp_path / "run", **QUICK).status is Status.OK


def test_progress_counts_the_loops(records):
    seen = []
    hf.fit_many("bouc-wen", records[:2], progress=lambda text, fraction: seen.append((text, fraction)), **QUICK)
    assert seen[-1] == ("2 of 2 loops", 1.0)


# -- the table -------------------------------------------------------------------------------------------------------------------


def test_the_table_as_a_frame_as_csv_as_netcdf_and_as_zarr(fits, tmp_path):
    import xarray

    frame = fits.to_dataframe()
    assert list(frame["loop"]) == [row.name for row in fits]
    assert frame.attrs["units"]["tau"] == "1/V"
    np.testing.assert_array_equal(frame["tau"], fits.values("tau"))
    with fits.save(tmp_path / "fits.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_allclose([float(row["tau [1/V]"]) for row in rows], fits.values("tau"), rtol=1e-14)
    assert all(len(row["sha256"]) == 64 for row in rows)
    with xarray.open_dataset(fits.save(tmp_path / "fits.nc"), engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["tau"], fits.values("tau"))
        assert data["tau_stderr"].attrs["units"] == "1/V"
        xarray.testing.assert_equal(xarray.open_zarr(fits.save(tmp_path / "fits.zarr")).load(), data.load())
    with pytest.raises(DataError, match="written as"):
        fits.save(tmp_path / "fits.ods")


def test_headings_of_unknown_units_have_one_pair_of_brackets(records, tmp_path):
    fits = hf.fit_many("bouc-wen", [hf.Record(u=records[0].u, y=records[0].y, t=records[0].t)], **QUICK)
    with fits.save(tmp_path / "fits.csv").open(encoding="utf-8") as file:
        head = next(csv.reader(file))
    assert {"c [y]/[u]", "c_stderr [y]/[u]"} <= set(head)


def test_parquet(fits, tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    again = pandas.read_parquet(fits.save(tmp_path / "fits.parquet"))
    np.testing.assert_array_equal(again["tau"], fits.values("tau"))


@pytest.mark.parametrize(
    ("package", "ending", "extra"),
    [
        ("pandas", ".parquet", "frames"),
        ("pyarrow", ".parquet", "frames"),
        ("xarray", ".nc", "frames"),
        ("h5netcdf", ".nc", "frames"),
        ("zarr", ".zarr", "frames"),
    ],
)
def test_a_missing_package_is_named_with_its_extra(package, ending, extra, fits, tmp_path, monkeypatch):
    if package == "pandas":
        monkeypatch.setitem(sys.modules, "pyarrow", sys)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"{package}.*hystfit-jax\[{extra}\]"):
        fits.save(tmp_path / f"fits{ending}")


def test_the_summary_is_that_of_the_usable_fits(fits):
    rows = {row["parameter"]: row for row in fits.summary().to_list()}
    tau = np.array([row.values["tau"] for row in fits])
    assert rows["tau"]["median"] == pytest.approx(np.median(tau))
    assert rows["tau"]["standard deviation"] == pytest.approx(np.std(tau, ddof=1))
    assert rows["tau"]["loops"] == 6
    with pytest.raises(ParameterError, match="did you mean 'tau'"):
        fits.values("taus")


# -- the page and the command ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("values", [[1.0, 1.0 + 2e-16], [1e20] * 3, [0.0, 0.0], [-3e-7, -3e-7 * (1 + 1e-14)]])
def test_values_that_are_practically_equal_are_one_bar(values):
    """Bins between them would be narrower than floating point allows; identical files have such parameters."""
    picture = histogram(np.array(values), "c")
    counts = [int(count) for count in re.findall(r": (\d+)</title>", picture)]
    assert max(counts) == sum(counts) == len(values)
    assert "nan" not in picture
    assert "inf" not in picture


def test_the_overview_is_one_page_that_needs_nothing_else(fits):
    page = overview(fits, {"loop 1": "reports/loop-1/report.html"})
    assert not re.search(r"https?://|<script|<link|url\(", page)
    assert re.findall(r'(?:src|href)="([^"]*)"', page) == ["reports/loop-1/report.html"]
    assert 'name="viewport"' in page
    assert "prefers-color-scheme: dark" in page
    assert page.count("<svg") == len(fits.names) + len(fits.quantities)
    counted = sum(int(count) for count in re.findall(r"<title>[^<]*: (\d+)</title>", page))
    assert counted == 6 * page.count("<svg")


def test_names_of_loops_cannot_break_the_page():
    named = measured(1, 150).replace(name="<b>&", y_unit="<i>")
    page = overview(hf.fit_many("bouc-wen", [named], **QUICK))
    assert "<b>&" not in page
    assert "<i>" not in page


def test_the_command_writes_table_page_and_reports(folder, tmp_path, capsys):
    (folder / "bad.csv").write_text("one,two\nred,blue\n")
    out = tmp_path / "out"
    arguments = [
        "batch",
        f"{folder}/*.csv",
        "--model",
        "bouc-wen",
        "--starts",
        "2",
        "--reports",
        "1",
        "--units",
        "V,nm",
    ]
    assert cli.run([*arguments, "--table", "zarr", "--out", str(out), "--json"]) == 1
    content = json.loads(capsys.readouterr().out)
    assert content == json.loads((out / "result.json").read_text())
    assert (content["schema"], content["status"]) == ("hystfit.batch/1", "partial")
    assert content["counts"] == {"ok": 8, "failed": 1}
    assert content["units"]["y"] == "nm"
    assert {path.name for path in out.iterdir()} == {
        "result.json", "fits.csv", "fits.zarr", "overview.html", "reports", "run"
    }  # fmt: skip
    reports = list((out / "reports").glob("*/report.html"))
    assert len(reports) == 1
    assert {path.name for path in reports[0].parent.iterdir()} == {"report.html", "report.txt"}  # with its pictures
    assert reports[0].read_text().count("data:image/svg+xml") >= 6
    assert f'href="{reports[0].relative_to(out)}"' in (out / "overview.html").read_text()
    assert cli.run([*arguments, "--out", str(out)]) == 1  # resumes
    assert cli.run([*arguments, "--seed", "1", "--out", str(out)]) == 2
    assert "another batch" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none*.csv"], "no file matches"),
        ([], "LOOP is missing"),
        (["{folder}/loop1.csv", "{folder}/*.csv"], "is given 2 times"),
        (["{folder}/*.csv", "--reports", "some"], "--reports"),
        (["{folder}/*.csv", "--fix", "nu"], "no parameter 'nu'"),
        (["{folder}"], "is a folder"),
    ],
)
def test_bad_arguments_are_status_2(arguments, message, folder, capsys):
    filled = [argument.format(folder=folder) for argument in arguments]
    assert cli.run(["batch", *filled, "--model", "bouc-wen"]) == 2
    assert message in capsys.readouterr().err
