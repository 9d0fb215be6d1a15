"""The top level of the package: its names, its exceptions, and what importing it loads."""

import ast
import builtins
import inspect

import pytest

from impulse_control_ros import errors
from test.processes import ROOT

PACKAGE = ROOT / 'impulse_control_ros'
ERRORS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]


def test_only_the_module_errors_defines_exceptions():
    known = {
        name
        for module in (builtins, errors)
        for name, kind in inspect.getmembers(module, inspect.isclass)
        if issubclass(kind, BaseException)
    }
    defined = {
        path.name
        for path in PACKAGE.rglob('*.py')
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
        and not known.isdisjoint(ast.unparse(base).split('.')[-1] for base in node.bases)
    }
    assert defined == {'errors.py'}


@pytest.mark.parametrize('kind', ERRORS)
def test_every_exception_has_the_one_base_class_and_a_sentence(kind):
    assert issubclass(kind, errors.ImpulseControlError)
    (sentence,) = kind.__doc__.split('\n')
    assert sentence.endswith('.')


@pytest.mark.parametrize(
    ('kind', 'builtin'),
    [
        (errors.ParameterError, ValueError),
        (errors.DivergedError, ArithmeticError),
        (errors.SweepError, RuntimeError),
        (errors.MissingPackageError, ImportError),
    ],
)
def test_an_exception_is_also_what_python_calls_it(kind, builtin):
    assert issubclass(kind, builtin)
