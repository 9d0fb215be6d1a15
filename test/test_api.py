"""The top level of the package: its names, its exceptions, and what importing it loads."""

import ast
import builtins
import inspect
import subprocess
import sys

import pytest

import impulse_control_ros as ic
from impulse_control_ros import errors
from test.processes import ROOT

PACKAGE = ROOT / 'impulse_control_ros'
ERRORS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]


def loaded_after(code):
    """Return the modules that a new interpreter has loaded after ``code``."""
    said = subprocess.run(
        [sys.executable, '-c', f'{code}; import sys; print(*sys.modules)'],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    return set(said.stdout.split())


def test_importing_the_package_loads_nothing_else():
    loaded = loaded_after('import impulse_control_ros; dir(impulse_control_ros)')
    assert {name for name in loaded if name.startswith('impulse')} == {'impulse_control_ros'}
    assert loaded.isdisjoint({'numba', 'numpy', 'yaml', 'rclpy', 'mcap', 'matplotlib', 'pandas'})


def test_a_simulation_loads_no_files_no_ros_and_no_plots():
    loaded = loaded_after(
        'import impulse_control_ros as ic; ic.simulate(ic.Plant(), ic.ControlGains(), 0.1)'
    )
    assert 'numba' in loaded
    assert loaded.isdisjoint({'rclpy', 'mcap', 'matplotlib', 'pandas'})


def test_every_name_of_the_top_level_is_what_its_module_calls_so():
    assert set(ic.__all__) <= set(dir(ic))
    for name in ic.__all__:
        found = getattr(ic, name)
        assert found.__name__.rpartition('.')[2] == name
        assert (found.__doc__ or '').strip()


def test_type_checkers_see_the_names_that_are_there_at_run_time():
    tree = ast.parse((PACKAGE / '__init__.py').read_text())
    (checked,) = [node for node in tree.body if isinstance(node, ast.If)]
    seen = {alias.name: node.module for node in checked.body for alias in node.names}
    assert sorted(seen) == sorted(ic.__all__)
    for name, module in seen.items():
        found = getattr(ic, name)
        assert getattr(found, '__module__', module) == module


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'impulse_control_ros' has no attribute 'Plnt'"):
        ic.Plnt  # noqa: B018 (it raises)


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
