"""One model fitted to every loop of an array."""

import dataclasses
import errno
import functools
from pathlib import Path

import h5py
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import xarray as xr

import hystfit as hf
from hystfit.batch import fit_map as maps
from hystfit.batch import loop_map
from hystfit.batch.simulated_rows import simulate_rows
from hystfit.errors import DataError, HystfitError, ParameterError
from hystfit.outcome import Status

SAMPLES, SHAPE = 480, (3, 8)
T = np.arange(SAMPLES) / 100
U = 3 * np.sin(2 * np.pi * T) * (0.4 + 0.6 * T / T[-1])
UNITS = {"u_unit": "V", "y_unit": "um", "starts": 2}


@functools.cache
def truth() -> dict[str, np.ndarray]:
    """A gradient in the slope, a spot in mu."""
    row, column = np.indices(SHAPE)
    return {"c": 1.0 + 0.05 * column, "mu": 0.4 + 0.1 * ((row == 1) & (column == 3)), "offset": 0.1 * row}


@functools.cache
def cube() -> np.ndarray:
    """Outputs of the truth with noise; one loop missing, one constant, one with a jump."""
    rng, y = np.random.default_rng(4), np.empty((*SHAPE, SAMPLES))
    for place in np.ndindex(*SHAPE):
        values = {name: float(array[place]) for name, array in truth().items()}
        y[place] = np.asarray(hf.simulate(hf.BoucWen(tau=0.5, rho=0.4, **values), U)[0])
    y += 0.005 * rng.normal(size=y.shape)
    y[0, 1], y[1, 2] = np.nan, 2.0
    y[2, 5, 200:] += 1.0
    return y


@functools.cache
def fitted() -> hf.LoopMap:
    return hf.fit_map("bouc-wen", U, cube(), T, **UNITS)


def test_maps_are_the_truth_within_their_errors_and_bad_loops_have_reasons() -> None:
    found = fitted()
    assert found.status is Status.PARTIAL
    assert found.statuses[0, 1] == found.statuses[1, 2] == str(Status.FAILED)
    assert "no finite value" in found.reasons[0, 1]
    assert "constant" in found.reasons[1, 2]
    assert not found.ok[2, 5]
    assert found.ok.sum() == 21
    for name, wanted in truth().items():
        pulls = ((found[name] - wanted) / found.stderr[name])[found.ok]
        assert np.abs(pulls).max() < 4.5
        assert 0.5 < np.std(pulls) < 1.6
    assert np.isnan(found["c"][0, 1])
    assert found.units["c"] == "um/V"
    text = str(found)
    assert "fitted to 24 loops" in text
    assert "were judged together" in text
    assert not found.alone[0, 0]
    assert found.alone[2, 5]


def test_a_loop_is_that_of_fit() -> None:
    found, record = fitted(), hf.Record(u=U, y=cube()[1, 3], t=T, u_unit="V", y_unit="um")
    alone = hf.fit("bouc-wen", record, starts=2)
    again = found.result((1, 3), cube()[1, 3])
    np.testing.assert_allclose(again.x, alone.x, rtol=1e-12)
    for p in alone.parameters:
        if not p.fixed:
            assert abs(found[p.name][1, 3] - p.value) < 1e-5 * p.stderr
            assert found.stderr[p.name][1, 3] == pytest.approx(p.stderr, rel=1e-3)
    assert found["error_percent"][1, 3] == pytest.approx(alone.train.nrmse_percent, rel=1e-6)
    with pytest.raises(ParameterError, match="did you mean 'mu'"):
        found["mue"]


def test_a_file_is_read_part_by_part_and_an_interrupted_map_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with h5py.File(tmp_path / "cube.h5", "w") as file:
        file["y"] = cube()
    monkeypatch.setattr(maps, "SAMPLES", SHAPE[1] * SAMPLES)
    sizes, fit_part = [], maps._fit_part

    def watched(work: object, frame: object, y: np.ndarray) -> object:
        sizes.append(len(y))
        if len(sizes) == 3:
            raise KeyboardInterrupt
        return fit_part(work, frame, y)

    monkeypatch.setattr(maps, "_fit_part", watched)
    with h5py.File(tmp_path / "cube.h5") as file:
        run = lambda: hf.fit_map("bouc-wen", U, file["y"], T, folder=tmp_path / "run", workers=1, **UNITS)
        with pytest.raises(KeyboardInterrupt):
            run()
        found = run()
    assert sizes == [8, 8, 8, 8]  # the last part alone is computed again
    np.testing.assert_allclose(found["mu"], fitted()["mu"], rtol=1e-6)
    np.testing.assert_array_equal(found.statuses, fitted().statuses)
    with pytest.raises(DataError, match="another map"):
        hf.fit_map("bouc-wen", U, cube(), T, folder=tmp_path / "run", starts=3)
    sizes.clear()
    changed = cube().copy()
    changed[0, 0] += 1.0
    hf.fit_map("bouc-wen", U, changed, T, folder=tmp_path / "run", workers=1, **UNITS)
    assert sizes == [8]


def test_a_full_disk_is_said_and_leaves_no_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(DataError, match="No space left"):
        hf.fit_map("bouc-wen", U, cube()[:1], T, folder=tmp_path / "run", **UNITS)
    assert [file.name for file in (tmp_path / "run").iterdir()] == ["map.json"]


def test_tables_and_pictures(tmp_path: Path) -> None:
    found = fitted()
    data = xr.open_dataset(found.save(tmp_path / "map.nc"), engine="h5netcdf")
    assert data["mu"].dims == ("y", "x")
    np.testing.assert_array_equal(data["mu_stderr"], found.stderr["mu"])
    assert data["c"].attrs["units"] == "um/V"
    table = pd.read_parquet(found.save(tmp_path / "map.parquet"))
    assert len(table) == 24
    assert table["status"].value_counts()["ok"] == 21
    with pytest.raises(DataError, match=r"\.parquet, \.nc, \.zarr"):
        found.save(tmp_path / "map.txt")
    figure = found.plot("mu")
    shown = figure.axes[0].images[0].get_array()
    assert shown.shape == SHAPE
    assert np.ma.is_masked(np.ma.masked_invalid(shown)[0, 1])
    assert found.outliers("mu")[1, 3]
    plt.close(figure)


def test_a_long_table_is_written_in_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = fitted()
    whole = pd.read_parquet(found.save(tmp_path / "whole.parquet"))
    monkeypatch.setattr(loop_map, "_ROWS", 2 * SHAPE[1])
    table = pd.read_parquet(found.save(tmp_path / "map.parquet"))
    pd.testing.assert_frame_equal(table, whole)
    assert pq.ParquetFile(tmp_path / "map.parquet").num_row_groups > 1
    np.testing.assert_array_equal(table["mu"].to_numpy().reshape(SHAPE), found["mu"])
    np.testing.assert_array_equal(table["y"].to_numpy().reshape(SHAPE), np.indices(SHAPE)[0])


@pytest.mark.slow
def test_loops_of_few_samples_have_reasons() -> None:
    for samples in (2, 7):
        found = hf.fit_map("bouc-wen", U[:samples], cube()[..., :samples], workers=1, starts=1)
        assert not found.ok.any()
        assert len(found.reasons) == found.alone.size


def test_programs_do_not_depend_on_the_number_of_sound_loops() -> None:
    """Every part of a map has another number of them, and each compiled programs of its own: 1 kB of memory a loop."""
    outputs = cube()[1:].reshape(-1, SAMPLES).copy()
    fit = lambda y: hf.fit_map("bouc-wen", U, y, T, workers=1, starts=1)
    fit(outputs)
    before = simulate_rows._cache_size()
    outputs[2] = np.nan
    fit(outputs)
    assert simulate_rows._cache_size() == before


@pytest.mark.parametrize("ending", ["nc", "parquet", "zarr"])
def test_a_table_that_does_not_fit_on_the_disk_leaves_the_older_one(tmp_path: Path, ending: str) -> None:
    resource = pytest.importorskip("resource", reason="limits the size of files")
    found, path = fitted(), tmp_path / f"map.{ending}"
    found.save(path)
    stored = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, limits[1]))
    try:
        with pytest.raises(HystfitError, match="cannot write"):
            found.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == stored


def test_a_store_is_replaced_as_a_whole_and_no_other_folder(tmp_path: Path) -> None:
    found = fitted()
    wider = dataclasses.replace(found, quantities={**found.quantities, "width": found["c"]})
    assert "width" in xr.open_zarr(wider.save(tmp_path / "map.zarr"))
    assert "width" not in xr.open_zarr(found.save(tmp_path / "map.zarr"))
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr/notes.txt").touch()
    with pytest.raises(HystfitError, match="no Zarr store"):
        found.save(tmp_path / "other.zarr")
    assert [file.name for file in (tmp_path / "other.zarr").iterdir()] == ["notes.txt"]


@pytest.mark.parametrize(
    ("u", "y", "words"),
    [
        (U, cube()[0, 0], "shape"),
        (U[:5], cube(), "5 samples"),
        (U, np.empty((0, SAMPLES)), "at least one loop"),
        (np.where(U > 2.5, np.nan, U), cube(), "input is not finite"),
        (U[:1], cube()[..., :1], "at least two"),
    ],
)
def test_columns_that_do_not_fit_each_other_are_refused(u: np.ndarray, y: np.ndarray, words: str) -> None:
    with pytest.raises(DataError, match=words):
        hf.fit_map("bouc-wen", u, y)


def test_a_model_that_cannot_be_fitted_to_them_gives_rows_with_reasons() -> None:
    found = hf.fit_map("bouc-wen", np.ones(SAMPLES), cube()[:1], T)
    assert found.status is Status.FAILED
    assert "the input is constant" in found.reasons[0, 0]
    with pytest.raises(ParameterError, match="fits one model"):
        hf.fit_map("auto", U, cube(), T)
