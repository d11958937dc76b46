"""Files with a loop in each row, and files that are not, though their columns are numbered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hystfit as hf

SAMPLES = 60
PHASE = np.linspace(0, 2 * np.pi, SAMPLES)


def loops(sizes: list[float]) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(50 * size * np.sin(PHASE), 4 * size * np.sin(PHASE - 0.2)) for size in sizes]


@pytest.mark.parametrize("interleaved", [False, True])
@pytest.mark.parametrize("sizes", [[1.0, 0.7, 0.4], [1.0, 0.9, 0.8, 1.1, 0.95], [1.0, 0.98]])
def test_each_row_is_a_record(sizes: list[float], interleaved: bool, tmp_path: Path) -> None:
    """Samples beside each other, all inputs first or in turn with the outputs; the device names the record, its setting stays with it."""
    names = [[f"u_{k}_V", f"x_{k}_um"] for k in range(SAMPLES)]
    order = (
        [name for pair in names for name in pair] if interleaved else [pair[side] for side in (0, 1) for pair in names]
    )
    lines = [",".join(["device", "freq_Hz", *order])]
    for number, (u, y) in enumerate(loops(sizes)):
        values = np.stack([u, y], axis=1).ravel() if interleaved else np.concatenate([u, y])
        lines.append(",".join([f"D{number}", "10", *(f"{value:.5f}" for value in values)]))
    path = tmp_path / "devices.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    records = list(hf.read(path))
    assert [record.name for record in records] == [f"D{number}" for number in range(len(sizes))]
    assert [(record.u_unit, record.y_unit) for record in records] == [("V", "um")] * len(sizes)
    for record, (u, y) in zip(records, loops(sizes), strict=True):
        np.testing.assert_allclose(record.u, u, atol=1e-5)
        np.testing.assert_allclose(record.y, y, atol=1e-5)
        assert record.metadata["freq_Hz"] == "10"


def test_sensors_beside_each_other_are_no_samples(tmp_path: Path) -> None:
    """Ten thermometers and ten pressures, sampled more often than there are sensors."""
    t = np.arange(200)
    drive = np.sin(t / 20)
    columns = [t, drive, *(20 + drive + k for k in range(10)), *(5 + k + drive**2 for k in range(10))]
    names = ["time", "valve", *(f"T{k}" for k in range(10)), *(f"P{k}" for k in range(10))]
    path = tmp_path / "sensors.csv"
    rows = [",".join(f"{value:.4f}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(names), *rows]) + "\n", encoding="utf-8")
    record = hf.read(path, input="valve", output="T3")
    np.testing.assert_allclose(record.y, columns[5], atol=1e-4)
    free = hf.read(path)
    assert isinstance(free, hf.Record)
    assert len(free) == t.size
