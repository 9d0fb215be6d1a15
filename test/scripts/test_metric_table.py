"""The page of all metrics."""

from impulse_control_ros.core.metric_catalogue import METRICS, SAMPLE_COLUMNS
from scripts.metric_table import document
from test.conftest import ROOT


def test_the_page_of_metrics_is_what_the_script_writes():
    assert (ROOT / 'docs' / 'reference' / 'metrics.md').read_text() == document()


def test_no_two_metrics_and_no_two_columns_have_one_title():
    for quantities in (METRICS, SAMPLE_COLUMNS):
        titles = [quantity.title for quantity in quantities.values()]
        assert len(set(titles)) == len(titles)
