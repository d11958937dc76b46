"""The report on a fit: as text, and as one HTML page with its pictures."""

from hystfit.results.report.answer import Wording as Wording
from hystfit.results.report.page import html_report as html_report
from hystfit.results.report.page import notebook_view as notebook_view
from hystfit.results.report.page import write as write
from hystfit.results.report.page import write_into as write_into
from hystfit.results.report.tables import metrics_table as metrics_table
from hystfit.results.report.tables import metrics_words as metrics_words
from hystfit.results.report.tables import parameter_table as parameter_table
from hystfit.results.report.tables import quantity_table as quantity_table
from hystfit.results.report.text_report import headline as headline
from hystfit.results.report.text_report import text_report as text_report
