"""`hystfit.explore`: the page for a record in memory, in a notebook or in the browser."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import Any

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import DataError
from hystfit.explorer.server import Server
from hystfit.explorer.session import Session
from hystfit.models.base import AbstractHysteresis
from hystfit.reading.in_memory import records_of
from hystfit.results.result import FitResult


class Explorer:
    """A page that runs until `close`; a notebook shows it in its output.

    Attributes:
        url: address for the browser, on this machine only.
    """

    def __init__(self, session: Session, port: int = 0):
        self._session, self._server = session, Server(session, port)
        self._server.open()
        self.url = self._server.url

    @property
    def values(self) -> dict[str, float]:
        """Values of the sliders."""
        return dict(self._session.values)

    @property
    def model(self) -> AbstractHysteresis:
        """The model that the page shows."""
        return self._session.model

    @property
    def result(self) -> FitResult | None:
        """The last fit that the page has run; None before it."""
        return self._session.result

    def close(self) -> None:
        """Stop the server of the page."""
        self._server.close()

    def __enter__(self) -> Explorer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Explorer: {self.url}; close() stops it>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{html.escape(self.url)}" width="100%" height="720" style="border: 0"></iframe>'


def explore(
    data: Any,
    y: Any = None,
    t: Any = None,
    *,
    u: Any = None,
    model: str = "auto",
    start: Mapping[str, float] | None = None,
    port: int = 0,
) -> Explorer:
    """A page with a slider for each parameter of a model, beside a measured loop; fits start from the sliders.

    In a notebook the page is the output of the cell; elsewhere open its `url`. Only this machine can open it.

    Args:
        data: a record, or a data frame; or the input, shape (T,).
        y: output, shape (T,); of a data frame the name or number of its column.
        t: time of each sample [s], shape (T,), or a column of a data frame.
        u: column of the input in a data frame; or the input, where it is given by name.
        model: name of the first model; "auto" takes one with few parameters that suits the loop.
        start: values that replace those read off the record, by name.
        port: of the server; 0 takes a free one.

    Raises:
        HystfitError: several records, a model that does not suit them, or a port that is in use.
    """
    return Explorer(Session(single(records_of(data, y, t, u=u)), model, start=start), port)


def single(records: Dataset) -> Record:
    """The only record of a data set."""
    if len(records) > 1:
        names = ", ".join(record.name for record in list(records)[:8])
        raise DataError(f"the explorer shows one record, and these are {len(records)} ({names}): choose one by only=")
    return records[0]
