"""The report on a fit: as text, and as one HTML page with its pictures."""

from hystfit.results.report.numbers import lines as lines
from hystfit.results.report.numbers import metrics_words as metrics_words
from hystfit.results.report.numbers import rounded as rounded
from hystfit.results.report.page import html_report as html_report
from hystfit.results.report.page import write as write
from hystfit.results.report.page import write_into as write_into
from hystfit.results.report.text import headline as headline
from hystfit.results.report.text import metric_rows as metric_rows
from hystfit.results.report.text import text_report as text_report
