"""Draw the picture of the README and of the front page: measured loops with fits, from scripts of the gallery.

    python docs/picture.py

The measured data are read from the folder that HYSTFIT_DATA names, or downloaded.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import matplotlib.pyplot as plt  # noqa: E402
from generate.style import save_both  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from hystfit.params.units import axis_label  # noqa: E402
from hystfit.results.record_plots import thin  # noqa: E402

PANELS = {
    "plot_1_piezo.py": "piezo stack, predicted",
    "plot_2_electric_steel.py": "electric steel",
    "plot_4_u_damper.py": "U-damper, predicted",
    "plot_5_steel_coupon.py": "steel coupon",
}


def main() -> None:
    """Run the scripts and draw their results side by side."""
    runs = {title: runpy.run_path(str(HERE / "gallery" / "measured" / name)) for name, title in PANELS.items()}
    plt.close("all")
    save_both(lambda: _draw(runs), HERE / "loops")


def _draw(runs: dict[str, dict[str, Any]]) -> Figure:
    """One panel a script: the records that it fitted, or the later part of the record that it predicted.

    Args:
        runs: variables of each script by the title of its panel: `result` and, if a part was held out, `later`.
    """
    figure, axes = plt.subplots(1, len(runs), figsize=(9.6, 3.0), layout="constrained")  # about as wide as it is shown
    for ax, (title, run) in zip(axes, runs.items(), strict=True):
        result = run["result"]
        records = [run["later"]] if "later" in run else result.data
        for k, record in enumerate(records):
            u, y, model = record.u[record.used], record.y[record.used], result.predict(record)[record.used]
            at = thin(1500, u, y, model)
            ax.plot(u[at], y[at], color="#9aa0a6", lw=2.6, label=None if k else "measured")
            ax.plot(u[at], model[at], color="#2f86c9", lw=0.9, label=None if k else "model")
        error = (result.metrics(run["later"]) if "later" in run else result.train).nrmse_percent
        ax.set_title(f"{title}\nrms error {error:.2g} %", fontsize=11)
        ax.tick_params(labelsize=10)
        ax.locator_params(axis="x", nbins=4)
        ax.set_xlabel(axis_label(record.u_name or "input", record.u_unit), fontsize=11)
        ax.set_ylabel(axis_label(record.y_name or "output", record.y_unit), fontsize=11)
    axes[0].legend(loc="upper left", fontsize=10, borderaxespad=0.1, handlelength=1.2)
    return figure


if __name__ == "__main__":
    main()
