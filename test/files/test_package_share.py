"""The experiments of the package are found beside it, and in the prefix it is installed in."""

import pytest

from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files import package_share
from test.conftest import CONFIG


def test_in_the_repository_an_experiment_is_the_one_in_config():
    assert package_share.shipped_experiment('coulomb') == CONFIG / 'coulomb.yaml'


def test_once_installed_it_is_the_one_in_share(monkeypatch, tmp_path):
    package = tmp_path / 'lib' / 'python3' / 'site-packages' / 'impulse_control_ros' / 'files'
    share = tmp_path / 'share' / 'impulse_control_ros' / 'config'
    for folder in (package, share):
        folder.mkdir(parents=True)
    (share / 'coulomb.yaml').touch()
    monkeypatch.setattr(package_share, '__file__', str(package / 'package_share.py'))
    assert package_share.shipped_experiment('coulomb') == share / 'coulomb.yaml'


def test_an_unknown_experiment_is_refused_by_name():
    with pytest.raises(ParameterError, match="experiment = .*'bounce'.*"):
        package_share.shipped_experiment('bounce')
