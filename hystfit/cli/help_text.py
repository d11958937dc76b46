"""Help of the command line: examples below the options, and descriptions wrapped at the width of the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cyclopts.help import DefaultFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

# One or two commands for each verb that can be typed as they are, in the order of a first session.
EXAMPLES = {
    "fit": ("hystfit fit loop.csv --out fit", "hystfit fit loop.csv --model bouc-wen+creep --window 5:25 --out fit"),
    "compare": ("hystfit compare loop.csv", "hystfit compare loop.csv --models bouc-wen,duhem --left-out future"),
    "batch": ("hystfit batch 'loops/*.csv' --model bouc-wen --out fits",),
    "map": ("hystfit map scan.h5 --model bouc-wen --out maps",),
    "population": ("hystfit population 'loops/*.csv' --model bouc-wen --out pop",),
    "check": ("hystfit check loop.csv", "hystfit check loop.csv --input u_V --output y_um"),
    "forc": ("hystfit forc curves.csv --by curve --out forc",),
    "quantities": ("hystfit quantities loop.csv", "hystfit quantities loop.csv --out loop"),
    "explore": ("hystfit explore loop.csv",),
    "predict": ("hystfit predict fit other.csv",),
    "invert": ("hystfit invert fit reference.csv --output y_um --limits 0:100 --out inverse",),
    "export": ("hystfit export fit --c board", "hystfit export fit --mat fit.mat"),
    "sample": ("hystfit sample fit --out posterior", 'hystfit sample fit --prior "rho=normal(0.9,0.05)"'),
    "profile": ("hystfit profile fit --out profiles",),
    "errors": ("hystfit errors fit", "hystfit errors fit --parameter w"),
    "calibrate": ("hystfit calibrate fit --replicates 50",),
    "design": ("hystfit design fit --low 0 --high 100 --out design",),
    "report": ("hystfit report fit",),
    "simulate": ("hystfit simulate stage --signal amplitude-sweep --low 0 --out sweep.csv",),
    "run": ("hystfit run study.toml --dry-run",),
    "models": ("hystfit models", "hystfit models bouc-wen"),
    "datasets": ("hystfit datasets", "hystfit datasets stage-sweep --out loop.csv"),
    "completion": ("hystfit completion bash --install",),
}


def examples(verb: str) -> str:
    """The examples of a verb, as the last paragraph of its help."""
    lines = EXAMPLES[verb]
    return "\n  ".join(["Example:" if len(lines) == 1 else "Examples:", *lines])


class WrappedHelp(DefaultFormatter):
    """Panels whose descriptions have no line breaks but those of the terminal: those of the source come at any column."""

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print a panel."""
        for entry in panel.entries:
            _join_lines(entry)
        super().__call__(console, options, panel)


def _join_lines(entry: HelpEntry) -> None:
    from rich.text import Text

    text = getattr(entry.description, "primary_renderable", None)
    if isinstance(text, Text):
        text.plain = " ".join(text.plain.split())
