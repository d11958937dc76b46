"""The report on a fit: as text, and as one HTML page with its pictures."""

from hystfit.report.numbers import lines as lines
from hystfit.report.numbers import metrics_words as metrics_words
from hystfit.report.numbers import rounded as rounded
from hystfit.report.page import html_report as html_report
from hystfit.report.page import write as write
from hystfit.report.page import write_into as write_into
from hystfit.report.text import headline as headline
from hystfit.report.text import metric_rows as metric_rows
from hystfit.report.text import text_report as text_report
