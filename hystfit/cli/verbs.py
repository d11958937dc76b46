"""The verbs of the command line, their help, and the translation of Python options in messages to shell options."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import re
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING

from cyclopts.help import DefaultFormatter

if TYPE_CHECKING:
    from cyclopts.help import HelpEntry, HelpPanel
    from rich.console import Console, ConsoleOptions

VERBS = {
    "check": ("check:check", "Check the quality of a record and which models it can determine."),
    "fit": ("fit:fit", "Fit a model to a measured loop and report what the data determine."),
    "compare": ("fit:compare", "Fit several models and rank them by their cross-validation error."),
    "quantities": (
        "loop_quantities:quantities",
        "Read coercivity, remanence, loss or stiffness off measured loops, without a model.",
    ),
    "explore": ("explore:explore", "Open a page with a slider for each parameter of a model over the measured loop."),
    "batch": ("batches:batch", "Fit a model to each of many loops and tabulate the parameters."),
    "map": ("maps:fit_loops", "Fit a model to every loop of an array, such as that of a scan, and draw the maps."),
    "population": ("populations:population", "Fit a model to many devices and find how much they differ."),
    "forc": ("reversals:forc", "Compute the FORC diagram of first-order reversal curves and its key numbers."),
    "predict": ("predict:predict", "Simulate a fitted model on another record and report its error."),
    "invert": ("control:invert", "Compute the input that makes a fitted model follow a reference."),
    "export": ("control:export", "Write a fitted model and its inverse as C code, or the fit for MATLAB."),
    "sample": ("uncertainty:sample", "Sample the posterior of a fit, with convergence diagnostics."),
    "profile": ("uncertainty:profile", "Compute confidence limits of the parameters by profile likelihood."),
    "errors": (
        "uncertainty:errors",
        "Compare standard errors of several methods: i.i.d. residuals, sandwich, block bootstrap.",
    ),
    "calibrate": (
        "uncertainty:calibrate",
        "Test by simulation whether the confidence intervals of a fit cover the true values.",
    ),
    "design": ("uncertainty:design", "Propose the next input to measure, which reduces the standard errors most."),
    "report": ("predict:report", "Print the report of a saved fit and draw its plots again."),
    "simulate": ("simulate:simulate", "Simulate a record with the piezo stage, a model or a fit."),
    "run": ("run_file:run", "Run the steps of a study from one file, except those whose inputs have not changed."),
    "models": ("catalog:models", "List the models, or the parameters of one."),
    "datasets": ("catalog:datasets", "List the data sets known by name, or write one to a file."),
    "completion": ("catalog:completion", "Set up completion with the Tab key in bash, zsh or fish."),
}
# Unquoted values are left unchanged: names of records also have the form column=value, and --name=value is already an option.
_ARGUMENT = re.compile(r"(?<!-)\b([a-z_]+)=(?:'([^']*)'|(False)\b|True\b|(?![\w'\"({\[.+-]))")
# Options in parentheses, without other words.
_OPTIONS = re.compile(r" \((?:--[\w-]+(?: [^\s,()-][^\s,()]*)?(?:, )?)+\)")


def place(verb: str) -> str:
    """The function of a verb, as "module:function"."""
    return f"hystfit.cli.{VERBS[verb][0]}"


@functools.cache
def option_names() -> frozenset[str]:
    """Names of the options of all verbs, as in Python."""
    return frozenset(name for verb in VERBS for name in (*_parameters(verb), *verb_options(verb)))


def verb_options(verb: str) -> tuple[str, ...]:
    """Names of the options of a verb, as in Python."""
    parameters = _parameters(verb).values()
    alone = (p.name for p in parameters if p.kind is p.KEYWORD_ONLY and not dataclasses.is_dataclass(p.default))
    shared = (p.default for p in parameters if dataclasses.is_dataclass(p.default))
    return (*alone, *(field.name for options in shared for field in dataclasses.fields(options)))


def _parameters(verb: str) -> Mapping[str, inspect.Parameter]:
    module, _, function = place(verb).partition(":")
    return inspect.signature(getattr(importlib.import_module(module), function)).parameters


def as_options(message: str) -> str:
    """A message of the library with options as at the shell: gaps='split' is --gaps split, time=False --time none, trust=True --trust."""

    def option(match: re.Match[str]) -> str:
        if match[1] not in option_names():
            return match[0]
        value = "none" if match[3] else match[2] and shlex.quote(match[2])
        return f"--{match[1].replace('_', '-')}" + (f" {value}" if value else "")

    text = _ARGUMENT.sub(option, message)
    named = lambda match: all(f"{name} " in text[: match.start() + 1] for name in re.findall(r"--[\w-]+", match[0]))
    return _OPTIONS.sub(lambda match: "" if named(match) else match[0], text)


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
        for entry in panel.entries:
            _join_lines(entry)
        super().__call__(console, options, panel)


def _join_lines(entry: HelpEntry) -> None:
    from rich.text import Text

    text = getattr(entry.description, "primary_renderable", None)
    if isinstance(text, Text):
        text.plain = " ".join(text.plain.split())
