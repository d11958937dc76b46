"""Simulated loops whose truth is known: damage, rate, friction and temperature."""

from __future__ import annotations

import math

import numpy as np
from common import Results

import hystfit as hf

SEED = 0
PINCHED = hf.BoucWenBaberNoori(
    kappa_x=0.1, kappa_w=1.0, zy=0.15, beta=0.7, n=1.4, dnu=0.01, deta=0.03, zs=0.85, p=0.15, q=0.1, psi=0.3
)
PLAYS = hf.RateDependentPlays(
    w=(3.0, 2.0, 4.0), r=(0.02, 0.08, 0.2), gain=20.0, tau=0.002, high=10.0, speed=3000.0, kappa=0.1
)
RUBBING = hf.LuGre(sigma0=200.0, sigma1=0.3, sigma2=0.4, Fc=1.0, dFs=0.6, vs=0.5, k=0.3, offset=0.1)


def noisy(y: np.ndarray, percent: float, seed: int = SEED) -> np.ndarray:
    """With noise of so many percent of the range."""
    return y + 0.01 * percent * np.ptp(y) * np.random.default_rng(seed).normal(size=y.size)


def damage(results: Results) -> list:
    """Baber-Noori with 11 free parameters and 1 % noise: errors over standard errors."""
    t = np.linspace(0.0, 12.0, 1500)
    u = (0.1 + t / 12.0) * np.sin(2 * np.pi * t)
    y = noisy(np.asarray(hf.simulate(PINCHED, u)[0]), 1.0)
    fit = hf.fit("bouc-wen-baber-noori", hf.Record(u=u, y=y, name="pinched"), fix={"offset": 0.0})
    rows = [(name, fit[name].value - float(getattr(PINCHED, name)), fit[name].stderr) for name in fit.free_names]
    results.add("Baber-Noori: largest error over standard error", max(abs(e) / (s or np.nan) for _, e, s in rows))
    return [
        [
            "Baber-Noori",
            "largest error over standard error",
            results.numbers["Baber-Noori: largest error over standard error"],
        ]
    ]


def springpot(u: np.ndarray, t: np.ndarray, order: float) -> np.ndarray:
    """Force of fractional order, relaxing as t^-order / Gamma(1 - order): exact for straight lines between samples."""
    rates, gamma = np.diff(u) / np.diff(t), math.gamma(2 - order)
    of = lambda x: np.maximum(x, 0.0) ** (1 - order) / gamma
    return np.array([np.sum(rates * (of(now - t[:-1]) - of(now - t[1:]))) for now in t])


def elastomer(frequency: float, percent: float) -> hf.Record:
    """Two cycles of an element of order 0.2 beside a spring."""
    t = np.arange(241) / 80 / frequency
    u = np.sin(2 * np.pi * frequency * t)
    y = noisy(0.5 * u + springpot(u, t, 0.2), percent, round(100 * frequency))
    return hf.Record(u=u, y=y, t=t, name=f"{frequency:g} Hz")


def viscoelasticity(results: Results) -> list:
    """A power law over six decades: one of three rates left out, by a chain and by a springpot, and a rate between them."""
    rates, rows, errors = (0.01, 1.0, 100.0), [], {}
    records = [elastomer(f, 0.2) for f in rates]
    for name in ("viscoelastic", "springpot"):
        for k, unseen in enumerate(rates):
            fit = hf.fit(f"linear+{name}", [record for j, record in enumerate(records) if j != k])
            errors[name, k] = fit.metrics(elastomer(unseen, 0.0)).nrmse_percent or np.nan
            rows.append([f"linear+{name}", f"{unseen:g} Hz of the other two rates", errors[name, k]])
    results.add("elastomer: the rate between two fitted", errors["viscoelastic", 1])
    results.add("elastomer: a rate beyond two fitted", max(errors["springpot", 0], errors["springpot", 2]))
    whole = hf.fit("linear+viscoelastic", records)
    results.add("elastomer: unseen rate of three fitted", whole.metrics(elastomer(8.0, 0.0)).nrmse_percent or np.nan)
    return rows


def ferroelectric(frequency: float, percent: float) -> hf.Record:
    """A saturating loop whose coercive field grows with the logarithm of the rate: sharp branches, independent of hystfit's models."""
    t = np.arange(601) / 200 / frequency
    u, rate = 2.0 * np.sin(2 * np.pi * frequency * t), 4 * np.pi * frequency * np.cos(2 * np.pi * frequency * t)
    coercive = 1.0 + 0.05 * np.log1p(np.abs(rate) / 3.0)
    y = np.tanh(4.0 * (u - np.sign(rate) * coercive)) + 0.1 * u
    return hf.Record(u=u, y=noisy(y, percent), t=t, name=f"{frequency:g} Hz").window(0.5 / frequency, None)


def coercivity(record: hf.Record, y: np.ndarray) -> float:
    """Mean size of the inputs where the output crosses zero, on the samples that count."""
    at = np.flatnonzero(((y[:-1] < 0) != (y[1:] < 0)) & record.used[:-1])
    u, step = record.u, y[at] / (y[at] - y[at + 1])
    return float(np.mean(np.abs(u[at] + step * (u[at + 1] - u[at]))))


def switching(results: Results) -> list:
    """A coercive field over five decades of frequency, fitted at three of them and predicted at three others."""
    if results.quick:
        return []
    records, rows, worst = [ferroelectric(f, 0.5) for f in (0.1, 10.0, 1000.0)], [], {}
    for name in ("rate-shift+preisach", "preisach"):
        fit = hf.fit(name, records)
        for f in (1.0, 100.0, 10000.0):
            unseen = ferroelectric(f, 0.0)
            error = 100 * abs(coercivity(unseen, fit.predict(unseen)) / coercivity(unseen, unseen.y) - 1)
            worst[name] = max(error, worst.get(name, 0.0))
            rows.append([name, f"error of the coercivity at {f:g} Hz, %", error])
    results.add("ferroelectric: coercivity at unseen frequencies, %", worst["rate-shift+preisach"])
    results.add("ferroelectric: coercivity of a static model, %", worst["preisach"])
    return rows


def piezo(frequency: float, percent: float) -> hf.Record:
    """Cycles of two amplitudes of an actuator whose plays widen with the rate."""
    t = np.arange(500) / 125 / frequency
    u = 5.0 - np.cos(2 * np.pi * frequency * t) * np.where(t * frequency < 2, 5.0, 2.5)
    y = np.asarray(hf.simulate(PLAYS, u, np.diff(t, prepend=0.0))[0])
    return hf.Record(u=u, y=noisy(y, percent, round(frequency)), t=t, name=f"{frequency:g} Hz")


def rate(results: Results) -> list:
    """Plays that widen with the rate: the inverse, and their growth found at three rates."""
    record = piezo(100.0, 0.0)
    u = hf.invert(PLAYS, record.y, dt=record.dt, limits=(-5.0, 15.0)).u
    results.add(
        "rate-dependent plays: inverse, largest error over the range",
        float(np.abs(u - record.u).max() / np.ptp(record.u)),
    )
    start = PLAYS.replace(w=1.0, gain=1.0, kappa=0.01)
    fit = hf.fit(start, [piezo(f, 0.2) for f in (1.0, 20.0, 100.0)], start="model")
    error = results.add("rate-dependent plays: error of kappa, %", 100 * abs(fit["kappa"].value / 0.1 - 1))
    return [["rate-dependent-plays", "error of kappa, %", error]]


def rubbed(frequency: float, percent: float) -> hf.Record:
    """Two growing cycles of LuGre friction beside a spring."""
    t = np.arange(400) / 200 / frequency
    u = np.sin(2 * np.pi * frequency * t) * (0.5 + 0.25 * t * frequency)
    y = np.asarray(hf.simulate(RUBBING, u, np.diff(t, prepend=0.0))[0])
    return hf.Record(
        u=u, y=noisy(y, percent, round(100 * frequency)), t=t, u_unit="mm", y_unit="N", name=f"{frequency:g} Hz"
    )


def friction(results: Results) -> list:
    """Friction at three rates: an unseen one, by the law itself and by stops with a viscous force."""
    records, unseen, rows = [rubbed(f, 0.5) for f in (0.02, 0.2, 2.0)], rubbed(0.06, 0.0), []
    for name in ("lugre", "maxwell-slip", "prandtl-ishlinskii-stop+viscous"):
        error = hf.fit(name, records, starts=1).metrics(unseen).nrmse_percent or np.nan
        results.add(f"friction: unseen rate, {name}", error)
        rows.append([name, "unseen rate", error])
    return rows


def warmed(temperature: float, percent: float) -> hf.Record:
    """Cycles of two amplitudes of an element whose stiffness after yielding and yield force fall with the temperature."""
    t = np.linspace(0.0, 3.0, 300)
    u = np.where(t < 2, 1.0, 0.5) * np.sin(2 * np.pi * t)
    model = hf.BoucWenForce(
        kappa_x=0.5 - 0.002 * temperature, kappa_w=2.0 - 0.01 * temperature, rho=5.0, sigma=0.8, n=1.5
    )
    y = noisy(np.asarray(hf.simulate(model, u)[0]), percent, round(100 + temperature))
    return hf.Record(u=u, y=y, name=f"{temperature:g}degC")


def temperature(results: Results) -> list:
    """Two parameters that fall with the temperature: their slopes, and an unseen temperature."""
    records, unseen = [warmed(t, 1.0) for t in (-20.0, 0.0, 20.0, 60.0)], warmed(40.0, 0.0)
    fit = hf.fit("bouc-wen-force", records, covariates={"T_degC": ["kappa_x", "kappa_w"]}, starts=1)
    truth = {"kappa_x/T_degC": -0.002, "kappa_w/T_degC": -0.01}
    pulls = [abs(fit[name].value - value) / (fit[name].stderr or np.nan) for name, value in truth.items()]
    results.add("covariate: largest error of a slope over its standard error", max(pulls))
    ahead = results.add("covariate: unseen temperature", fit.metrics(unseen).nrmse_percent or np.nan)
    blind = hf.fit("bouc-wen-force", records, starts=1).metrics(unseen).nrmse_percent
    return [["with T_degC", "unseen temperature", ahead], ["without", "unseen temperature", blind]]


def laws(results: Results) -> list:
    """Rows of all."""
    return [row for part in (damage, viscoelasticity, switching, rate, friction, temperature) for row in part(results)]
