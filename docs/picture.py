"""Draw the picture of the README and of the front page: loops with fits, from scripts of the gallery.

python docs/picture.py
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import matplotlib.pyplot as plt  # noqa: E402
from generate.style import save_both  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

import hystfit as hf  # noqa: E402

PANELS = {
    "plot_1_piezo.py": "piezo actuator",
    "plot_2_asymmetric_piezo.py": "asymmetric piezo",
    "plot_3_magnetic_core.py": "magnetic core",
    "plot_4_damper.py": "damper",
}


def main() -> None:
    """Run the scripts and draw their results side by side."""
    results = {title: runpy.run_path(str(HERE / "gallery" / name))["result"] for name, title in PANELS.items()}
    plt.close("all")
    save_both(lambda: _draw(results), HERE / "loops")


def _draw(results: dict[str, hf.FitResult]) -> Figure:
    figure, axes = plt.subplots(1, len(results), figsize=(11, 2.9), layout="constrained")
    for ax, (title, result) in zip(axes, results.items(), strict=True):
        data = result.data[0]
        ax.plot(data.u, data.y, color="#9aa0a6", lw=2.6, label="data")
        ax.plot(data.u, result.predict(data), color="#2f86c9", lw=0.9, label="fit")
        ax.set_title(f"{title}: {result.name}", fontsize=8)
        ax.set(xlabel=f"{data.u_name or 'input'} [{data.u_unit}]", ylabel=f"{data.y_name or 'output'} [{data.y_unit}]")
        ax.text(
            0.97, 0.03, f"rms error {result.train.nrmse_percent:.2f} %", ha="right", transform=ax.transAxes, fontsize=8
        )
    axes[0].legend(loc="upper left", fontsize=8)
    return figure


if __name__ == "__main__":
    main()
