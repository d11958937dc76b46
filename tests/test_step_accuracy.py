"""Order and error of every model's step beside an adaptive solver: the table in docs/guide/accuracy.md.

python -m tests.test_step_accuracy prints the table.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hystfit as hf
from hystfit.cli import run
from hystfit.models import simulate
from hystfit.outcome import Code
from hystfit.sampling.sample import notes_of_fit

from .conftest import ROOT

PAGE = ROOT / "docs" / "guide" / "accuracy.md"
CORNERS = (0.0, 0.9, -0.7, 0.5)  # of the input, reached at equal times in DURATION
DURATION = 3.0
COARSE, FINE = 25, 100  # samples from one corner to the next

Law = Callable[[float, np.ndarray], Any]
Truth = Callable[[np.ndarray], np.ndarray]  # times of samples to outputs


def solved(laws: list[tuple[float, float, Law]], state: Any, t: np.ndarray) -> np.ndarray:
    """States at times t, shape (T, states), by DOP853 within each interval; the law is smooth between sign changes of states."""
    state, rows = np.asarray(state, dtype=float), {}
    for begin, end, law in laws:
        at = begin
        while at < end:
            # A sign change ends a part of the solution, so that the solver never steps across a kink.
            zeros = [lambda x, s, k=k: s[k] for k in range(state.size)]
            for zero in zeros:
                zero.terminal = True  # type: ignore[attr-defined]
            part = solve_ivp(law, (at, end), state, "DOP853", dense_output=True, events=zeros, rtol=1e-13, atol=1e-15)
            for k in np.flatnonzero((t >= at) & (t <= part.t[-1])):
                rows[k] = part.sol(t[k])
            at, state = part.t[-1], part.y[:, -1]
            if at < end:
                nudge = min(1e-15, end - at)
                state, at = state + nudge * np.asarray(law(at, state)), at + nudge
    return np.array([rows[k] for k in range(t.size)])


def zigzag(t: Any) -> Any:
    """Input between the corners."""
    return np.interp(t, np.linspace(0, DURATION, len(CORNERS)), CORNERS)


def sine(t: Any) -> Any:
    """A smooth input."""
    return np.sin(2.0 * np.asarray(t) + 0.3)


def along_branches(slope: Callable[[float, float, float], float], first: float, read: Callable) -> Truth:
    """Output of a rate-independent law dh/du = slope(u, h, direction)."""

    def truth(t: np.ndarray) -> np.ndarray:
        laws = []
        for k, (a, b) in enumerate(pairwise(CORNERS)):
            rate = (b - a) / (DURATION / (len(CORNERS) - 1))
            law = lambda x, s, rate=rate: [rate * slope(float(zigzag(x)), s[0], math.copysign(1.0, rate))]
            laws.append((float(k), k + 1.0, law))
        return read(zigzag(t), solved(laws, [first], t)[:, 0])

    return truth


def in_time(law: Callable[[Any], Law], state: Any, read: Callable, force: Callable = sine) -> Truth:
    """Output of a law that is driven by a function of time."""

    def truth(t: np.ndarray) -> np.ndarray:
        corners = np.linspace(0, DURATION, len(CORNERS)) if force is zigzag else (0.0, DURATION)
        return read(force(t), solved([(a, b, law(force)) for a, b in pairwise(corners)], state, t))

    return truth


# -- laws, from the docstrings of the models -------------------------------------------------------------------------------

BW = dict(c=1.3, mu=0.6, tau=2.0, rho=0.4)
ODD = dict(n=2.5, skew=0.3)


def bouc_wen(n: float = 1.0, skew: float = 0.0) -> Truth:
    m, tau, delta = BW["mu"] * BW["c"], BW["tau"], BW["rho"] * BW["tau"]
    high, a = m / (tau + delta), skew * (tau + delta)

    def slope(u: float, h: float, s: float) -> float:
        sign = float(np.sign(h))
        return m - (s * tau * sign + delta + a * sign) * abs(h) * (abs(h) / high) ** (n - 1)

    return along_branches(slope, 0.0, lambda u, h: BW["c"] * u - h)


FORCE = dict(kappa_x=0.4, kappa_w=1.2, rho=3.0, sigma=0.8, n=1.5)


def bouc_wen_force() -> Truth:
    p = FORCE
    slope = lambda u, w, s: p["rho"] * (1 - (p["sigma"] * float(np.sign(w * s)) + 1 - p["sigma"]) * abs(w) ** p["n"])
    return along_branches(slope, 0.0, lambda u, w: p["kappa_x"] * u + p["kappa_w"] * w)


F, G, ALPHA, W0 = (0.1, 1.0, 0.2, -0.3), (0.5, 0.2, -0.2), 1.7, 0.3


def duhem() -> Truth:
    value = np.polynomial.polynomial.polyval
    return along_branches(lambda v, w, s: s * ALPHA * (float(value(v, F)) - w) + float(value(v, G)), W0, lambda u, w: w)


def duhem_model(scheme: Any) -> hf.Duhem:
    return hf.Duhem.from_powers(ALPHA, F, G, -1.0, 1.0, w0=W0, scheme=scheme)


MAGNET = dict(Ms=1.3, a=0.15, coupling=0.5, k=0.2, c=0.3)


def jiles_atherton() -> Truth:
    """dM/dH from its parts, with alpha: the form of the literature, in H instead of the effective field."""
    p, field = MAGNET, 3 * MAGNET["a"] * MAGNET["coupling"]  # alpha Ms
    curve = lambda x: 1 / math.tanh(x) - 1 / x if abs(x) > 1e-4 else x / 3
    bend = lambda x: 1 / x**2 - 1 / math.sinh(x) ** 2 if abs(x) > 1e-2 else 1 / 3 - x**2 / 15

    def law(s: float, rate: float) -> Law:
        def slopes(t: float, state: np.ndarray) -> list[float]:
            total, irreversible = state[:2]
            x = (float(zigzag(t)) + field * total) / p["a"]
            behind = max(s * (curve(x) - irreversible), 0.0) / p["k"]
            chi = p["c"] * bend(x) / p["a"] + (1 - p["c"]) * behind
            slope = chi / (1 - field * chi)
            # The third state changes its sign where the anhysteretic curve passes Mirr, so that the solver meets that kink.
            lag = bend(x) / p["a"] * (1 + field * slope) - behind * (1 + field * slope)
            return [rate * slope, rate * behind * (1 + field * slope), rate * lag]

        return slopes

    def truth(t: np.ndarray) -> np.ndarray:
        laws = []
        for k, (a, b) in enumerate(pairwise(CORNERS)):
            rate = (b - a) / (DURATION / (len(CORNERS) - 1))
            laws.append((float(k), k + 1.0, law(math.copysign(1.0, rate), rate)))
        return p["Ms"] * solved(laws, np.zeros(3), t)[:, 0]

    return truth


SPRING = dict(m=0.5, c=0.2, K=3.0, a=0.3, r_load=1.3, r_unl=0.4, n=1.0, Z=0.9)


def spring() -> Truth:
    p = SPRING
    k, kz = p["a"] * p["K"], (1 - p["a"]) * p["K"]
    b1, b2 = (0.5 * kz * (p["r_load"] + sign * p["r_unl"]) / p["Z"] for sign in (1, -1))

    def law(force: Callable) -> Law:
        return lambda t, s: [
            s[1],
            (float(force(t)) - p["c"] * s[1] - k * s[0] - s[2]) / p["m"],
            kz * s[1] - (b1 * abs(s[1]) * np.sign(s[2]) + b2 * s[1]) * abs(s[2]),
        ]

    return in_time(law, np.zeros(3), lambda u, s: s[:, 0], zigzag)


def resonance(force: Callable) -> Truth:
    law = lambda force: lambda t, s: [s[1], 36.0 * (float(force(t)) - s[0]) - 2 * 0.2 * 6.0 * s[1]]
    return in_time(law, [float(force(0.0)), 0.0], lambda u, s: s[:, 0], force)


TAUS, PARTS = np.array([0.3, 1.5]), np.array([0.2, 0.1])
REST = np.full(2, float(sine(0.0)))
FOLLOW = lambda force: lambda t, s: (float(force(t)) - s) / TAUS


def log_creep() -> Truth:
    gamma = lambda x: 0.05 + 0.03 * x
    law = lambda force: lambda t, s: (gamma(force(t)) * PARTS * float(force(t)) - s) / TAUS
    first = gamma(sine(0.0)) * PARTS * sine(0.0)
    return in_time(law, first, lambda u, s: (1 - 0.8 * gamma(u)) * u + s.sum(axis=1))


def lag() -> Truth:
    law = lambda force: lambda t, s: [(float(force(t)) - s[0]) / 0.1, (s[0] - s[1]) / 0.1]
    return in_time(law, REST, lambda u, s: s[:, 1])


# -- the table -------------------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Case:
    """A row: a step, its truth, its order, or None where it is exact up to `rounding`."""

    model: Any
    truth: Truth
    order: float | None
    force: Callable[[Any], Any] = zigzag
    rounding: float = 1e-12
    slack: float = 0.25


CASES = {
    "`bouc-wen`, semi-implicit": Case(hf.BoucWen(**BW), bouc_wen(), 2),
    "`bouc-wen:scheme=exact`": Case(hf.BoucWen(**BW, scheme="exact"), bouc_wen(), None),
    "`bouc-wen-asymmetric`, semi-implicit": Case(hf.AsymmetricBoucWen(**BW, **ODD), bouc_wen(**ODD), 2),
    "`bouc-wen-asymmetric:scheme=exact`": Case(
        hf.AsymmetricBoucWen(**BW, **ODD, scheme="exact"), bouc_wen(**ODD), None, rounding=1e-7
    ),
    "`bouc-wen-force`": Case(hf.BoucWenForce(**FORCE), bouc_wen_force(), 2),
    "`duhem`, midpoint": Case(duhem_model("midpoint"), duhem(), 2),
    "`duhem:scheme=explicit`": Case(duhem_model("explicit"), duhem(), 1),
    "`duhem:scheme=exact`": Case(duhem_model("exact"), duhem(), None),
    "`jiles-atherton`": Case(hf.JilesAtherton(**MAGNET), jiles_atherton(), 2),
    "`oscillator:between=linear`, 1 substep": Case(
        hf.BoucWenOscillator(**SPRING, between="linear", substeps=1), spring(), 2, slack=0.5
    ),
    "`oscillator:between=linear`, 4 substeps": Case(
        hf.BoucWenOscillator(**SPRING, between="linear"), spring(), 2, slack=0.5
    ),
    "`second-order`, input linear between samples": Case(
        hf.SecondOrder(omega=6.0, zeta=0.2), resonance(zigzag), None, rounding=1e-11
    ),
    "`second-order`, smooth input": Case(hf.SecondOrder(omega=6.0, zeta=0.2), resonance(sine), 2, sine),
    "`lag`, smooth input": Case(hf.Lag(tau=0.2, rest="first"), lag(), 1, sine),
    "`relaxation`, smooth input": Case(
        hf.Relaxation(a=PARTS, tau=TAUS),
        in_time(FOLLOW, REST, lambda u, s: u - (PARTS * (u[:, None] - s)).sum(axis=1)),
        1,
        sine,
    ),
    "`creep`, smooth input": Case(
        hf.LinearCreep(a=PARTS, tau=TAUS, rest="first"), in_time(FOLLOW, REST, lambda u, s: s @ PARTS), 1, sine
    ),
    "`log-creep`, smooth input": Case(
        hf.LogCreep(gamma=(0.05, 0.03), tau=TAUS, weights=PARTS, base=0.8), log_creep(), 1, sine
    ),
}  # fmt: skip


def error(case: Case, steps: int) -> float:
    """Largest error over the samples, in parts of the output's range; all records are as long as the finest, so compiled once."""
    branches = len(CORNERS) - 1
    t = np.linspace(0.0, DURATION, branches * steps + 1)
    rest = branches * FINE + 1 - t.size
    u, dt = np.pad(case.force(t), (0, rest), mode="edge"), np.pad(np.diff(t, prepend=0.0), (0, rest))
    y = np.asarray(simulate(case.model, jnp.asarray(u), jnp.asarray(dt))[0])[: t.size]
    exact = case.truth(t)
    return float(np.max(np.abs(y - exact)) / np.ptp(exact))


def order_of(coarse: float, fine: float) -> float:
    """Observed order."""
    return math.log(coarse / fine) / math.log(FINE / COARSE)


def row(name: str) -> str:
    """A row of the table."""
    coarse, fine = error(CASES[name], COARSE), error(CASES[name], FINE)
    if CASES[name].order is None:
        shown = [f"below {max(1e-12, 10.0 ** math.ceil(math.log10(e))):.0e}" for e in (coarse, fine)]
        return f"| {name} | exact | {shown[0]} | {shown[1]} |"
    return f"| {name} | {order_of(coarse, fine):.2f} | {coarse:.2e} | {fine:.2e} |"


@pytest.mark.parametrize("name", CASES)
def test_the_page_has_the_order_and_error_of_each_step(name: str) -> None:
    case = CASES[name]
    coarse, fine = error(case, COARSE), error(case, FINE)
    stated = next(line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith(f"| {name} |"))
    if case.order is None:
        assert max(coarse, fine) < case.rounding
        assert stated.split("|")[2].strip() == "exact"
    else:
        assert order_of(coarse, fine) == pytest.approx(case.order, abs=case.slack)
        numbers = [float(cell) for cell in stated.split("|")[2:5]]
        assert numbers == pytest.approx([order_of(coarse, fine), coarse, fine], rel=0.06)


def test_the_page_has_no_other_steps() -> None:
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert len(rows) == len(CASES)


def duhem_advice(scheme: Any, drive: float) -> tuple[str, ...]:
    """Advice where the largest step is alpha |dv| = drive."""
    return hf.Duhem(alpha=2.0, scheme=scheme).advice(np.array([0.0, 0.1, 0.1 - 0.5 * drive]))


@pytest.mark.parametrize(("scheme", "limit"), [("explicit", 2.0), ("explicit", 1.0), ("midpoint", 2.0)])
def test_a_duhem_step_beyond_its_range_is_told(scheme: Any, limit: float) -> None:
    """The limits are those of a deviation over one step: reversed above the smaller one, enlarged above the larger one."""
    grown = []
    for part in (0.99, 1.01):
        one, other = (
            np.asarray(simulate(hf.Duhem(alpha=2.0, w0=w0, scheme=scheme), [0.0, 0.5 * part * limit])[0])[1]
            for w0 in (0.0, 1.0)
        )
        grown.append(other - one)
    if scheme == "explicit" and limit == 2.0:
        assert abs(grown[0]) < 1 < abs(grown[1])
    else:
        assert grown[0] > 0 > grown[1]
    told = [duhem_advice(scheme, part * limit) for part in (0.99, 1.01)]
    assert told[0] != told[1]
    assert len(told[1]) == 1
    assert duhem_advice("exact", 100.0) == ()


def test_simulate_notes_an_unstable_step(capsys: pytest.CaptureFixture[str]) -> None:
    for alpha, severities in ((1, []), (30, ["warning"])):
        shown = f"simulate duhem:scheme=explicit --set alpha={alpha} --signal sine --low -1 --high 1 --rate 60 --json"
        assert run(shown.split()) == 0
        notes = json.loads(capsys.readouterr().out)["notes"]
        assert [note["severity"] for note in notes if note["code"] == Code.MODEL_ADVICE] == severities


def test_a_prediction_notes_an_unstable_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A record that is sampled more coarsely than the one that was fitted."""
    u = sine(np.linspace(0.0, 9.0, 200))
    result = hf.fit(duhem_model("explicit"), hf.Record(u=u, y=solved_duhem(u)), start="model", starts=1, noise="iid")
    assert not [note for note in result.notes if note.code is Code.MODEL_ADVICE]
    result.save(tmp_path / "fit", report=False)
    np.savetxt(tmp_path / "coarse.csv", [-1.0, 0.9, -0.9, 0.8, -0.7, 0.9], header="u", comments="")
    run(["predict", str(tmp_path / "fit"), str(tmp_path / "coarse.csv"), "--input-only", "--json"])
    codes = [note["code"] for note in json.loads(capsys.readouterr().out)["notes"]]
    assert codes.count(Code.MODEL_ADVICE) == 1


def test_a_posterior_notes_a_coarse_step_of_its_fit() -> None:
    """The clipped steps of a coarsely sampled friction element make its posterior rough, and no chain mixes there."""
    model, u = hf.BoucWenForce(rho=20.0), np.sin(2 * np.pi * np.arange(120) / 40)
    y = np.asarray(hf.simulate(model, u)[0]) + 0.01 * np.random.default_rng(0).normal(size=u.size)
    fixed = {"kappa_x": 1.0, "rho": 20.0, "sigma": 0.8, "n": 1.5}
    result = hf.fit(model, hf.Record(u=u, y=y), start="model", starts=1, fix=fixed, noise="iid")
    assert [note.code for note in notes_of_fit(result)].count(Code.MODEL_ADVICE) == 1


def solved_duhem(u: np.ndarray) -> np.ndarray:
    """Output of the exact step."""
    return np.asarray(simulate(duhem_model("exact"), u)[0])


if __name__ == "__main__":
    hf.enable_x64()
    for name in CASES:
        print(row(name), flush=True)
