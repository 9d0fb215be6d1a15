"""Draw docs/underdamped.png, the README's picture: pip install matplotlib, then run this file."""

from pathlib import Path

from matplotlib import pyplot as plt

from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.files.experiment import read_experiment

ROOT = Path(__file__).parent.parent
CASES = {'pd_only_lower': 'PD only', 'underdamped': 'PD and impulses'}

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout='constrained')
for name, label in CASES.items():
    experiment = read_experiment(ROOT / 'config' / f'{name}.yaml')
    run = simulate(experiment.plant_simulator, experiment.controller, 2.0)
    left.plot(run.time, run.position, label=label)
    right.plot(run.position, run.velocity, label=label)
left.set(xlabel='time [s]', ylabel='position [m]', xlim=(0, 2))
right.set(xlabel='position [m]', ylabel='velocity [m/s]')
for axes in (left, right):
    axes.grid(alpha=0.3)
left.legend()
figure.suptitle('Underdamped axis (d = 0.15 N s/m), from x = 0.5 m at rest')
figure.savefig(ROOT / 'docs' / 'underdamped.png', dpi=120)
