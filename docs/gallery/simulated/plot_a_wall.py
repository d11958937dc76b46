"""
Wall: loops that degrade and pinch
==================================

Cycles of growing drift on a simulated timber wall: it loses stiffness and strength, and slips near zero force. ``check`` names this by
models with and without the terms for it; self-similar stops, whose loops scale with the largest drift so far, describe it by one linear
solve.
"""

import matplotlib.pyplot as plt
import numpy as np

import hystfit as hf

hf.enable_x64()


def joint(drift: np.ndarray) -> np.ndarray:
    """Force of fasteners that enlarge their holes: a stiff spring between limits that close up to the last peak."""
    force, peak, forces = 0.0, 0.5, []
    backbone = lambda at: 12 * (1 - np.exp(-at / 8)) * np.exp(-((at / 60) ** 2))

    def upper(now: float) -> float:
        closing = max(0.0, (now - 0.6 * peak) / (0.4 * peak))
        return backbone(now) if now >= peak else backbone(peak) * (0.12 + 0.8 * closing)

    for before, now in zip(np.append(0.0, drift), drift, strict=False):
        force = np.clip(force + 4.0 * (now - before), -upper(-now), upper(now))
        peak = max(peak, abs(now))
        forces.append(force)
    return np.array(forces)


cycle = np.sin(np.linspace(0, 4 * np.pi, 240, endpoint=False))  # two at each amplitude
drift = np.concatenate([amplitude * cycle for amplitude in (2, 4, 7, 11, 16, 22, 29)])
force = joint(drift) + np.random.default_rng(0).normal(0, 0.1, drift.size)
wall = hf.Record(u=drift, y=force, u_unit="mm", y_unit="kN", u_name="drift", y_name="force", name="wall")
for trait in hf.check(wall).traits:
    print(trait)

# %%
# The first 60 % of the samples are fitted; the larger amplitudes that follow are predicted.
edge = int(0.6 * len(wall))
fitted, later = wall.window(None, edge), wall.window(edge, None)
result = hf.fit("self-similar-stops", fitted)
print(f"rms error {result.train.nrmse_percent:.2f} % fitted, {result.metrics(later).nrmse_percent:.2f} % ahead")
result.plot("loop", data=later)

# %%
# Backbone and dissipated energy of every cycle, from the data alone.
figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
loops = hf.force_loops(wall)["wall"]
loops.plot(axes[0])
axes[1].plot([cycle.energy for cycle in loops.cycles], "o")
axes[1].set(xlabel="cycle", ylabel="energy [J]")
