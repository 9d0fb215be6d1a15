"""The page of all parameters."""

from scripts.parameter_table import document
from test.conftest import ROOT


def test_the_page_of_parameters_is_what_the_script_writes():
    assert (ROOT / 'docs' / 'reference' / 'parameters.md').read_text() == document()
