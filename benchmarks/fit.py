"""Time of a fit: a second fit of 10 000 samples against one simulation, and the programs compiled for the first."""

import time

import jax
import jax.monitoring
import numpy as np

import hystfit as hf

SAMPLES, REPEATS = 10_000, 7
COMPILED: list[float] = []


def listen(event: str, seconds: float, **_: object) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        COMPILED.append(seconds)


def made(model, seed: int) -> hf.Record:
    t = np.linspace(0, 20, SAMPLES)
    u = (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t + 0.1 * seed)
    y = np.asarray(hf.simulate(model, u)[0])
    return hf.Record(u=u, y=y + np.random.default_rng(seed).normal(0, 0.003, SAMPLES), t=t)


def best(run: object, repeats: int = REPEATS) -> float:
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        run()  # type: ignore[operator]
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def main() -> None:
    hf.enable_x64()
    jax.monitoring.register_event_duration_secs_listener(listen)
    cases = {
        "Bouc-Wen": hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=0.3),
        "Bouc-Wen, exact": hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=0.3, scheme="exact"),
        "Duhem": hf.Duhem(alpha=2.0, f=[0.1, 1.0, 0.1, -0.05], g=[0.5, 0.05, 0.02], w0=0.1),
        "force": hf.BoucWenForce(kappa_x=0.4, kappa_w=1.0, rho=4.0, sigma=0.9, n=2.0, offset=0.1),
    }
    print(
        f"{'model':<18} {'programs':>9} {'first s':>8} {'second ms':>10} {'programs':>9} {'simulation ms':>14} {'ratio':>7}"
    )
    for name, truth in cases.items():
        first, second = made(truth, 1), made(truth, 2)
        model = type(truth)() if name != "Bouc-Wen, exact" else hf.BoucWen(scheme="exact")
        COMPILED.clear()
        started = time.perf_counter()
        hf.fit(model, first, starts=1)
        cold, programs = time.perf_counter() - started, len(COMPILED)
        COMPILED.clear()
        warm = best(lambda model=model, second=second: hf.fit(model, second, starts=1))
        again = len(COMPILED)
        forward = best(lambda truth=truth, second=second: jax.block_until_ready(hf.simulate(truth, second.u)[0]))
        print(
            f"{name:<18} {programs:>9} {cold:>8.2f} {1e3 * warm:>10.1f} {again:>9} {1e3 * forward:>14.3f} {warm / forward:>7.0f}"
        )


if __name__ == "__main__":
    main()
