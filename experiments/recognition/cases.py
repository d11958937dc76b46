"""Records of known kind: simulated ones of 1000 samples, and measured ones where their data are found.

Every simulated record has white noise of its own seed. The kinds are those of the table in RESULTS.md; `usable` says whether some
model of hystfit describes the record, so that a fit of it may be called usable.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

import hystfit as hf
from hystfit.models.registry import make_model

SAMPLES = 1000
MEASURED = {
    "piezo with creep": ("piezo_dbo/model", "piezo_dbo/test"),
    "reversal curves": ("ferro_hzo_forc/3V",),
    "magnetic": ("mag_ja_bh/M130_27s", "mag_ja_bh/MnZn_ferrite", "mag_ja_bh/MnZn_HP_ferrite"),
    "damper": ("struct_slotboom/u-damper", "struct_slotboom/hys1", "mr_labcontrol/4.1", "friction_brfd/1Hz"),
    "cyclic steel": ("steel_resspylab/example_1", "steel_resspylab/example_2"),
    "degrading": ("struct_slotboom/trial2", "struct_slotboom/spc1"),
    "no loop": ("steel_resspylab/example_3",),
}
# Kinds that no model describes. A law of degradation may describe a device that degrades, or another of its loops.
NOT_DESCRIBED = ("noise only", "no loop")


@dataclasses.dataclass(frozen=True)
class Case:
    """A record of known kind.

    Attributes:
        name: of the record.
        kind: what it is.
        data: the record or records.
        measured: or simulated.
    """

    name: str
    kind: str
    data: hf.Dataset
    measured: bool = False

    @property
    def usable(self) -> bool:
        """Whether a fit of it may be called usable."""
        return self.kind not in NOT_DESCRIBED


def simulated() -> Iterator[Case]:
    """The simulated records, kind by kind."""
    for kind, (make, count) in KINDS.items():
        for seed in range(count):
            data = hf.Dataset.of(make(np.random.default_rng([seed, len(kind)])))
            yield Case(f"{kind} {seed + 1}", kind, data)


def measured(load: Callable[..., tuple | None]) -> Iterator[Case]:
    """The measured records that are found.

    Args:
        load: as `Results.load`.
    """
    for kind, names in MEASURED.items():
        for name in names:
            if (loaded := load(name, name)) is not None:
                data = hf.Dataset.of(loaded[0])
                yield Case(name, kind, data, measured=True)


# -- inputs ----------------------------------------------------------------------------------------------------------------


def _falling(rng: np.random.Generator, low: float = 0.0, high: float = 100.0, cycles: float = 8.0) -> tuple:
    """A sine of falling amplitude about the middle of a range, from its middle: (t, u), 10 s."""
    t = np.linspace(0, 10, SAMPLES)
    amplitude = (1 - 0.09 * t) * 0.5 * (high - low)
    return t, 0.5 * (low + high) + amplitude * np.sin(2 * np.pi * cycles / 10 * t + rng.uniform(-0.2, 0.2))


def _growing(rng: np.random.Generator, size: float = 1.0) -> tuple:
    """A sine of growing amplitude about zero: (t, u), 10 s."""
    t = np.linspace(0, 10, SAMPLES)
    return t, size * (0.15 + 0.085 * t) * np.sin(2 * np.pi * 0.8 * t) * rng.uniform(0.95, 1.05)


def _through(
    rng: np.random.Generator, model: hf.Series, t: np.ndarray, u: np.ndarray, noise: float, **units
) -> hf.Record:
    """The simulated output with noise, in parts of its range."""
    y = np.asarray(hf.simulate(model, u, np.full(t.size, t[1] - t[0]))[0])
    return hf.Record(u=u, y=y + noise * np.ptp(y) * rng.normal(size=t.size), t=t, **units)


_PIEZO = {"u_unit": "V", "y_unit": "um", "t_unit": "s"}
_FORCE = {"u_unit": "mm", "y_unit": "kN", "t_unit": "s"}


def _bouc_wen(rng: np.random.Generator) -> hf.BoucWen:
    return hf.BoucWen(c=0.15, mu=rng.uniform(0.3, 0.5), tau=rng.uniform(0.02, 0.04), rho=rng.uniform(0.2, 0.6))


def _plays(rng: np.random.Generator) -> hf.PrandtlIshlinskii:
    """Ten plays with falling weights on the range 0 to 100 V."""
    model = make_model("prandtl-ishlinskii:plays=10")
    probe = hf.Record(u=np.array([0.0, 100.0, 0.0]), y=np.array([0.0, 15.0, 1.0]))
    started = model.start([probe])
    weights = 0.06 * np.exp(-np.arange(10) / 4) * rng.uniform(0.7, 1.3, 10)
    import equinox as eqx
    import jax.numpy as jnp

    return eqx.tree_at(lambda m: m.w, started, jnp.asarray(weights).reshape(started.w.shape))


def piezo(rng: np.random.Generator) -> hf.Record:
    """A piezo actuator without creep: Bouc-Wen or plays."""
    model = _bouc_wen(rng) if rng.uniform() < 0.5 else _plays(rng)
    return _through(rng, model, *_falling(rng), 0.001, **_PIEZO)


def piezo_with_creep(rng: np.random.Generator) -> hf.Record:
    """Bouc-Wen with logarithmic creep."""
    model = hf.Series(_bouc_wen(rng), hf.LogCreep(gamma=(rng.uniform(0.01, 0.03),)))
    return _through(rng, model, *_falling(rng), 0.001, **_PIEZO)


def lagging(rng: np.random.Generator) -> hf.Record:
    """Plays behind a lag of a few samples."""
    model = hf.Series(hf.Lag(tau=rng.uniform(0.02, 0.05)), _plays(rng))
    return _through(rng, model, *_falling(rng), 0.001, **_PIEZO)


def duhem(rng: np.random.Generator) -> hf.Record:
    """A Coleman-Hodgdon loop: w' = alpha |v'| (f(v) - w) + v' g(v) with f linear and g constant, by a plain loop."""
    t, v = _growing(rng)
    alpha, slope, g = rng.uniform(2, 4), 1.0, rng.uniform(0.3, 0.5)
    w = np.zeros(t.size)
    for k in range(1, t.size):
        dv, middle = v[k] - v[k - 1], 0.5 * (v[k] + v[k - 1])
        half = 0.5 * alpha * abs(dv)
        w[k] = ((1 - half) * w[k - 1] + 2 * half * slope * middle + g * dv) / (1 + half)
    return hf.Record(u=v, y=w + 0.002 * np.ptp(w) * rng.normal(size=t.size), t=t)


def magnetic(rng: np.random.Generator) -> list[hf.Record]:
    """Centered loops of three amplitudes without time, from a distribution of relays."""
    model = hf.ParametricPreisach()
    records = []
    for number, amplitude in enumerate((1.0, 0.6, 0.35)):
        phase = np.linspace(0, 4 * np.pi, SAMPLES)
        H = 0.9 * amplitude * np.sin(phase)
        B = np.asarray(model.free_run(H))
        noisy = B + 0.002 * np.ptp(B) * rng.normal(size=H.size)
        last = slice(SAMPLES // 2, None)  # the second cycle, which is closed
        records.append(hf.Record(u=H[last], y=noisy[last], name=f"loop-{number + 1}", u_unit="A/m", y_unit="T"))
    return records


def reversal_curves(rng: np.random.Generator) -> list[hf.Record]:
    """Fifteen first-order reversal curves of the same distribution."""
    model, records = hf.ParametricPreisach(), []
    for number, low in enumerate(np.linspace(0.8, -0.9, 15)):
        down, up = np.linspace(1.0, low, 60), np.linspace(low, 1.0, 60)
        M = np.asarray(model.free_run(np.concatenate([np.linspace(-1, 1, 30), down, up])))[-60:]
        noisy = M + 0.002 * 2 * rng.normal(size=60)
        records.append(hf.Record(u=up, y=noisy, name=f"curve-{number + 1}", u_unit="Oe", y_unit="emu"))
    return records


def damper(rng: np.random.Generator) -> hf.Record:
    """A yielding element: force against displacement, clockwise."""
    model = hf.BoucWenForce(kappa_x=1.0, kappa_w=rng.uniform(2, 4), rho=rng.uniform(4, 8), n=rng.uniform(1.2, 2.0))
    return _through(rng, model, *_growing(rng), 0.003, **_FORCE)


def viscous_damper(rng: np.random.Generator) -> hf.Record:
    """The same beside a viscous force."""
    model = hf.Sum(hf.BoucWenForce(kappa_x=1.0, kappa_w=3.0, rho=6.0), hf.Viscous(rng.uniform(0.2, 0.4)))
    return _through(rng, model, *_growing(rng), 0.003, **_FORCE)


def degrading(rng: np.random.Generator) -> hf.Record:
    """Stiffness and strength fall with the dissipated energy; pinched: by a plain loop."""
    t, x = _growing(rng)
    z, energy, force = 0.0, 0.0, np.zeros(t.size)
    for k in range(1, t.size):
        dx = x[k] - x[k - 1]
        left = 1 / (1 + rng.uniform(0.5, 0.6) * energy)
        z = np.clip(z + 6 * left * dx, -1, 1)
        energy += abs(z * dx)
        force[k] = left * (0.3 * x[k] * 4 + z * (0.3 + 0.7 * min(1.0, abs(x[k]) / (np.max(np.abs(x[: k + 1])) + 1e-9))))
    return hf.Record(u=x, y=force + 0.003 * np.ptp(force) * rng.normal(size=t.size), t=t, **_FORCE)


def resonant(rng: np.random.Generator) -> hf.Record:
    """Bouc-Wen before a resonance at 6 to 9 Hz, driven by a chirp up to 12 Hz at 100 samples/s."""
    t = np.linspace(0, 10, SAMPLES)
    u = 50 + 40 * np.sin(2 * np.pi * (0.5 * t + 0.5 * 1.1 * t**2))
    omega = 2 * np.pi * rng.uniform(6, 9)
    return _through(rng, hf.Series(_bouc_wen(rng), hf.SecondOrder(omega=omega, zeta=0.05)), t, u, 0.002, **_PIEZO)


def viscoelastic(rng: np.random.Generator) -> hf.Record:
    """Bouc-Wen before two relaxations, at several frequencies."""
    t = np.linspace(0, 10, SAMPLES)
    u = 50 + 40 * np.sin(2 * np.pi * np.interp(t, [0, 4, 7, 10], [0, 1.2, 5, 17]))
    model = hf.Series(_bouc_wen(rng), hf.Relaxation(a=(0.1, rng.uniform(0.05, 0.1)), tau=(0.05, 0.8)))
    return _through(rng, model, t, u, 0.001, **_PIEZO)


def noise_only(rng: np.random.Generator) -> hf.Record:
    """An output that has nothing to do with the input."""
    t, u = _falling(rng)
    return hf.Record(u=u, y=rng.normal(size=t.size), t=t, **_PIEZO)


def line_only(rng: np.random.Generator) -> hf.Record:
    """A straight line with noise: no hysteresis."""
    t, u = _falling(rng)
    return hf.Record(u=u, y=0.15 * u + 0.02 * rng.normal(size=t.size), t=t, **_PIEZO)


def one_amplitude(rng: np.random.Generator) -> hf.Record:
    """A piezo loop at one amplitude from 0 V."""
    t = np.linspace(0, 10, SAMPLES)
    u = 50 - 50 * np.cos(2 * np.pi * 0.5 * t)
    return _through(rng, _bouc_wen(rng), t, u, 0.001, **_PIEZO)


def few_samples(rng: np.random.Generator) -> hf.Record:
    """A stepped loop of 60 samples without time."""
    phase = np.linspace(0, 4 * np.pi, 60)
    H = np.round(8 * np.sin(phase)) / 8 * 0.9
    B = np.asarray(hf.ParametricPreisach().free_run(H))
    return hf.Record(u=H, y=B + 0.003 * np.ptp(B) * rng.normal(size=60), u_unit="A/m", y_unit="T")


def stops(rng: np.random.Generator) -> hf.Record:
    """Elastic-plastic elements in parallel, by a plain loop: force against displacement, clockwise."""
    t, x = _growing(rng)
    yields = np.linspace(0.05, 0.8, 8)
    stiffness = np.exp(-np.arange(8) / 3) * rng.uniform(0.7, 1.3, 8)
    state, force = np.zeros(8), np.zeros(t.size)
    for k in range(1, t.size):
        state = np.clip(state + x[k] - x[k - 1], -yields, yields)
        force[k] = stiffness @ state + 0.2 * x[k]
    return hf.Record(u=x, y=force + 0.003 * np.ptp(force) * rng.normal(size=t.size), t=t, **_FORCE)


KINDS: dict[str, tuple[Callable[[np.random.Generator], hf.Record | list[hf.Record]], int]] = {
    "piezo": (piezo, 4),
    "piezo with creep": (piezo_with_creep, 4),
    "piezo with lag": (lagging, 3),
    "one amplitude": (one_amplitude, 3),
    "Duhem": (duhem, 3),
    "magnetic": (magnetic, 3),
    "reversal curves": (reversal_curves, 3),
    "damper": (damper, 4),
    "viscous damper": (viscous_damper, 2),
    "elastic-plastic": (stops, 3),
    "degrading": (degrading, 3),
    "resonant": (resonant, 3),
    "viscoelastic": (viscoelastic, 2),
    "noise only": (noise_only, 3),
    "line only": (line_only, 3),
    "few samples": (few_samples, 2),
}
