"""Many loops on a GPU and on its host, and single fits where JAX finds a GPU: `python benchmarks/device.py [--quick]`.

A map of 100 000 loops of 2000 samples with errors and status, and where its time goes; equality of both devices; the time of a fit and of
a posterior beside the same with JAX on the CPU alone. A part that fails does not keep the others from running, and none begins after two
and a half minutes. The exit status is 1 where a part failed, devices disagree, errors are wrong, or single fits are slower. Where JAX finds
no GPU, the CPU takes its place: all runs, and no time means anything.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
import traceback
from typing import Any

import jax
import numpy as np

import hystfit as hf
from hystfit.batch import plain_fits, plain_judge, row_accuracy, simulated_rows
from hystfit.batch.alike import Group, Loops, common_of, solve_alike
from hystfit.config import first_device
from hystfit.fitting.fit_options import FitOptions
from hystfit.fitting.solvers import lanes

SAME = 1e-6  # of a standard error: largest difference of estimates of both devices
SLOWER = 1.3  # times the time with JAX on the CPU alone: allowed for a single fit where there is a GPU
PULLS = (0.95, 1.05)  # standard deviation of (estimate - truth) / error
LIMIT_S = 20.0  # for 100 000 loops, warm
LAST_S = 150.0  # after which no part begins
PHASES = ("soundness", "common_of", "solve_alike", "judge_plain", "row_notes", "_examples", "_quantities", "_estimates")


def input_of(samples: int) -> np.ndarray:
    t = np.linspace(0, 20, samples)
    return (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t) + 0.1 * np.sin(2 * np.pi * 3.3 * t)


def truth_of(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    draw = rng.normal(size=(5, count))
    return {"c": np.exp(0.2 * draw[0]), "mu": 0.45 + 0.03 * draw[1], "tau": 1.5 * np.exp(0.15 * draw[2]),
            "rho": 0.5 + 0.05 * draw[3], "offset": draw[4]}  # fmt: skip


def loops(u: np.ndarray, truth: dict[str, np.ndarray], seed: int = 1) -> np.ndarray:
    """Outputs with noise of 0.3 % of the range."""

    def one(values: dict[str, Any]) -> Any:
        return hf.simulate(hf.BoucWen(**values), u)[0]

    count, out = len(truth["c"]), []
    run, rng = jax.jit(jax.vmap(one)), np.random.default_rng(seed)
    for begin in range(0, count, 10_000):
        y = np.asarray(run({name: values[begin : begin + 10_000] for name, values in truth.items()}))
        out.append(y + 0.003 * np.ptp(y, axis=1)[:, None] * rng.standard_normal(y.shape))
    return np.concatenate(out)


def timed(call: Any) -> tuple[Any, float]:
    begin = time.perf_counter()
    result = call()
    return result, time.perf_counter() - begin


def equality(count: int, samples: int, device: Any) -> dict[str, Any]:
    """The same descents one after another on the CPU and side by side on the device."""
    u = input_of(samples)
    y = loops(u, truth_of(count))
    many = Loops((Group(hf.Record(u=u, y=y[0]), y),))
    common = common_of(hf.BoucWen(), many, FitOptions(), held=False)
    assert common is not None
    ends, seconds = {}, {}
    choose = lanes.device_for
    for name, chosen in (("cpu", first_device("cpu")), ("device", device)):
        lanes.device_for = lambda count, chosen=chosen: chosen
        solve_alike(common, many)
        (ends[name], *_), seconds[name] = timed(lambda: solve_alike(common, many))
    lanes.device_for = choose
    normal = ends["cpu"].normal
    error = np.sqrt(np.stack([np.diag(np.linalg.inv(m)) for m in normal.matrix]) * (2 * normal.cost / samples)[:, None])
    apart = np.abs(normal.z - ends["device"].normal.z) / error
    return {
        "loops": count,
        "samples": samples,
        "largest_difference_in_errors": float(apart.max()),
        "same_convergence": bool((ends["cpu"].converged == ends["device"].converged).all()),
        "cpu_s": seconds["cpu"],
        "device_s": seconds["device"],
    }


class Phases:
    """Seconds in some functions, added up over all threads, by name."""

    def __init__(self, *places: tuple[Any, str]):
        self.seconds: dict[str, float] = {}
        for module, name in places:
            setattr(module, name, self._timed(name, getattr(module, name)))

    def _timed(self, name: str, function: Any) -> Any:
        def call(*args: Any, **options: Any) -> Any:
            result, seconds = timed(lambda: function(*args, **options))
            self.seconds[name] = self.seconds.get(name, 0.0) + seconds
            return result

        return call


def big_map(count: int, samples: int) -> dict[str, Any]:
    """A map with errors and status, cold and warm."""
    u, truth = input_of(samples), truth_of(count, 2)
    y = loops(u, truth, 3)
    found, cold = timed(lambda: hf.fit_map("bouc-wen", u, y))
    print(json.dumps({"map_cold_s": cold}), flush=True)
    found, warm = timed(lambda: hf.fit_map("bouc-wen", u, y))
    print(json.dumps({"map_warm_s": warm}), flush=True)
    phases = Phases(
        *((plain_fits, name) for name in PHASES), *((plain_judge, name) for name in ("accuracy", "slow_information"))
    )
    used = time.process_time()
    _, third = timed(lambda: hf.fit_map("bouc-wen", u, y))
    used = time.process_time() - used
    ok = found.ok
    pulls = {name: float(np.std(((found[name] - truth[name]) / found.stderr[name])[ok])) for name in truth}
    return {
        "loops": count, "samples": samples, "cold_s": cold, "warm_s": warm, "ms_a_loop": 1e3 * warm / count,
        "third_s": third, "processor_s": used, "thread_s": phases.seconds, "slow": int(sum("error-ratio" in c for c in found.codes)),
        "ok": float(ok.mean()), "alone": int(found.alone.sum()), "pulls": pulls, "counts": found.counts,
    }  # fmt: skip


def single(samples: int, draws: int) -> dict[str, float]:
    """Warm times of a fit and of a posterior, with the devices that JAX finds in this process."""
    u = input_of(samples)
    y = loops(u, truth_of(1))[0]
    fit = lambda: hf.fit("bouc-wen", u, y)
    result = fit()
    fits = min(timed(fit)[1] for _ in range(3))
    sample = lambda: hf.sample(result, sampler="emcee", seed=0, draws=draws, check=draws)
    sample()
    return {"fit_s": fits, "sample_s": timed(sample)[1]}


def alone_on_cpu(samples: int, draws: int) -> dict[str, float]:
    """`single` in a process in which JAX has the CPU alone."""
    code = f"import device, hystfit as hf, json; hf.enable_x64(); print(json.dumps(device.single({samples}, {draws})))"
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    place = os.path.dirname(os.path.abspath(__file__))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=place)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="little work, which proves that everything runs")
    quick = parser.parse_args().quick
    hf.enable_x64()
    gpu = first_device("gpu")
    device, found = gpu, getattr(gpu, "device_kind", "no GPU found")
    if gpu is None:  # what would go to a GPU goes together on the CPU
        device, lanes._UNROLL = StandIn(), 1
        for module in (lanes, row_accuracy, simulated_rows):
            module.placed = lambda tree, chosen: jax.device_put(tree, jax.devices()[0])
            module.device_for = lambda count: device if count >= (1 if quick else lanes.MANY) else first_device("cpu")
    sizes = {"equality": (8, 300), "map": (24, 1200), "single": (300, 60)} if quick else {
        "equality": (2048, 2000), "map": (100_000, 2000), "single": (10_000, 300),
    }  # fmt: skip
    begun, failures, judged = time.perf_counter(), list[str](), gpu is not None and not quick
    print(json.dumps({"device": found, "cores": os.cpu_count(), "jax": jax.__version__}), flush=True)

    def run_map() -> tuple[dict[str, Any], bool]:
        big = big_map(*sizes["map"])
        wrong = not all(PULLS[0] < value < PULLS[1] for value in big["pulls"].values())
        return big, judged and (wrong or big["warm_s"] > LIMIT_S)

    def run_equality() -> tuple[dict[str, Any], bool]:
        same = equality(*sizes["equality"], device)
        return same, not (same["same_convergence"] and same["largest_difference_in_errors"] < SAME)

    def run_single() -> tuple[dict[str, Any], bool]:
        ours, theirs = single(*sizes["single"]), alone_on_cpu(*sizes["single"])
        ratios = {name: ours[name] / theirs[name] for name in ours}
        return {"here": ours, "cpu_alone": theirs, "ratios": ratios}, judged and max(ratios.values()) > SLOWER

    for name, part in (("map", run_map), ("equality", run_equality), ("single", run_single)):
        if time.perf_counter() - begun > LAST_S:
            failures.append(f"{name} (no time left)")
            continue
        try:
            result, fails = part()
            print(json.dumps({name: result}), flush=True)
        except Exception:  # the other parts still tell something
            traceback.print_exc()
            fails = True
        failures.extend([name] if fails else [])
    print("failed: " + ", ".join(failures) if failures else "all passed")
    raise SystemExit(int(bool(failures)))


class StandIn:
    """A device on which lanes go together, where there is no GPU."""

    platform = "stand-in"


if __name__ == "__main__":
    main()
