"""Magnetic and ferroelectric loops: numbers of data sheets, Jiles-Atherton on three soft materials, fields from flux densities.

    python experiments/magnetics/run.py [--quick] [--out FOLDER]

The quick form fits one ferrite and scores one of five folds. Writes results.json and the tables to out/ and, in the full form with all
data, RESULTS.md here. Exit status: see experiments/common.py.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from common import Results, arguments, table

import hystfit as hf
from hystfit.identify import FieldFromInduction, FluxSequence, VectorHysteresis, VectorRecord
from hystfit.models.jiles_atherton import JilesAtherton
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.params.units import MU0

FOLDER = Path(__file__).resolve().parent
MATERIALS = ("MnZn_ferrite", "MnZn_HP_ferrite", "M130_27s")
MICROMAG = ("A4.hys", "PIOX.loop", "LV23C.hyst", "Conc_40_C3B.hys", "A1c_d200_200.hys", "Noise_test_c100.000")
CATALOG = {"Ansys.AlNiCo_5-7": (59300.0, 55.6), "VegaTechnik.LNGT92": (119300.0, 85.8)}  # HcB [A/m], (BH)max [kJ/m3]
STARTS, FOLDS = 8, 5
SAMPLING = 16e6  # [Hz] of the transients


def values(record: hf.Record) -> dict:
    """Quantities of a measured loop by name."""
    return {one.name: one for one in hf.quantities(record).rows[record.name]}


def data_sheet(results: Results) -> list:
    """A hard magnet in a magnetometer of moments: values after volume and demagnetization, which follow from the header of the file."""
    if (path := results.measured_path("magnet", "vsm_magmeas/VSM_MH.DAT")) is None:
        return []
    found = values(hf.Dataset.of(hf.read(path))[0])
    names = {"HcJ": "HcJ, kA/m", "HcB": "HcB, kA/m", "Br": "Br, T", "energy_product": "(BH)max, kJ/m3", "Js": "Js, T"}
    for name, label in names.items():
        results.add(f"magnet: {label}", found[name].value)
    results.add("magnet: half range of Js over laws, T", found["Js"].spread)
    return [[one.label, one.value, one.stderr, one.spread, one.unit] for one in found.values()]


def instruments(results: Results) -> list:
    """Results that instruments wrote into their files beside ours: relative differences, or standard errors where these are larger."""
    rows = []
    if (path := results.measured_path("instruments", "wild/A4.hys")) is None:
        return rows
    worst = {"MicroMag": [0.0], "aixACCT": [0.0]}
    files = [("MicroMag", path.parent / name) for name in MICROMAG]
    for kind, file in [*files, ("aixACCT", path.parent / "pnzt_RMN_TRAP_SLOW.dat")]:
        for record in hf.Dataset.of(hf.read(file)):
            for one in values(record).values():
                if one.stated is None:
                    continue
                apart, allowed = abs(one.value - one.stated), max(0.01 * abs(one.stated), 2 * (one.stderr or 0.0))
                worst[kind].append(apart / allowed)
                if kind == "MicroMag" or record.name == "Table 1":
                    rows.append([f"{file.name}, {record.name}", one.label, one.value, one.stated, one.unit])
    for kind, every in worst.items():
        results.add(f"instruments: {kind}, results compared", len(every) - 1)
        results.add(f"instruments: {kind}, largest difference over 1 % or two standard errors", max(every))
    for name, (coercivity, product) in CATALOG.items():
        found = values(hf.Dataset.of(hf.read(path.parent / f"B(H).{name}.tab"))[0])
        results.add(f"instruments: catalog {name}, HcB off by, %", 100 * abs(found["HcB"].value / coercivity - 1))
        results.add(
            f"instruments: catalog {name}, (BH)max off by, %", 100 * abs(found["energy_product"].value / product - 1)
        )
    return rows


def area(u: np.ndarray, y: np.ndarray) -> float:
    """Loss of a closed loop."""
    return abs(0.5 * float(np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y)))


def half_width(u: np.ndarray, y: np.ndarray) -> float:
    """Coercivity."""
    return values(hf.Record(u, y, u_unit="A/m", y_unit="T", u_name="H", y_name="B"))["coercive_input"].value


def major_loops(results: Results) -> list:
    """Jiles-Atherton on the largest loop of each material, as published and with pinning that falls with the magnetization."""
    rows = []
    for name in MATERIALS[:1] if results.quick else MATERIALS:
        if (loaded := results.load(f"{name}: major", f"mag_ja_bh/{name}")) is None:
            continue
        record = hf.Dataset.of(loaded[0])[-1]
        variants = {"JA": {}, "with q": {"pinning": True}}
        if not results.quick:
            variants |= {"tanh": {"curve": "tanh"}, "double": {"double": True}}
        for label, variant in variants.items():
            result = hf.fit(JilesAtherton.of(**variant), record, starts=STARTS)
            y = np.asarray(result.predict(record))
            loss = 100 * (area(record.u, y) / area(record.u, record.y) - 1)
            width = 100 * (half_width(record.u, y) / half_width(record.u, record.y) - 1)
            if label in ("JA", "with q"):
                results.add(f"{name}: major loop, {label}", result.train.nrmse_percent)
            if label == "with q":
                results.add(f"{name}: major loop, loss off by, %", abs(loss))
                results.add(f"{name}: major loop, Hc off by, %", abs(width))
            rows.append([name, label, result.train.nrmse_percent, loss, width, result.status])
    return rows


def families(results: Results) -> list:
    """tanh on all loops of a ferrite, and each interior loop left out and predicted."""
    if (loaded := results.load(("MnZn_ferrite: all", "MnZn_ferrite: interior"), "mag_ja_bh/MnZn_ferrite")) is None:
        return []
    # Each loop counts by its own range: otherwise the largest decides alone.
    data, rows = hf.Dataset(tuple(r.with_sigma(np.full(len(r), np.ptp(r.y))) for r in hf.Dataset.of(loaded[0]))), []
    own = lambda result, record: float(
        100 * np.sqrt(np.mean((np.asarray(result.predict(record)) - record.y) ** 2)) / np.ptp(record.y)
    )
    model = JilesAtherton.of(curve="tanh")
    every = hf.fit(model, data, starts=STARTS)
    errors = [own(every, record) for record in data]
    results.add("MnZn_ferrite: all loops by tanh, largest of own range", max(errors))
    rows.append(["all", *errors])
    left_out = []
    for k in (1, 2) if not results.quick else (2,):
        others = hf.Dataset(tuple(record for i, record in enumerate(data) if i != k))
        left_out.append(own(hf.fit(model, others, starts=STARTS), data[k]))
        rows.append([f"without loop {k + 1}", *(left_out[-1] if i == k else None for i in range(len(data)))])
    results.add("MnZn_ferrite: interior loop left out, largest of own range", max(left_out))
    return rows


def numerics(results: Results) -> None:
    """The step of the law at 71 samples a branch against 16 times as many, and the way from H to B and back."""
    shape = {"Ms": 0.388, "a": 23.2, "coupling": 0.796, "k": 17.2, "c": 0.659, "q": [2.38], "slope": MU0}
    u = 80.0 * np.interp(np.arange(71 * 4 * 16 + 1), 71 * 16 * np.arange(5), [0, 1, -1, 1, -1])
    model = JilesAtherton(**shape)
    fine = np.asarray(hf.simulate(model, u)[0])
    coarse = np.asarray(hf.simulate(model, u[::16])[0])
    results.add(
        "law: 71 samples a branch against 16 times as many, of the largest",
        float(np.abs(coarse - fine[::16]).max() / fine.max()),
    )
    h = np.asarray(hf.simulate(JilesAthertonField(**shape), coarse)[0])
    results.add("law: from H to B and back, of the largest", float(np.abs(h - u[::16]).max() / 80.0))


def transients(path: Path) -> list[tuple[FluxSequence, FluxSequence, np.ndarray]]:
    """Each sequence with all its fields, with its known past alone, and the fields [A/m]."""
    columns = np.genfromtxt(path, delimiter=",", names=True)
    found = []
    for number in np.unique(columns["sequence"]):
        rows = columns[columns["sequence"] == number]
        b, h, warm = rows["B_T"], rows["H_A_m"], float(rows["T_degC"][0])
        past = np.where(rows["known"] > 0, h, np.nan)
        found.append((FluxSequence(b, h, 1 / SAMPLING, warm), FluxSequence(b, past, 1 / SAMPLING, warm), h))
    return found


def fields(results: Results) -> list:
    """Unknown fields of the transients of 3C90, by a fit to the sequences of the other folds; score by the rule of the data."""
    if (path := results.measured_path("B to H", "mag_magnetx/3c90_transient.csv")) is None:
        return []
    every, scores, shared, began = transients(path), [], [], time.perf_counter()
    for fold in (0,) if results.quick else range(FOLDS):
        model = FieldFromInduction.fit([one for k, (one, _, _) in enumerate(every) if k % FOLDS != fold])
        for past, h in [(past, h) for k, (_, past, h) in enumerate(every) if k % FOLDS == fold]:
            unknown = ~np.isfinite(past.h)
            of = lambda field, unknown=unknown, h=h: float(
                100 * np.sqrt(np.mean((field - h)[unknown] ** 2) / np.mean(h[unknown] ** 2))
            )
            scores.append(of(model.predict(past)))
            shared.append(of(model.predict(past, adapt=False)))
    results.add("B to H: mean, %", float(np.mean(scores)))
    results.add("B to H: median, %", float(np.median(scores)))
    results.add("B to H: shared coefficients, mean, %", float(np.mean(shared)))
    results.add("B to H: mean error adapted over shared", float(np.mean(scores) / np.mean(shared)))
    rows = [
        ["FieldFromInduction, 28 coefficients, adapted", np.mean(scores), np.median(scores), np.percentile(scores, 95)]
    ]
    rows.append(["the same, shared coefficients", np.mean(shared), np.median(shared), np.percentile(shared, 95)])
    print(f"  {len(scores)} sequences, {time.perf_counter() - began:.0f} s", flush=True)
    return [
        *rows,
        ["long short-term memory, 2399 coefficients (published)", 13.8, None, None],
        ["stops on each past alone", 13.0, None, None],
    ]


def vectors(results: Results) -> list:
    """Vector cells recovered from alternating and rotating records with noise, and the energy of a random walk of the field."""
    true = VectorHysteresis(1.4, 60.0, np.array([25.0, 70.0]), np.array([0.6, 0.4]))
    rng, t, records = np.random.default_rng(0), np.linspace(0, 1, 400), []
    way = 250.0 * np.interp(t, np.linspace(0, 1, 5), [0, 1, -1, 0.5, -1])
    turn = np.minimum(4 * t, 1.0)[:, None] * np.column_stack([np.cos(12 * t), np.sin(12 * t)])
    for h in (np.outer(way, [1.0, 0.0]), np.outer(0.5 * way, [0.3, 0.95]), 60.0 * turn, 150.0 * turn):
        records.append(VectorRecord(h, true.simulate(h) + rng.normal(0, 2e-3, h.shape)))
    found = VectorHysteresis.fit(records, cells=2)
    stacked = lambda model: np.concatenate([[model.Js, model.a], model.kappa, model.w])
    off = 100 * np.abs(stacked(found) / stacked(true) - 1)
    results.add("vector cells: largest error of a parameter, %", float(off.max()))
    walk = np.cumsum(rng.normal(0, 40, (5000, 3)), axis=0)
    lost = true.dissipation(walk)
    results.add("vector cells: smallest dissipation over the mean", float(lost.min() / lost.mean()))
    names = ("Js, T", "a, A/m", "kappa 1, A/m", "kappa 2, A/m", "w 1", "w 2")
    assert found.stderr is not None
    return [[name, *row] for name, *row in zip(names, stacked(true), stacked(found), found.stderr, off, strict=True)]


def main() -> None:
    """Compute all numbers."""
    options = arguments((__doc__ or "").splitlines()[0])
    hf.enable_x64()
    results = Results(FOLDER, options.quick, options.out)
    numerics(results)
    tables = {
        "A hard magnet in a magnetometer": table(
            ["quantity", "value", "stderr", "branches, laws", "unit"], data_sheet(results)
        ),
        "Comparison with the results of the instruments": table(
            ["file", "quantity", "value", "instrument", "unit"], instruments(results)
        ),
        "Jiles-Atherton on the largest loops": table(
            ["material", "variant", "rms error, % of the range", "loss off by, %", "Hc off by, %", "status"],
            major_loops(results),
        ),
        "Loops of a ferrite, rms error in % of their own range": table(["fit", "1", "2", "3", "4"], families(results)),
        "Field from flux density, transients of 3C90, five-fold over sequences": table(
            ["model", "mean, %", "median, %", "95th percentile, %"], fields(results)
        ),
        "Vector cells, simulated with noise of 2 mT": table(
            ["parameter", "true", "fitted", "stderr", "off by, %"], vectors(results)
        ),
    }
    results.publish("Magnetic and ferroelectric loops", "experiments/magnetics/run.py", tables)
    results.finish()


if __name__ == "__main__":
    main()
