"""Quantities of measured loops: closed forms of an ellipse, repeats of noisy loops, and results that an instrument states."""

import json
from typing import Any

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.data.record import Stated
from hystfit.outcome import Code
from hystfit.quality.loops import closed_loops, cycles
from hystfit.quality.shape import loop_shape
from hystfit.results.measured.loop_branches import crossing
from hystfit.results.measured.loop_values import quantities
from hystfit.results.measured.quantities import QUANTITIES
from hystfit.results.quantity_estimates import measured_quantities

PHASE = np.linspace(0, 2 * np.pi, 2001)
MAGNETIC = {"u_unit": "A/m", "y_unit": "T", "u_name": "H", "y_name": "B"}


def ellipse(noise=0.0, seed=0, delay=0.4, turns=1, count=2001, **labels):
    """u = 3 cos x, y = 2 cos(x - delay), from the largest input."""
    phase = np.linspace(0, 2 * np.pi * turns, count)
    y = 2 * np.cos(phase - delay) + np.random.default_rng(seed).normal(0, noise or 1e-12, count)
    return hf.Record(3 * np.cos(phase), y, **{**MAGNETIC, **labels})


def values_of(record):
    (rows,) = quantities(record).rows.values()
    return {one.name: one for one in rows}


def test_an_ellipse_has_the_values_of_its_closed_form():
    found = values_of(ellipse())
    assert found["coercive_input"].value == pytest.approx(3 * np.sin(0.4), rel=1e-5)  # y = 0
    assert found["remanence"].value == pytest.approx(2 * np.sin(0.4), rel=1e-5)  # u = 0
    assert found["coercive_input_rising"].value == pytest.approx(3 * np.sin(0.4), rel=1e-5)
    assert found["coercive_input_falling"].value == pytest.approx(-3 * np.sin(0.4), rel=1e-5)
    assert found["remanence_falling"].value == pytest.approx(2 * np.sin(0.4), rel=1e-5)
    assert found["loop_area"].value == pytest.approx(np.pi * 3 * 2 * np.sin(0.4), rel=1e-4)
    assert found["loop_area"].unit == "J/m3"
    assert found["stroke"].value == pytest.approx(4.0, rel=1e-5)


def test_the_energy_is_that_of_the_units():
    assert values_of(ellipse(u_unit="kA/m", y_unit="mT"))["loop_area"].value == pytest.approx(
        6 * np.pi * np.sin(0.4), rel=1e-4
    )
    force = values_of(ellipse(u_unit="mm", y_unit="kN", u_name="x", y_name="F", delay=-0.4))
    assert force["loop_area"].unit == "J"
    assert force["loop_area"].value == pytest.approx(6 * np.pi * np.sin(0.4), rel=1e-4)
    # The ends of the loop are 4 cos(0.4) apart, over a stroke of 6; damping is the loss over 2 pi times the elastic energy.
    assert force["secant_stiffness"].value == pytest.approx(4 * np.cos(0.4) / 6, rel=1e-3)
    assert force["equivalent_damping_percent"].value == pytest.approx(100 * np.tan(0.4) / 2, rel=1e-3)
    unknown = values_of(ellipse(u_unit="", y_unit="", u_name="a", y_name="b"))
    assert unknown["loop_area"].unit == ""


def test_the_range_of_a_loop_with_noise_is_within_its_error():
    """The largest of many samples at saturation lies above their level, which a model follows."""
    u, noise = 3 * np.sin(np.linspace(0, 4 * np.pi, 801)), np.random.default_rng(0).normal(0, 0.02, 801)
    up = np.gradient(u) > 0
    record = hf.Record(u, np.tanh(20 * (u - np.where(up, 1, -1))) + noise, **MAGNETIC)
    found = values_of(record)["stroke"]
    assert 0.05 < found.value - 2.0 < 2 * found.stderr < 0.4


def test_the_error_of_a_coarse_loop_includes_that_between_its_samples():
    """A steep loop of half a sample's distance in width: where the straight line crosses zero depends on where the samples lie."""
    beyond = []
    for shift in np.linspace(0.0, 0.9, 7):
        h = np.linspace(1, -1, 41) + 0.05 * shift
        both = np.concatenate([h, h[::-1]])
        moment = np.tanh((both + np.repeat([0.012, -0.012], 41)) / 0.03)
        noise = np.random.default_rng(1).normal(0, 1e-3, 82)
        found = values_of(hf.Record(both, moment + noise, **MAGNETIC))
        for name, true in (("coercive_input", 0.012), ("remanence", np.tanh(0.4))):
            beyond.append(abs(found[name].value - true) / found[name].stderr)
    assert max(beyond) < 3
    assert np.mean(beyond) > 0.1  # no error that is always far too large


def test_standard_errors_are_the_scatter_of_noisy_repeats():
    repeats = [values_of(ellipse(0.02, seed, count=401)) for seed in range(64)]  # scatter to 9 %
    for name in ("coercive_input", "remanence", "loop_area"):
        scatter = np.std([found[name].value for found in repeats])
        stated = np.median([found[name].stderr for found in repeats])
        assert 0.6 < stated / scatter < 1.6, name


def test_the_error_of_the_loss_of_cycles_that_decay_covers_the_largest():
    """An ellipse that shrinks by 0.4 % in each cycle, without noise: the median of few cycles is not the loss of the first."""
    phase = np.linspace(0, 4 * np.pi, 4001)
    size = np.exp(-0.004 * phase / (2 * np.pi))
    record = hf.Record(3 * size * np.cos(phase), 2 * size * np.cos(phase - 0.4), **MAGNETIC)
    found = values_of(record)["loop_area"]
    assert found.count >= 2
    assert abs(6 * np.pi * np.sin(0.4) * np.exp(-0.004) - found.value) < 3 * found.stderr < 0.05 * found.value


def test_the_error_of_the_loss_of_several_cycles_is_their_scatter():
    """Cycles share no noise but that of the branches between them."""
    force = {"u_unit": "mm", "y_unit": "kN", "u_name": "x", "y_name": "F", "delay": -0.4}
    repeats = [values_of(ellipse(0.05, seed, turns=10, count=1001, **force)) for seed in range(60)]
    for name in ("loop_area", "secant_stiffness", "equivalent_damping_percent"):
        scatter = np.std([found[name].value for found in repeats])
        assert 0.6 < np.median([found[name].stderr for found in repeats]) / scatter < 1.6


def test_several_cycles_are_averaged():
    one, many = values_of(ellipse(0.02, count=401)), values_of(ellipse(0.02, turns=16, count=401 * 16))
    assert many["loop_area"].count > 10 * one["loop_area"].count
    assert many["coercive_input"].stderr < 0.5 * one["coercive_input"].stderr
    assert many["coercive_input"].value == pytest.approx(3 * np.sin(0.4), abs=4 * many["coercive_input"].stderr)


@pytest.mark.parametrize("mirrored", [1.0, -1.0])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_demagnetization_line_has_its_energy_product(mirrored, reverse):
    """B = 1.2 T (1 + H / Hc): (BH)max is Br Hc / 4, half way."""
    field = np.linspace(0, -80e3, 40)
    flux = 1.2 * (1 + field / 80e3)
    order = slice(None, None, -1 if reverse else 1)
    record = hf.Record(mirrored * field[order], mirrored * flux[order], **MAGNETIC)
    found = values_of(record)
    assert found["coercive_input"].value == pytest.approx(80e3)
    assert abs(found["remanence"].value) == pytest.approx(1.2)
    assert found["energy_product"].value == pytest.approx(1.2 * 80 / 4, rel=1e-6)
    assert found["energy_product"].unit == "kJ/m3"


def test_a_branch_is_read_between_its_samples_in_their_order():
    """B = 1.2 T (1 + H / 80 kA/m), of which the field of two samples near B = 0 was digitized the wrong way round."""
    flux = 1.2 - 0.07 * np.arange(-10, 35)
    field = 80e3 * (flux / 1.2 - 1) + 1e3
    close = np.flatnonzero(np.abs(flux) < 0.07)
    field[close] = np.mean(field[close]) + np.array([-300.0, 300.0])
    found = values_of(hf.Record(field, flux, **MAGNETIC))
    at_zero = np.interp(0.0, -flux, field)
    assert found["coercive_input"].value == pytest.approx(-at_zero, rel=1e-12)
    assert found["remanence"].value == pytest.approx(1.2 * (1 - 1e3 / 80e3), rel=1e-9)


@pytest.mark.parametrize("curve", [np.tanh, lambda x: x**2])
def test_curves_without_a_loop_have_no_quantities_of_a_loop(curve):
    u = np.linspace(0, 3, 200)
    noise = np.random.default_rng(0).normal(0, 0.01, 400)
    assert not values_of(hf.Record(u, curve(u), u_unit="V", y_unit="um"))
    assert not values_of(hf.Record(np.append(u, u[::-1]), np.append(curve(u), curve(u[::-1])) + noise, **MAGNETIC))


def test_results_of_the_instrument_stand_beside_ours():
    stated = (Stated("Vc+", 1.2e-3, "kA/m", "coercive_input"), Stated("Pr-", -0.8, "T", "remanence"))
    found = values_of(ellipse().replace(stated=stated))
    assert found["coercive_input_rising"].stated == pytest.approx(1.2)
    assert found["remanence_rising"].stated == -0.8
    sloped = ellipse().replace(y=ellipse().y + 0.5 * ellipse().u)
    corrected = (Stated("Slope correction", -0.5), Stated("Coercivity", 1.17, "A/m", "coercive_input"))
    found = values_of(sloped.replace(stated=corrected))
    assert found["coercive_input"].stated is None
    assert found["coercive_input_corrected"].value == pytest.approx(3 * np.sin(0.4), rel=1e-4)
    assert found["coercive_input_corrected"].stated == 1.17


@pytest.mark.parametrize(("factor", "said"), [(1.3, True), (-1.3, True), (1.005, False), (-0.995, False)])
def test_a_result_of_the_instrument_that_the_samples_contradict_is_named(factor, said):
    record = ellipse()
    own = values_of(record)["coercive_input"].value
    found = quantities(record.replace(stated=(Stated("Hc", factor * own, "A/m", "coercive_input"),)))
    assert any("another definition" in note.text for notes in found.notes.values() for note in notes) == said


@pytest.mark.parametrize("values", [np.zeros(50), np.full(50, 1e300), np.r_[np.nan, np.ones(49)], np.arange(50.0)])
def test_no_record_makes_it_fail(values):
    with np.errstate(all="raise"):
        quantities(hf.Record(np.sin(np.arange(50.0)), values))
        quantities(hf.Record(np.linspace(-1e300, 1e300, 5), np.arange(5.0)))


def test_the_verb_writes_a_table(tmp_path, capsys):
    record = ellipse()
    rows = "\n".join(f"{u:.9g},{y:.9g}" for u, y in zip(record.u, record.y, strict=True))
    (tmp_path / "loop.csv").write_text(f"H (A/m),B (T)\n{rows}\n")
    assert run(["quantities", str(tmp_path / "loop.csv"), "--out", str(tmp_path / "out")]) == 0
    assert "coercivity" in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "result.json").read_text())
    (found,) = content["quantities"].values()
    assert found["coercive_input"]["value"] == pytest.approx(3 * np.sin(0.4), rel=1e-4)
    assert (tmp_path / "out" / "quantities.csv").read_text().startswith("record,quantity,value")
    u = np.linspace(0, 1, 50)
    (tmp_path / "line.csv").write_text("V,um\n" + "\n".join(f"{a:.4f},{a:.4f}" for a in u))
    assert run(["quantities", str(tmp_path / "line.csv")]) == 1


@pytest.mark.filterwarnings("error")
def test_an_output_of_either_zero_is_no_division_by_zero():
    """0 and -0 side by side are no crossing of zero."""
    u = np.concatenate([np.linspace(-1, 1, 20), np.linspace(1, -1, 20)])
    y = np.where(np.abs(u) < 0.3, np.where(np.arange(40) % 2, 0.0, -0.0), u + 0.2 * np.repeat([-1, 1], 20))
    found = hf.quantities(hf.Record(u, y, u_unit="A/m", y_unit="T"))
    assert all(np.isfinite(value.value) for values in found.rows.values() for value in values)


@pytest.mark.parametrize("count", [120, 121, 400])
def test_a_loop_of_growing_amplitude_has_the_energy_of_its_largest_cycle(count):
    """A friction element of force 1 on a spring of stiffness 1."""
    amplitudes = [2.0, 3.0, 4.0, 5.0]
    u = np.concatenate([a * np.sin(2 * np.pi * np.arange(count) / count) for a in amplitudes] + [[0.0]])
    y, slider = np.zeros_like(u), 0.0
    for k, now in enumerate(u):
        slider = min(max(slider, now - 1), now + 1)
        y[k] = now - slider
    found = values_of(hf.Record(u, y, u_unit="mm", y_unit="kN", u_name="x", y_name="F"))
    # From the end of the third cycle, where F = 1 at x = 0, the largest one slides 5 - 0 up, 10 - 2 down and 5 - 2 up again.
    assert found["loop_area"].value == pytest.approx(5 + 8 + 3, rel=0.01)


@pytest.mark.parametrize("lift", [0.0, 20.0])
def test_a_charge_counted_from_the_start_of_a_record_has_its_zero_in_the_middle(lift):
    """The integrator of a tester starts at zero, where the capacitor is at its remanence; a loop measured about zero is left alone."""
    share = np.r_[np.linspace(0, 1, 500), np.linspace(1, -1, 1000)[1:], np.linspace(-1, 0, 500)[1:]]
    rises = np.gradient(share) > 0
    charge = 20 * np.tanh((5 * share - np.where(rises, 1, -1)) / 0.6)
    record = hf.Record(5 * share, charge + lift, u_unit="V", y_unit="uC/cm2", u_name="V", y_name="P")
    record = record.replace(y=record.y - lift - charge[0] if lift else record.y)
    found = values_of(record)
    assert found["coercive_input_rising"].value == pytest.approx(1.0, abs=0.01)
    assert found["coercive_input_falling"].value == pytest.approx(-1.0, abs=0.01)
    assert found["offset_input"].value == pytest.approx(0.0, abs=0.01)
    (notes,) = quantities(record).notes.values() if lift else ((),)
    assert bool(lift) == any("relative to the start" in note.text for note in notes)


def test_of_reversal_curves_the_outermost_has_coercivity_and_remanence():
    """The others cross zero where the relays that their reversal left switch back, which is no coercivity."""
    reversals = np.linspace(60, -120, 13)
    curves = []
    for k, low in enumerate(reversals):
        h = np.arange(low, 150.0, 2.0)
        y = 1 - np.clip((20 - low) / 100, 0, 1) * (1 - np.tanh((h - 30 - k) / 20))
        curves.append(hf.Record(h, y * 1e-3, u_unit="mT", y_unit="emu", name=str(k)))
    found = quantities(curves).rows
    assert [name for name, rows in found.items() if rows] == ["12"]
    assert {row.name for row in found["12"]} >= {"coercive_input", "remanence"}


def test_a_loop_that_was_cut_gives_what_its_whole_branch_shows_and_says_so():
    """A falling branch of 1.2 tanh((H + 40) / 50), and a part of the rising one."""
    h = np.concatenate([np.linspace(200, -200, 201), np.linspace(-198, -82, 59)])
    b = 1.2 * np.tanh((h + np.where(np.arange(h.size) < 201, 40.0, -40.0)) / 50)
    cut = quantities(hf.Record(u=h, y=b, u_unit="A/m", y_unit="T", name="cut"))
    values = {one.name: one.value for one in cut.rows["cut"]}
    assert values["HcJ"] == pytest.approx(40.0, abs=0.1)
    assert values["Br"] == pytest.approx(1.2 * np.tanh(0.8), abs=1e-3)
    assert "loop_area" not in values
    assert "whole cycle" in "\n".join(cut.lines())
    noise = np.random.default_rng(0).normal(0, 0.05, 201)
    line = quantities(
        hf.Record(np.append(h[:201], h[200::-1]), np.append(h[:201], h[200::-1]) + np.append(noise, noise[::-1]))
    )
    assert not any(line.rows.values())
    assert "noise" in "\n".join(line.lines())


def test_one_cycle_of_each_amplitude_gives_the_energy_of_the_largest():
    """A force between the ends of growing strokes: only one branch crosses the whole range, and the last cycle ends in the middle."""
    ends = [0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 0.0]
    u = np.interp(np.linspace(0, 7, 1401), np.arange(8), ends)
    slip, force = 0.0, []
    for x in u:
        slip = np.clip(slip, x - 0.5, x + 0.5)
        force.append(4 * x + 10 * (x - slip))
    found = values_of(hf.Record(u, np.array(force), u_unit="mm", y_unit="kN", u_name="Displacement", y_name="Force"))
    # Of a spring and a Coulomb element of 10 kN/mm that slips at 5 kN: 4 times 5 kN times 2.5 mm of slip, less the corner at the start.
    assert found["loop_area"].value == pytest.approx(4 * 5 * 2.5, rel=0.03)
    assert found["secant_stiffness"].value == pytest.approx(4 + 5 / 3, rel=1e-3)


def test_a_branch_that_begins_inside_the_loop_gives_no_width():
    """Soil that is wetted to the middle of its water and then dried crosses one half where that branch begins."""
    main = lambda u, half: 1 / (1 + (u / half) ** 6)
    dry, wet, again = np.linspace(0, 2.6, 200), np.linspace(2.6, 1.0, 200)[1:], np.linspace(1.0, 20, 800)[1:]
    inside = 0.6 * main(again, 1.5) / main(1.0, 1.5)
    back = np.linspace(20, 0, 900)[1:]
    scanning = np.maximum(main(wet, 0.5), np.interp(wet, [1.0, 2.6], [0.6, main(2.6, 1.5)]))
    u, y = np.concatenate([dry, wet, again, back]), np.concatenate([main(dry, 1.5), scanning, inside, main(back, 0.5)])
    found = values_of(hf.Record(u, y, u_unit="kPa", y_unit="", u_name="suction", y_name="saturation"))
    assert "coercive_input" not in found  # of the largest loop 0.5, and 0.4 where that branch counts


def test_samples_near_other_crossings_do_not_count_in_the_middle_one():
    x = np.linspace(-1, 1, 401)
    noise = np.random.default_rng(2).normal(0, 0.02, x.size)
    at, error = crossing(5 * x * (x - 0.6) * (x + 0.9) + noise, x, 0.02)
    assert abs(at) < 4 * error < 0.02


def test_a_jump_between_two_samples_lies_anywhere_between_them():
    """A comparator: the error of its threshold is that of a uniform distribution over one step of the input."""
    missed, errors = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        x = 0.08 * (np.arange(25) + rng.uniform())
        at, error = crossing(np.where(x > 1.0, 2.5, -2.5) + rng.normal(0, 0.02, x.size), x, 0.02)
        missed.append(at - 1.0)
        errors.append(error)
    np.testing.assert_allclose(np.mean(errors), np.sqrt(np.mean(np.square(missed))), rtol=0.2)


def test_cycles_that_each_go_further_are_measured_where_both_branches_are() -> None:
    """Indentation with partial unloading: what follows the depth reached before is first loading, and belongs to no loop."""
    u, y, reached = [0.0], [0.0], 0.0
    for top in (1.0, 2.0, 3.0, 4.0):
        rise, fall = np.linspace(u[-1], top, 400)[1:], np.linspace(top, 0.6 * top, 400)[1:]
        back = ((rise - u[-1]) / max(reached - u[-1], 1e-9)).clip(0, 1) ** 0.9
        u += [*rise, *fall]
        y += [*np.where(rise < reached, y[-1] + (reached**2 - y[-1]) * back, rise**2), *_unloaded(top, fall)]
        reached = top
    record = hf.Record(np.array(u), np.array(y))
    shape = loop_shape(record.u, record.y, closed_loops(record.u), cycles(record.u))
    assert shape is not None
    assert (shape.circulation, shape.crossing) == ("clockwise", False)
    low, high = _unloaded(3.0, 1.8), 9.0
    rising = low * 1.2 + (high - low) * 1.2 / 1.9
    falling = 9.0 * 1.35 / 2.1 * (1 - (0.15 / 1.35) ** 2.1)
    assert shape.area == pytest.approx(falling - rising, rel=0.01)


def _unloaded(top: float, depth: Any) -> Any:
    return top**2 * ((depth - 0.55 * top) / (0.45 * top)) ** 1.1


def test_small_reversals_on_the_branches_of_one_loop_are_not_its_cycles() -> None:
    """A valve that steps three forward and one back: its loop begins with the record, and the way back of a step is no loop."""
    steps = np.cumsum(np.tile([0.1, 0.1, 0.1, -0.1], 50))
    rise = np.array([0.0, *steps[steps <= 10.0]])
    u = np.concatenate([rise, rise[-1] - rise[1:]])
    y = [1.0]
    for value in u[1:]:
        y.append(min(max(y[-1], value - 1), value + 1))
    shape = loop_shape(u, np.array(y), closed_loops(u), cycles(u))
    assert shape is not None
    assert shape.circulation == "counter-clockwise"
    assert shape.area == pytest.approx(2 * (np.ptp(u) - 2), rel=0.02)


@pytest.mark.parametrize(
    "labels",
    [
        {"y_name": "Kerr rotation", "y_unit": "mdeg"},
        {"y_name": "Faraday angle", "y_unit": "mrad"},
        {"y_name": "Kerr signal", "y_unit": "V"},
        {"y_name": "XMCD", "y_unit": ""},
    ],
)
def test_light_that_a_magnetization_turns_has_coercivity_and_remanence_and_no_data_sheet(
    labels: dict[str, str],
) -> None:
    record = ellipse(u_name="Field", u_unit="Oe", **labels)
    measured = quantities(record)
    found = {one.name: one for one in next(iter(measured.rows.values()))}
    assert found["coercive_input"].label.startswith("coercivity")
    assert found["coercive_input"].value == pytest.approx(3 * np.sin(0.4), rel=1e-5)
    assert found["remanence_falling"].value == pytest.approx(2 * np.sin(0.4), rel=1e-5)
    assert not any("volume" in note.text for note in measured.notes)


@pytest.mark.parametrize("offset", [0.0, 2.3, -8.0])
def test_light_over_an_offset_has_the_coercivity_about_the_middle_of_its_range(offset: float) -> None:
    record = ellipse(u_name="Field", u_unit="Oe", y_name="Kerr signal", y_unit="V")
    measured = quantities(record.replace(y=record.y + offset))
    found = {one.name: one for one in next(iter(measured.rows.values()))}
    assert found["coercive_input"].value == pytest.approx(3 * np.sin(0.4), rel=1e-5)
    assert found["coercive_input_rising"].value == pytest.approx(3 * np.sin(0.4), rel=1e-5)
    assert found["remanence_falling"].value == pytest.approx(2 * np.sin(0.4), rel=1e-5)
    notes = next(iter(measured.notes.values()), ())
    assert bool(offset) == any(note.code is Code.PREPARED and "offset" in note.text for note in notes)


def test_the_data_sheet_of_a_magnet_has_what_its_instrument_states_beside_it(tmp_path):
    """A permeagraph writes both coercivities: of the polarization and of the induction."""
    field = np.linspace(0, 1500, 120)
    polarization = 1.248 / (1 + np.exp((field - 1432) / 6)) - 1.248 / (1 + np.exp((1500 - 1432) / 6)) * field / 1500
    lines = ["Br = 1,248 T", "HcB = 930,1 kA/m", "HcJ = 1432 kA/m", "(BH)max = 295,4 kJ/m³", "", "H [kA/m];B [T];J [T]"]
    rows = zip(-field, polarization - 4e-4 * np.pi * field, polarization, strict=True)
    lines += [";".join(f"{value:.4f}" for value in row).replace(".", ",") for row in rows]
    (tmp_path / "magnet.txt").write_text("\n".join(lines) + "\n", encoding="cp1252")
    found = values_of(hf.read(tmp_path / "magnet.txt"))
    stated = {name: row.stated for name, row in found.items() if row.stated is not None}
    assert stated == {
        "coercive_input": 930.1,
        "remanence": 1.248,
        "HcJ": 1432.0,
        "HcB": 930.1,
        "Br": 1.248,
        "energy_product": 295.4,
    }


def test_signs_before_the_results_of_a_tester_tell_its_branches(tmp_path):
    voltage = np.concatenate([np.linspace(10, -10, 101), np.linspace(-10, 10, 101)[1:]])
    rising = np.append(-1.0, np.diff(voltage)) > 0
    charge = 25 * np.tanh((voltage - np.where(rising, 3.0, -2.5)) / 1.5)
    head = "+Pr (uC/cm2): 23.2\n-Pr (uC/cm2): -24.1\n+Vc: 3.0\n-Vc: -2.5\n\nVoltage (V),Polarization (uC/cm2)\n"
    text = head + "".join(f"{u:.3f},{y:.5f}\n" for u, y in zip(voltage, charge, strict=True))
    (tmp_path / "loop.csv").write_text(text, encoding="utf-8")
    found = values_of(hf.read(tmp_path / "loop.csv"))
    stated = {name: row.stated for name, row in found.items() if row.stated is not None}
    assert stated == {
        "coercive_input_rising": 3.0,
        "coercive_input_falling": -2.5,
        "remanence_falling": 23.2,
        "remanence_rising": -24.1,
    }


def test_the_strain_of_a_ferroelectric_has_coercive_fields_and_no_loss() -> None:
    """A butterfly, y = (2 cos(x - 0.4))^2, is zero where the polarization is, and its lobes cancel."""
    phase = np.linspace(0, 4 * np.pi, 801)
    noise = np.random.default_rng(1).normal(0, 1e-4, phase.size)
    labels = {"u_unit": "kV/cm", "y_unit": "um", "u_name": "E", "y_name": "displacement"}
    measured = quantities(hf.Record(3 * np.cos(phase), 4 * np.cos(phase - 0.4) ** 2 + noise, **labels))
    found = {one.name: one for one in next(iter(measured.rows.values()))}
    for side, true in (("rising", 3 * np.sin(0.4)), ("falling", -3 * np.sin(0.4))):
        one = found[f"turning_input_{side}"]
        assert abs(one.value - true) < 3 * one.stderr < 0.1
    assert found["stroke"].value == pytest.approx(4.0, rel=1e-3)
    assert not {"loop_area", "coercive_input", "remanence"} & set(found)
    assert [note.code for note in next(iter(measured.notes.values()))] == [hf.outcome.Code.CROSSING]


def test_loops_that_grow_from_zero_in_one_record_have_the_values_of_the_largest() -> None:
    """A play of half width 1 in a field of amplitudes 3 and 5, each from zero on: its zero crossings and the area are known."""
    rise = np.linspace(0, 1, 126)
    cycle = np.concatenate([rise, 1 - rise[1:], -rise[1:], rise[1:] - 1])
    u = np.concatenate([3 * cycle, 5 * cycle[1:]])
    y, p = [], 0.0
    for value in u:
        p = max(value - 1, min(value + 1, p))
        y.append(p)
    labels = {"u_unit": "kV/cm", "y_unit": "uC/cm2", "u_name": "E", "y_name": "P"}
    found = values_of(hf.Record(u, np.array(y), **labels))
    assert found["coercive_input_rising"].value == pytest.approx(1.0, abs=1e-6)
    assert found["coercive_input_falling"].value == pytest.approx(-1.0, abs=1e-6)
    assert found["remanence"].value == pytest.approx(1.0, abs=1e-6)
    assert found["loop_area"].value == pytest.approx(1e3 * 2 * (2 * 5 - 2), rel=1e-3)  # 1 kV/cm uC/cm2 is 1e3 J/m3


def test_loops_of_a_smaller_amplitude_do_not_count() -> None:
    """A play of half width 1 at amplitudes of 4.6, many times, and of 5: the area of the largest is 4 (5 - 1)."""
    rise = np.linspace(0, 1, 101)
    cycle = np.concatenate([rise[1:], 1 - rise[1:], -rise[1:], rise[1:] - 1])
    u = np.concatenate([[0.0], *(amplitude * cycle for amplitude in (4.6, 4.6, 4.6, 4.6, 4.6, 5.0, 5.0, 4.6, 4.6))])
    y, p = [], 0.0
    for value in u:
        p = max(value - 1, min(value + 1, p))
        y.append(p)
    found = values_of(hf.Record(u, np.array(y), u_unit="V", y_unit="um", u_name="V", y_name="position"))
    assert found["loop_area"].value == pytest.approx(4 * (5 - 1), rel=1e-3)


def test_a_branch_that_ends_inside_the_loop_gives_its_width() -> None:
    """A desorption is not measured down to the first pressure of the adsorption."""
    adsorbed = lambda p, at: 0.5 * p / (0.02 + p) + 0.5 * (1 + np.tanh((p - at) / 0.03))
    up, down = np.linspace(0.01, 0.99, 99), np.linspace(0.98, 0.08, 91)
    y = np.concatenate([adsorbed(up, 0.8), adsorbed(down, 0.6)])
    found = values_of(
        hf.Record(np.append(up, down), y, u_unit="p/p0", y_unit="cm3/g", u_name="pressure", y_name="adsorbed")
    )
    assert found["coercive_input"].value == pytest.approx(0.1, rel=0.02)


def test_a_viscous_damper_has_its_coefficient_and_no_damping_ratio() -> None:
    """F = 2 v + 3 x at 1.25 Hz: 2 kN s/mm, and a ratio of 2 omega / (2 times 3) = 262 % that no oscillation has."""
    t = np.arange(0, 4, 0.002)
    omega = 2 * np.pi * 1.25
    labels = {"u_unit": "mm", "y_unit": "kN", "u_name": "x", "y_name": "F"}
    made = lambda viscous, t=t: hf.Record(
        5 * np.sin(omega * t), viscous * 5 * omega * np.cos(omega * t) + 15 * np.sin(omega * t), t, **labels
    )
    found = values_of(made(2.0))
    assert found["damping_coefficient"].value == pytest.approx(2.0, rel=2e-3)
    assert found["damping_coefficient"].unit == "kN s/mm"
    assert "equivalent_damping_percent" not in found
    assert found["secant_stiffness"].value == pytest.approx(3.0, rel=1e-2)
    weak = values_of(made(0.2))
    assert weak["equivalent_damping_percent"].value == pytest.approx(100 * 0.2 * omega / 6, rel=1e-2)
    assert "damping_coefficient" not in weak


def test_an_area_that_is_no_energy_is_no_loss() -> None:
    tire = values_of(ellipse(u_unit="deg", y_unit="N", u_name="slip angle", y_name="lateral force"))
    assert tire["loop_area"].unit == "N deg"  # per length: a force times an angle is none
    assert tire["loop_area"].value == pytest.approx(6 * np.pi * np.sin(0.4), rel=1e-4)
    hinge = values_of(ellipse(u_unit="deg", y_unit="N*m", u_name="angle", y_name="torque"))
    assert hinge["loop_area"].unit == "J"
    assert hinge["loop_area"].value == pytest.approx(6 * np.pi * np.sin(0.4) * np.pi / 180, rel=1e-4)
    assert hinge["loop_area"].label != tire["loop_area"].label
    unknown = values_of(ellipse(u_unit="", y_unit="", u_name="displacement", y_name="force"))
    assert unknown["loop_area"].label == hinge["loop_area"].label  # an energy in whatever units


def test_a_stress_over_a_strain_has_the_unit_of_the_stress() -> None:
    soil = values_of(ellipse(u_unit="%", y_unit="kPa", u_name="shear strain", y_name="shear stress", delay=-0.4))
    assert soil["secant_stiffness"].unit == "kPa"
    assert soil["secant_stiffness"].value == pytest.approx(100 * 4 * np.cos(0.4) / 6, rel=1e-3)


def test_the_temperatures_of_a_transition_over_decades_are_those_of_the_logarithm_of_the_resistance() -> None:
    """A resistance that falls by 10^3 about 68 degC on heating and about 60 degC on cooling."""
    heat, cool = np.linspace(30, 98, 201), np.linspace(98, 30, 201)[1:]
    log_r = lambda T, at: 4 - 1.5 * (1 + np.tanh((T - at) / 3))
    y = 10 ** np.concatenate([log_r(heat, 68), log_r(cool, 60)])
    record = hf.Record(np.append(heat, cool), y, u_unit="degC", y_unit="Ohm", u_name="T", y_name="R")
    found = values_of(record)
    assert found["coercive_input_rising"].value == pytest.approx(68, abs=0.1)
    assert found["coercive_input_falling"].value == pytest.approx(60, abs=0.1)
    assert measured_quantities(hf.Dataset((record,)))["coercive_input"] == pytest.approx(4, abs=0.1)


def test_a_unipolar_loop_of_a_capacitor_has_its_recoverable_energy_and_no_coercivity() -> None:
    """P = 2 E up to 10 kV/mm, and back by a parabola to the start: it returns the integral of E dP along the latter."""
    up, down = np.linspace(0, 10, 401), np.linspace(10, 0, 401)[1:]
    y = np.concatenate([2 * up, 20 * (1 - (1 - down / 10) ** 2)])
    labels = {"u_unit": "kV/mm", "y_unit": "uC/cm2", "u_name": "E", "y_name": "P"}
    found = values_of(hf.Record(np.append(up, down), y, **labels))
    returned = 1e6 * 1e-2 * 20 * 2 / 10 * (10**2 / 2 - 10**2 / 3)  # V/m times C/m2; dP = 20 * 2 (1 - E/10) dE / 10
    assert found["recoverable_energy"].value == pytest.approx(returned, rel=1e-3)
    put_in = 1e6 * 1e-2 * 10 * 20 / 2
    assert found["efficiency_percent"].value == pytest.approx(100 * returned / put_in, rel=1e-3)
    assert not {"coercive_input", "coercive_input_rising", "offset_input", "saturation"} & set(found)
    width = QUANTITIES["coercive_input"]
    bipolar = hf.Record(up - 5, up, **labels)
    one_sided, about_zero = (width.label_on(hf.Dataset((one,))) for one in (hf.Record(up, up, **labels), bipolar))
    assert one_sided == width.label != about_zero


def test_the_curve_of_first_loading_belongs_to_no_loop() -> None:
    """Two cycles from the demagnetized state: the piece before the first tip is not the end of the last branch."""
    u = 200 * np.sin(np.linspace(0, 4 * np.pi, 1601))
    y, p = [], 0.0
    for value in u:
        p = max(value - 40, min(value + 40, p))
        y.append(np.tanh(p / 60))
    found = values_of(hf.Record(u, np.array(y), u_unit="A/m", y_unit="T", u_name="H", y_name="J"))
    assert found["coercive_input_rising"].value == pytest.approx(40, abs=0.1)
    assert found["coercive_input"].stderr < 0.5


def test_charge_and_small_strains_in_their_units_give_energies() -> None:
    cell = values_of(ellipse(u_unit="mAh", y_unit="V", u_name="capacity", y_name="voltage"))
    assert cell["loop_area"].unit == "J"
    assert cell["loop_area"].value == pytest.approx(3.6 * 6 * np.pi * np.sin(0.4), rel=1e-4)
    steel = values_of(ellipse(u_unit="\u00b5\u03b5", y_unit="MPa", u_name="strain", y_name="stress", delay=-0.4))
    assert steel["loop_area"].unit == "J/m3"
    assert steel["loop_area"].value == pytest.approx(6 * np.pi * np.sin(0.4), rel=1e-4)


def test_the_range_of_a_force_is_that_of_all_cycles() -> None:
    """A joint that has lost half of its strength when it reaches its largest displacement."""
    cycle = np.sin(np.linspace(0, 2 * np.pi, 201))[1:]
    u, force, f = np.concatenate([[0.0], 5 * cycle, 10 * cycle, 10 * cycle]), [0.0], 0.0
    for k in range(1, u.size):
        limit = 8.0 if k <= 200 else 4.0
        f = max(-limit, min(limit, f + 10 * (u[k] - u[k - 1])))
        force.append(f)
    found = values_of(hf.Record(u, np.array(force), u_unit="mm", y_unit="kN", u_name="Displacement", y_name="Force"))
    assert found["stroke"].value == pytest.approx(16.0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_small_loop_on_a_steep_branch_does_not_move_where_the_branch_crosses(mirrored: bool) -> None:
    """A scanning loop of 4 % of the input passes the middle of the output on its way to and fro, at 1.3 instead of 2."""
    rises, falls = (lambda u, at=at: 1 / (1 + np.exp((at - u) / 0.2)) for at in (2.0, 1.0))
    before, after = np.linspace(0, 2.4, 60), np.append(np.linspace(2.4, 5, 60), np.linspace(5, 50, 20)[1:])
    back = np.linspace(2.4, 0.6, 40)
    scan = 0.3 + (rises(2.4) - 0.3) * (back - 0.6) / 1.8
    down = after[::-1].tolist() + np.linspace(2.4, 0, 60)[1:].tolist()
    u = np.concatenate([before, back[1:], back[::-1][1:], after[1:], down[1:]])
    y = np.concatenate([rises(before), scan[1:], scan[::-1][1:], rises(after[1:]), falls(np.array(down[1:]))])
    found = values_of(hf.Record(-u if mirrored else u, -y if mirrored else y))
    sides = ("falling", "rising") if mirrored else ("rising", "falling")
    for side, at in zip(sides, (2.0, 1.0), strict=True):
        assert found[f"coercive_input_{side}"].value == pytest.approx(-at if mirrored else at, abs=0.02)
    assert found["coercive_input"].value == pytest.approx(0.5, abs=0.02)


def _piezo(cycles: float, seed: int = 0) -> hf.Record:
    """Plays from rest at 0 V, 100 samples a branch: an output of 16 um whose loop is 2 um high."""
    u = np.interp(
        np.arange(0, 200 * cycles + 1) / 100, np.arange(2 * cycles + 1), np.arange(2 * cycles + 1) % 2 * 150.0
    )
    y = 0.06 * u
    for limit, weight in ((4.0, 0.012), (9.0, 0.01), (15.0, 0.009), (22.0, 0.007), (30.0, 0.006), (40.0, 0.005)):
        p = 0.0
        for k, value in enumerate(u):
            p = max(value - limit, min(value + limit, p))
            y[k] += weight * p
    y += 0.01 * np.random.default_rng(seed).standard_normal(u.size)
    return hf.Record(u, y, u_unit="V", y_unit="um")


def test_the_first_rise_from_rest_does_not_count_beside_later_ones() -> None:
    """The first branch begins half the height of the loop below the others, and meets them above the middle of the output."""
    steady, two, first = values_of(_piezo(5)), values_of(_piezo(2)), values_of(_piezo(1))
    for name in ("coercive_input", "remanence", "loop_area"):
        assert two[name].value == pytest.approx(steady[name].value, abs=4 * two[name].stderr)
        assert two[name].stderr < 0.02 * two[name].value
    assert first["loop_area"].value > 1.04 * steady["loop_area"].value
    assert all("first cycle" in one.label for one in first.values() if one.name != "stroke")
    assert not any("first cycle" in one.label for one in two.values())


@pytest.mark.parametrize("counts", [{1.0: 2, 5.0: 4, 20.0: 10, 50.0: 8}, {20.0: 5}])
def test_of_several_rates_in_a_record_the_cycles_of_one_count(counts: dict[float, int]) -> None:
    """An output that follows the input by 6 ms begins every branch inside the loop."""
    pieces = [np.arange(round(2000 * count / f)) * f / 2000 for f, count in counts.items()]
    delay = np.repeat([2 * np.pi * f * 0.006 for f in counts], [piece.size for piece in pieces])
    phase = 2 * np.pi * np.concatenate(pieces)
    u, y = 75 - 75 * np.cos(phase), 8 - 8 * np.cos(phase - delay)
    y += 0.01 * np.random.default_rng(0).standard_normal(u.size)
    found = values_of(hf.Record(u, y, t=np.arange(u.size) / 2000, u_unit="V", y_unit="um"))
    assert found["coercive_input"].value == pytest.approx(75 * np.sin(2 * np.pi * 20 * 0.006), rel=0.01)
    assert found["remanence"].value == pytest.approx(8 * np.sin(2 * np.pi * 20 * 0.006), rel=0.01)
    assert ("20 Hz" in found["coercive_input"].label) == (len(counts) > 1)
    slow = values_of(hf.Record(u, y, t=np.arange(u.size) * 1.0, u_unit="V", y_unit="um"))
    assert ("cycles of 100 s" in slow["coercive_input"].label) == (len(counts) > 1)


@pytest.mark.parametrize("zero", [0.0, 4.0])
def test_an_imprint_is_found_whatever_the_zero_of_the_charge(zero: float) -> None:
    """A loop that is shifted by 0.15 V; with its polarization 4 uC/cm2 too high, its crossings of zero are as far apart on both sides."""
    v = 5 * np.cos(np.linspace(0, 2 * np.pi, 401))
    p = 25 * np.tanh((v - 0.15 - np.where(np.arange(v.size) > 200, 2.0, -2.0)) / 0.9) + v + zero
    p += 0.1 * np.random.default_rng(0).standard_normal(v.size)
    found = values_of(hf.Record(v, p, u_unit="V", y_unit="uC/cm2", u_name="voltage", y_name="polarization"))
    one = found["offset_about_middle" if zero else "offset_input"]
    assert one.value == pytest.approx(0.15, abs=4 * one.stderr)
    assert one.stderr < 0.02
    assert ("offset_about_middle" in found) == (zero > 0)


@pytest.mark.parametrize(("width", "name", "truth"), [(5, "coercive_input", 20), (30, "remanence", np.tanh(20 / 30))])
@pytest.mark.parametrize(("of_input", "of_output"), [(0.5, 0.001), (2.0, 0.02), (0.05, 0.02)])
def test_noise_of_the_input_enters_the_errors_of_one_steep_loop(width, name, truth, of_input, of_output):
    """A field read with noise, in a loop without repeats, whose scatter would show it."""
    rng, ratios = np.random.default_rng(0), []
    for _ in range(25):
        phase = np.linspace(0, 2 * np.pi, 500) + 0.01 * rng.random()
        field = 100 * np.cos(phase)
        moment = np.tanh((field + np.where(np.sin(phase) < 0, -20, 20)) / width)
        field, moment = (v + size * rng.standard_normal(500) for v, size in ((field, of_input), (moment, of_output)))
        loop = hf.Record(field, moment, u_unit="Oe", y_unit="emu", u_name="Field", y_name="Moment", name="loop")
        (found,) = (row for row in quantities(loop).rows["loop"] if row.name == name)
        ratios.append((found.value - truth) / found.stderr)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.4
