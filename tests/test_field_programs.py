"""Exports for field programs: every written file is read again by code of its own and simulated by the equations of its program."""

import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hystfit as hf
from hystfit.control.field_programs import export_field_programs, winding
from hystfit.control.magnetic_material import parts_of
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.linear import Linear
from hystfit.models.rate import Viscous
from hystfit.params.units import MU0

TURN = 300.0
SHAPE = {"Ms": 1.5, "a": 40.0, "coupling": 0.6, "k": 45.0, "c": 0.25, "slope": MU0}


def fitted(kind=hf.JilesAtherton, **changes):
    """What an export reads of a fit: its model, the units of its data and the range of its input."""
    model = kind(**{**SHAPE, **changes})
    return SimpleNamespace(model=model, data=[SimpleNamespace(u_unit="A/m", y_unit="T")], input_range=(-TURN, TURN))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("programs")
    result = fitted()
    return result, export_field_programs(result, folder, name="ferrite")


def loop_of(result):
    """Steady loop of a fit by the library: fields, rising and falling branch."""
    h = np.linspace(-TURN, TURN, 201)
    u = np.concatenate([h, h[-2:0:-1]])
    y = np.asarray(hf.simulate(result.model, np.concatenate([u, u, u, h[:1]]))[0])[-u.size - 1 :]
    return h, y[:201], y[200:][::-1]


def law_of(alpha, a, saturation, pinned, reversible):
    """dM/dH = chi / (1 - alpha chi) with chi = pinned (Man - M)+ + reversible dMan/dHe, as programs write it, for a sign of dH."""

    def slope(sign):
        def of(h, m):
            x = (h + alpha * m[0]) / a
            man = saturation * (1 / np.tanh(x) - 1 / x if abs(x) > 1e-4 else x / 3)
            bend = saturation / a * (1 / x**2 - 1 / np.sinh(x) ** 2 if abs(x) > 1e-2 else 1 / 3 - x**2 / 15)
            chi = pinned * max(sign * (man - m[0]), 0.0) + reversible * bend
            return [chi / (1 - alpha * chi)]

        return of

    return slope


def simulated(slope):
    """Steady loop of a law: two cycles from the demagnetized state."""
    m, turns, branches = 0.0, [0, TURN, -TURN, TURN, -TURN], []
    for k in range(4):
        at = np.linspace(turns[k], turns[k + 1], 201)
        found = solve_ivp(
            slope(np.sign(turns[k + 1] - turns[k])), (turns[k], turns[k + 1]), [m], t_eval=at, rtol=1e-8, atol=1e-2
        )
        branches.append(MU0 * (at + found.y[0]))
        m = found.y[0][-1]
    return branches[2], branches[3][::-1]


def assert_same(found, expected):
    span = np.ptp(expected[1])
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-3 * span)


def test_parameters_for_comsol_and_flux_give_the_loop_again(written):
    result, files = written
    _, rising, falling = loop_of(result)
    words = [line.split() for line in Path(files["COMSOL"]).read_text().splitlines()]
    comsol = {row[0]: float(row[1].partition("[")[0]) for row in words}
    assert_same(
        simulated(law_of(comsol["alpha_JA"], comsol["a_JA"], comsol["Ms"], 1 / comsol["kp_JA"], comsol["cr_JA"])),
        (rising, falling),
    )
    assert comsol["alpha_JA"] == pytest.approx(3 * 40.0 * 0.6 / (1.5 / MU0), rel=1e-6)
    rows = [line.split(",") for line in Path(files["Flux"]).read_text().splitlines() if line[0] != "#"]
    flux = {row[0]: float(row[1]) for row in rows[1:]}
    assert flux == pytest.approx(
        {
            "Ms": comsol["Ms"],
            "a": comsol["a_JA"],
            "k": comsol["kp_JA"],
            "alpha": comsol["alpha_JA"],
            "c": comsol["cr_JA"],
        }
    )


def test_branches_for_ansys_jmag_and_modelica_are_those_of_the_loop(written):
    result, files = written
    h, rising, falling = loop_of(result)
    ansys = np.loadtxt(files["Ansys"], skiprows=1)
    np.testing.assert_allclose(np.interp(h, *ansys.T), falling, atol=1e-3)
    jmag = np.loadtxt(files["JMAG"], delimiter=",", skiprows=1)
    assert_same((np.interp(h, jmag[:, 0], jmag[:, 1]), np.interp(h, jmag[:, 0], jmag[:, 2])), (rising, falling))
    text = Path(files["Modelica"]).read_text()
    for name, expected in (("tabris", rising), ("tabfal", falling)):
        body = re.search(name + r"=\{(.*)\}[,)]", text)[1]
        table = np.array([[float(cell) for cell in pair.split(",")] for pair in re.findall(r"\{([^{}]*)\}", body)])
        assert (np.diff(table, axis=0) > 0).all()
        np.testing.assert_allclose(np.interp(h, *table.T), expected, atol=1e-3 * np.ptp(falling))


def test_chan_has_the_coercivity_and_the_remanence_of_the_loop(written):
    """Chan et al. (1991): B = Bs (H -+ Hc) / (|H -+ Hc| + Hc (Bs/Br - 1)) + mu0 H."""
    result, files = written
    h, rising, falling = loop_of(result)
    values = {
        key: float(value) for key, value in re.findall(r"(Hc|Br|Bs)=([-\d.e+]+)", Path(files["LTspice"]).read_text())
    }
    falls = lambda x: (
        values["Bs"] * (x + values["Hc"]) / (abs(x + values["Hc"]) + values["Hc"] * (values["Bs"] / values["Br"] - 1))
        + MU0 * x
    )
    assert falls(0.0) == pytest.approx(np.interp(0.0, h, falling), rel=1e-3)
    assert abs(falls(np.interp(0.0, falling, h))) < 1e-3 * values["Br"]
    assert values["Br"] < values["Bs"] < 1.02 * rising.max()


def test_spice_has_the_law_of_1984_without_alpha(tmp_path, written):
    assert "coupling=0" in written[1]["SPICE"]
    result = fitted(coupling=0.0)
    line = Path(export_field_programs(result, tmp_path)["SPICE"]).read_text()
    core = {key: float(value) for key, value in re.findall(r"\b(MS|A|K|C)=([-\d.e+]+)", line)}
    slope = law_of(0.0, core["A"], core["MS"], 1 / (core["K"] * (1 + core["C"])), core["C"] / (1 + core["C"]))
    assert_same(simulated(slope), loop_of(result)[1:])


FUNCTIONS = {"sqrt": math.sqrt, "tanh": math.tanh, "exp": math.exp, "max": max, "sgn": np.sign}


def fields_of(netlist, voltage, times, **given):
    """Field over time of a winding at a voltage, by an ODE solver on the sources of its netlist."""
    sources, moved = {}, {}
    for line in netlist.splitlines():
        if line[0] == "B" and (source := re.fullmatch(r"B\w+ (\w+) (\w+) [VI]=(.*)", line)) and source[2] != "n":
            filled = re.sub(r"\{(\w+)\}", lambda name: repr(given[name[1]]), source[3])
            code = compile(re.sub(r"V\(([\w,]+)\)", r"v('\1')", filled), "source", "eval")
            (moved if source[1] == "0" else sources)[source[2 if source[1] == "0" else 1]] = code
    assert set(moved) == {"x", "m"}
    assert all(f"C{node} {node} 0 1" in netlist for node in moved)

    def at(t, state, *wanted):
        known = {"p,n": voltage(t), "q,n": voltage(t), "x": state[0], "m": state[1]}

        def v(node):
            if node not in known:
                known[node] = eval(sources[node], {"v": v, **FUNCTIONS})
            return known[node]

        return (
            [eval(moved[node], {"v": v, **FUNCTIONS}) for node in moved] if not wanted else [v(node) for node in wanted]
        )

    steps = solve_ivp(at, (0.0, times[-1]), [0.0, 0.0], t_eval=times, rtol=1e-6, atol=1e-7)
    return np.array([at(t, state, "h", "b") for t, state in zip(times, steps.y.T, strict=True)]).T


FREQUENCY = 50.0
LOSSES = {"eddy": 0.05, "excess": 0.6, "e": 0.1}
WINDINGS = {
    "every term, driven by the field": hf.Sum(
        JilesAthertonDynamic(**SHAPE, **LOSSES, q=[1.2], p=[0.7], r=[4.0]), Linear(k=1e-3)
    ),
    "tanh, driven by the flux density": hf.Sum(
        JilesAthertonField(**{**SHAPE, "slope": 5 * MU0}, curve="tanh"), Viscous(c=LOSSES["eddy"]), Linear(k=80.0)
    ),
}


@pytest.mark.parametrize("label", WINDINGS)
def test_a_winding_for_spice_has_the_field_of_every_term_of_the_law(label):
    """Beside the library: the flux density over the field of the winding, or the field over the flux density.

    The voltage is that of the core, before which an inductor has that of the air.
    """
    model, peak, w = WINDINGS[label], 1.1, 2 * np.pi * FREQUENCY
    parts, core = parts_of(model), {"turns": 100.0, "area": 1e-4}
    t, scale = np.arange(1, 2001) / 1000 / FREQUENCY, peak * w * core["turns"] * core["area"]
    netlist = winding(parts.law(1.0, 1.0))
    h, b = fields_of(netlist, lambda time: scale * np.cos(w * time), t, **core)
    air = re.search(r"Lair p q \{(.*)\}", netlist)
    linked = eval(air[1], {"length": 0.1, **core}) * h * 0.1 / core["turns"] if air else 0.0
    np.testing.assert_allclose(core["turns"] * core["area"] * (b - peak * np.sin(w * t)), linked, atol=2e-6)
    given, expected = (b, h) if parts.by_flux else (h, b)
    found = np.asarray(hf.simulate(model, np.append(0.0, given), np.diff(t, prepend=0.0, append=2 * t[-1] - t[-2]))[0])
    np.testing.assert_allclose(found[1001:], expected[1000:], atol=1e-3 * np.ptp(expected))


def test_programs_that_read_loops_get_that_of_a_slow_field(tmp_path, written):
    files = export_field_programs(fitted(JilesAthertonDynamic, **LOSSES), tmp_path)
    assert Path(files["Modelica"]).read_text() == Path(written[1]["Modelica"]).read_text()
    assert all(f"{value}*V(rate)" in Path(files["SPICE subcircuit"]).read_text() for value in ("0.05", "0.6"))
    with pytest.raises(hf.HystfitError, match="A/m,T"):
        export_field_programs(fitted(JilesAthertonDynamic, **LOSSES, slope=0.0), tmp_path)


def test_a_line_that_no_file_can_show_is_left_out_and_any_other_refused(tmp_path, written):
    """0.04 and 4 % of the range of the flux density at the largest field."""
    none, small, large = (hf.Sum(fitted().model, Linear(k=share / TURN)) for share in (0.0, 1e-3, 1e-1))
    of = lambda model: SimpleNamespace(**{**vars(written[0]), "model": model})
    files = export_field_programs(of(small), tmp_path / "small")
    numbers = lambda path: [line.split(",")[1] for line in Path(path).read_text().splitlines()[3:]]
    assert numbers(files["Flux"]) == numbers(written[1]["Flux"])
    assert_same(loop_of(of(small))[1:], loop_of(of(none))[1:])
    refused = export_field_programs(of(large), tmp_path / "large")
    assert all("line" in refused[program] for program in ("COMSOL", "Flux", "SPICE"))
    h, rising, falling = loop_of(of(large))
    jmag = np.loadtxt(refused["JMAG"], delimiter=",", skiprows=1)
    assert_same((np.interp(h, jmag[:, 0], jmag[:, 1]), np.interp(h, jmag[:, 0], jmag[:, 2])), (rising, falling))
    assert parts_of(large).law(1.0, 1.0) == parts_of(fitted(slope=MU0 + 1e-1 / TURN).model).law(1.0, 1.0)
    falls = hf.Sum(JilesAthertonDynamic(**SHAPE, **LOSSES), Linear(k=-1e-1 / TURN))
    assert "refit" in export_field_programs(of(falls), tmp_path / "falls")["SPICE subcircuit"]


def test_branches_of_a_magnet_behind_a_gap_are_those_of_its_model(tmp_path):
    model = hf.Sum(JilesAthertonField(**SHAPE), Linear(k=80.0))
    b = 1.1 * np.sin(np.linspace(0, 6 * np.pi, 1201))
    h = np.asarray(hf.simulate(model, b)[0])
    record = SimpleNamespace(u=b, y=h, u_unit="T", y_unit="A/m", used=np.ones(b.size, bool))
    files = export_field_programs(SimpleNamespace(model=model, data=[record], input_range=(-1.1, 1.1)), tmp_path)
    jmag = np.loadtxt(files["JMAG"], delimiter=",", skiprows=1)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(b)))) + 1
    for one, column in ((slice(turns[-3], turns[-2] + 1), 1), (slice(turns[-2], turns[-1] + 1), 2)):
        np.testing.assert_allclose(np.interp(h[one], jmag[:, 0], jmag[:, column]), b[one], atol=1e-3 * np.ptp(b))


def test_a_magnetization_over_the_field_gives_the_flux_density(tmp_path):
    """Of any model: B = mu0 (H + M)."""
    plays = hf.PrandtlIshlinskii(w=[[800.0, 400.0, 200.0]], r=[0.0, 0.1, 0.2], low=-TURN, high=TURN)
    data = [SimpleNamespace(u_unit="A/m", y_unit="A/m")]
    files = export_field_programs(SimpleNamespace(model=plays, data=data, input_range=(-TURN, TURN)), tmp_path)
    h, rising = np.loadtxt(files["JMAG"], delimiter=",", skiprows=1)[:, :2].T
    expected = MU0 * (h + np.asarray(hf.simulate(plays, np.concatenate([h, h[::-1], h]))[0])[-h.size :])
    np.testing.assert_allclose(rising, expected, atol=1e-6 * np.ptp(expected))


def test_programs_without_a_term_of_the_model_get_no_file(tmp_path):
    files = export_field_programs(fitted(q=[1.0]), tmp_path)
    assert all("q" in files[program] for program in ("COMSOL", "Flux", "SPICE"))
    assert all(Path(files[program]).exists() for program in ("Ansys", "JMAG", "Modelica", "LTspice"))
    with pytest.raises(hf.HystfitError, match="name"):
        export_field_programs(fitted(), tmp_path, name="a b")
