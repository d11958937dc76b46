"""Loops whose ends a saturated sensor cuts off: of elastic stops the loss, the peak and the stiffness are known."""

import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.fit_setup import without_faults
from hystfit.fitting.structure.structure_search import search_structure
from hystfit.outcome import Code
from hystfit.outcome.note import has
from hystfit.quality.faults import saturated_samples
from hystfit.quality.host_operators import play_positions
from hystfit.results.measured.loop_values import quantities

AMPLITUDE, YIELD, SPRING = 10.0, 2.0, 0.5  # mm, mm, kN/mm
FORCE = 4.0  # kN at which the stop slides
LOSS = 4 * FORCE * (AMPLITUDE - YIELD)  # J
PEAK = SPRING * AMPLITUDE + FORCE


def cut_off(limit: float, seed: int = 3) -> hf.Record:
    """Four cycles of a spring beside a stop, with noise, by a load cell with this limit [kN]."""
    t = np.arange(0, 20, 0.02)
    x = AMPLITUDE * np.sin(0.4 * np.pi * t)
    stop = x - play_positions(x, np.array([YIELD]))[:, 0]
    noise = np.random.default_rng(seed).normal(0.0, 0.03, x.size)
    force = SPRING * x + FORCE / YIELD * stop + noise
    return hf.Record(x, np.clip(force, -limit, limit), t, u_unit="mm", y_unit="kN")


@pytest.mark.parametrize("limit", [7.5, 5.5])  # 36 and 56 % of the samples are at a limit
def test_the_model_gives_the_loop_that_the_sensor_cut_off(limit: float) -> None:
    record = cut_off(limit)
    assert saturated_samples(record.u, record.y).sum() > 0.9 * np.sum(np.abs(record.y) == limit)
    found = hf.fit("prandtl-ishlinskii-stop", record)
    assert has(found.notes, Code.CLIPPED)
    assert found.input_range == pytest.approx((-AMPLITUDE, AMPLITUDE), rel=1e-3)
    values = {one.name: one for one in found.quantities}
    assert values["loop_area"].value == pytest.approx(LOSS, rel=0.01)
    assert values["stroke"].value == pytest.approx(2 * PEAK, rel=0.01)
    assert values["loop_area"].measured is None


def test_ranges_and_areas_of_a_loop_that_is_cut_off_are_lower_bounds() -> None:
    values = quantities(cut_off(7.5))
    (rows,), (notes,) = values.rows.values(), values.notes.values()
    assert has(notes, Code.CLIPPED)
    found = {row.name: row for row in rows}
    most = {"stroke": 2 * PEAK, "loop_area": LOSS, "secant_stiffness": PEAK / AMPLITUDE}
    for name, value in most.items():
        assert 0.7 * value < found[name].value < value
        assert found[name].stderr is None
        assert "at least" in found[name].label
    assert "equivalent_damping_percent" not in found


@pytest.mark.parametrize("seed", [14, 3])
def test_a_knee_between_two_thresholds_is_no_creep(seed: int) -> None:
    """At one pace twice as many thresholds describe the knee of the stop, and creep and lag a part of it."""
    found = search_structure(without_faults(hf.Dataset.of(cut_off(7.5, seed))))
    assert not found.structure.timed
    assert found.plays > 20
