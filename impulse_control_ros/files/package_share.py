"""The experiments shipped with the package."""

from pathlib import Path

from impulse_control_ros.core.parameter import refusal

PACKAGE = 'impulse_control_ros'


def shipped_experiment(name: str) -> Path:
    """
    Return the parameter file of a shipped experiment, by its name without ``.yaml``.

    In the repository, the file is in ``config`` beside the package; once installed, in ``share``
    of the prefix above the package. Raises `ParameterError` if there is none.
    """
    package = Path(__file__).resolve().parents[1]
    folders = [
        package.parent / 'config',
        *(prefix / 'share' / PACKAGE / 'config' for prefix in package.parents),
    ]
    for folder in folders:
        if (folder / f'{name}.yaml').is_file():
            return folder / f'{name}.yaml'
    raise refusal('experiment', name, f'one in {folders[0]} or share/{PACKAGE}/config above it')
