"""Arrays of loops in files, and `hystfit map`."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

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


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A file in other units, with the samples first and a coordinate of the scan."""
    path = tmp_path / "scan.h5"
    with h5py.File(path, "w") as file:
        file["scan/z"] = 1e-9 * np.moveaxis(outputs(), -1, 0)
        file["scan/z"].attrs["units"] = "m"
        file["scan/bias_V"], file["scan/time_ms"], file["scan/column"] = U, T, np.arange(5.0)
    return path


def test_data_sets_and_units_are_recognized(scan: Path) -> None:
    with open_cube(scan, units="V,nm") as cube:
        assert cube.names == {"u": "scan/bias_V", "y": "scan/z", "t": "scan/time_ms"}
        assert cube.units == {"u": "V", "y": "nm", "t": "s"}
        assert cube.y.shape == (*SHAPE, SAMPLES)
        np.testing.assert_allclose(cube.y[1:2], outputs()[1:2], rtol=1e-12)
        np.testing.assert_array_equal(cube.u, U)
        np.testing.assert_allclose(cube.t, T / 1000)
    with open_cube(scan, time="none") as cube:
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


def test_the_command_writes_maps_and_pictures(scan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = scan.parent / "maps"
    arguments = ["map", str(scan), "--model", "bouc-wen", "--units", "V,nm", "--starts", "2", "--out", str(out)]
    assert cli.run(arguments) == 1  # one loop has no fit
    assert "10 loops: 9 ok, 1 failed" in capsys.readouterr().out
    content = json.loads((out / "result.json").read_text())
    assert (content["schema"], content["status"], content["shape"]) == ("hystfit.map/1", "partial", [2, 5])
    assert content["not_usable"][0]["place"] == [0, 1]
    maps = xr.open_dataset(out / "maps.nc", engine="h5netcdf")
    errors = np.abs(maps["c"] - (1 + 0.1 * np.arange(5))) / maps["c_stderr"]
    assert float(errors.max()) < 4.5
    assert maps["c"].attrs["units"] == "nm/V"
    assert (out / "map_mu.png").stat().st_size > 5000
