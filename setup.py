from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'impulse_control_ros'
ROS = ['ros-jazzy-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces==5.3.6']
NODES = ['plant_simulator', 'controller', 'recorder', 'closed_loop', 'excite', 'dashboard']
TOOLS = [
    *('simulate', 'analyze', 'identify', 'export_bag', 'replay', 'sweep', 'paper_figures'),
    'param',
]
REPORT = ['plotly>=6']
DASHBOARD = [*REPORT, 'bokeh>=3.8']  # with tornado, which it needs
# 400 MB that a robot does not need
ANALYSIS = [*REPORT, 'matplotlib>=3.8', 'pandas>=2.1', 'pyarrow']
DASK = ['distributed']
EXAMPLES = ['mujoco']

setup(
    name=PACKAGE,
    version='0.1.0',
    description='Impulse-based hybrid motion control of an axis, as ROS 2 nodes',
    license='Apache-2.0',
    maintainer='impulse_control_ros maintainers',
    maintainer_email='maintainers@impulse-control-ros.invalid',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed', 'nodes/dashboard/page/*', 'tools/*/page/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*'))),
        (f'share/{PACKAGE}/layouts', sorted(glob('layouts/*'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
        (f'share/{PACKAGE}/qos', sorted(glob('qos/*.yaml'))),
        (f'share/{PACKAGE}/studies', sorted(glob('studies/*.yaml'))),
    ],
    python_requires='>=3.10',
    install_requires=[
        'setuptools',
        'numpy',
        'numba>=0.61',
        'mcap>=1.2',
        'lz4',
        'rosbags',
        'zstandard',
        'pyyaml',
        'tqdm',
    ],
    extras_require={
        'ros': ROS,
        'report': REPORT,  # for analyze --report
        'dashboard': DASHBOARD,  # and for make demo
        'analysis': ANALYSIS,
        'dask': DASK,
        'examples': EXAMPLES,
        # what benchmarks/peers.py compares with
        'bench': ['diffrax', 'drake', 'jax', 'jaxonomy', 'pathsim', 'scipy'],
        # pytest 9 fails beside launch_testing; colcon fails with setuptools 80.
        'test': [
            'pytest<9',
            'pytest-xdist',
            'hypothesis>=6.135',  # test/conftest.py replaces a function of it
            'ipykernel',
            'mpmath',
            'mypy',
            'nbclient',
            'mcap-ros2-support',
            'ruff',
            'selenium',
            'types-PyYAML',
            'colcon-common-extensions',
            'catkin_pkg',
            'setuptools<80',
            *ANALYSIS,
            *DASHBOARD,
            *DASK,
            *EXAMPLES,
        ],
    },
    zip_safe=True,
    entry_points={
        'console_scripts': [f'{name} = {PACKAGE}.command_line:{name}' for name in (*NODES, *TOOLS)]
    },
)
