"""Arrays of loops in files, and `hystfit map`."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
import zarr

import hystfit as hf
from hystfit import cli
from hystfit.errors import DataError
from hystfit.reading.cubes import open_cube

SAMPLES, SHAPE = 400, (2, 5)
T = np.arange(SAMPLES) * 10.0  # ms
U = 3 * np.sin(2 * np.pi * T / 1000) * (0.4 + 0.6 * T / T[-1])


def outputs() -> np.ndarray:
    """In nm, with the samples last; one loop is missing."""
    rng, y = np.random.default_rng(0), np.empty((*SHAPE, SAMPLES))
    for row, column in np.ndindex(*SHAPE):
        model = hf.BoucWen(c=1 + 0.1 * column, mu=0.4 + 0.02 * row, tau=0.5, rho=0.4)
        y[row, column] = np.asarray(hf.simulate(model, U)[0]) + 0.005 * rng.normal(size=SAMPLES)
    y[0, 1] = np.nan
    return y


def scan(folder: Path, kind: str) -> Path:
    """A file in other units, with the samples first and a coordinate of the scan."""
    path = folder / f"scan.{kind}"
    arrays = {"z": 1e-9 * np.moveaxis(outputs(), -1, 0), "bias_V": U, "time_ms": T, "column": np.arange(5.0)}
    if kind == "h5":
        with h5py.File(path, "w") as file:
            for name, values in arrays.items():
                file[f"scan/{name}"] = values
            file["scan/z"].attrs["units"] = "m"
        return path
    group = zarr.open_group(path, mode="w", zarr_format=int(kind[-1])).create_group("scan")
    for name, values in arrays.items():
        group.create_array(name, data=values)
    group["z"].attrs["units"] = "m"
    return path


@pytest.mark.parametrize("kind", ["h5", "zarr2", "zarr3"])
def test_data_sets_and_units_are_recognized(tmp_path: Path, kind: str) -> None:
    path = scan(tmp_path, kind)
    with open_cube(path, units="V,nm") as cube:
        assert cube.names == {"u": "scan/bias_V", "y": "scan/z", "t": "scan/time_ms"}
        assert cube.units == {"u": "V", "y": "nm", "t": "s"}
        assert cube.y.shape == (*SHAPE, SAMPLES)
        np.testing.assert_allclose(cube.y[1:2], outputs()[1:2], rtol=1e-12)
        np.testing.assert_array_equal(cube.u, U)
        np.testing.assert_allclose(cube.t, T / 1000)
    with open_cube(path, time="none") as cube:
        assert cube.t is None


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        ({"z": np.zeros((3, 4)), "bias": np.zeros(4), "gate": np.zeros(4)}, {}, "bias, gate|bias or gate"),
        ({"z": np.zeros((3, 4)), "a": np.zeros(3), "b": np.zeros(4)}, {}, "name it with input="),
        ({"z": np.zeros(4), "u": np.zeros(4)}, {}, "no array of loops"),
        ({"z": np.zeros((3, 4)), "u": np.zeros(4)}, {"output": "w"}, "no data set 'w'"),
        ({"z": np.zeros((3, 4)), "u": np.zeros(5)}, {"input": "u"}, "input"),
    ],
)
def test_a_file_whose_input_is_not_known_is_refused(
    content: dict[str, np.ndarray], options: dict[str, str], words: str, tmp_path: Path
) -> None:
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        for name, values in content.items():
            file[name] = values
    with pytest.raises(DataError, match=words), open_cube(tmp_path / "scan.h5", **options):
        pass


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scan.h5").write_text("t,u,y\n")
    with pytest.raises(DataError, match="no HDF5 or netCDF-4 file"), open_cube(tmp_path / "scan.h5"):
        pass


@pytest.mark.parametrize("kind", ["nc", "zarr2", "zarr3"])
def test_packed_outputs_are_those_that_xarray_reads(tmp_path: Path, kind: str) -> None:
    path, z = tmp_path / f"packed.{kind}", outputs()
    data = xr.Dataset({"z": (("y", "x", "sample"), z), "w": (("y", "x", "sample"), z), "u": ("sample", U)})
    codes = {"z": {"dtype": "int16", "scale_factor": 1e-3, "add_offset": 0.5, "_FillValue": np.int16(-32768)}}
    codes["w"] = {"_FillValue": -1e30}
    if kind == "nc":
        data.to_netcdf(path, engine="h5netcdf", encoding=codes)
    else:
        data.to_zarr(path, zarr_format=int(kind[-1]), consolidated=False, encoding=codes)
    for name, error in (("z", 1e-3), ("w", 0.0)):
        with open_cube(path, output=name, input="u") as cube:
            np.testing.assert_allclose(cube.y[:], z, rtol=0, atol=error)  # NaN where NaN was


@pytest.mark.parametrize("kind", ["h5", "zarr3"])
def test_damaged_outputs_are_an_error(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"scan.{kind}"
    if kind == "h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("z", data=outputs(), chunks=(1, 5, SAMPLES), compression="gzip")
            file["u"] = U
            place = file["z"].id.get_chunk_info(1).byte_offset
        with path.open("r+b") as damaged:
            damaged.seek(place)
            damaged.write(bytes(200))
    else:
        group = zarr.open_group(path, mode="w")
        group.create_array("z", data=outputs(), chunks=(1, 5, SAMPLES))
        group.create_array("u", data=U)
        (path / "z/c/1/0/0").write_bytes(bytes(200))
    with open_cube(path) as cube:
        np.testing.assert_array_equal(cube.y[:1], outputs()[:1])
        with pytest.raises(DataError, match="damaged"):
            cube.y[1:]


def test_a_store_that_is_damaged_or_no_cube_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    zarr.save_array(tmp_path / "alone.zarr", outputs())
    with pytest.raises(DataError, match="name it with input="), open_cube(tmp_path / "alone.zarr"):
        pass
    with pytest.raises(DataError, match="hystfit map"):
        hf.read(tmp_path / "alone.zarr")
    for verb in ("fit", "batch"):
        assert cli.run([verb, str(tmp_path / "alone.zarr")]) == 2
        assert "hystfit map" in capsys.readouterr().err
    (tmp_path / "alone.zarr/zarr.json").write_text("{")
    with pytest.raises(DataError, match="cannot be opened"), open_cube(tmp_path / "alone.zarr"):
        pass
    with pytest.raises(DataError, match="no Zarr store"), open_cube(tmp_path):
        pass


def test_the_command_writes_maps_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = scan(tmp_path, "zarr3"), tmp_path / "maps"
    arguments = ["map", str(path), "--model", "bouc-wen", "--units", "V,nm", "--starts", "2", "--out", str(out)]
    assert cli.run([*arguments, "--table", "zarr"]) == 1  # one loop has no fit
    assert "10 loops: 9 ok, 1 failed" in capsys.readouterr().out
    content = json.loads((out / "result.json").read_text())
    assert (content["schema"], content["status"], content["shape"]) == ("hystfit.map/1", "partial", [2, 5])
    assert content["not_usable"][0]["place"] == [0, 1]
    maps = xr.open_dataset(out / "maps.nc", engine="h5netcdf")
    errors = np.abs(maps["c"] - (1 + 0.1 * np.arange(5))) / maps["c_stderr"]
    assert float(errors.max()) < 4.5
    assert maps["c"].attrs["units"] == "nm/V"
    assert (out / "map_mu.png").stat().st_size > 5000
    xr.testing.assert_equal(xr.open_zarr(out / "maps.zarr").load(), maps.load())
