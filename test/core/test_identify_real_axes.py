"""
Identification of real axes with published values, in ../shared/data beside the checkout.

EMPS: Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019. TIAGo: the torso of a
PAL robot, which does not excite its mass.
"""

import math
import time

import numpy as np
import pytest

import impulse_control_ros as ic
from test.conftest import ROOT

DATA = ROOT.parent / 'shared' / 'data'
pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason=f'{DATA} does not exist: the records are not part of the package'
)
EMPS = {'m': 95.1089, 'd': 203.5034, 'F_c': 20.3935, 'offset': -3.1648}
BY_DIRECTION = {
    'm': 95.154,
    'd_plus': 166.7061,
    'd_minus': 240.4236,
    'F_c_plus': 20.144,
    'F_c_minus': 20.6277,
}


def recorded(name, part=slice(None)):
    arrays = np.load(DATA / f'{name}.npz')
    columns = {'time': 't', 'position': 'x', 'velocity': 'v', 'effort': 'u'}
    return {name: arrays[key][part] for name, key in columns.items() if key in arrays}


@pytest.fixture(scope='module')
def emps():
    return recorded('emps')


@pytest.mark.parametrize('name', ['emps', 'emps_250hz'])
def test_emps_has_its_published_values(name):
    found = ic.identify(recorded(name))
    assert found.effort_held == 'sampled'
    for published, estimates in ((EMPS, found.parameters), (BY_DIRECTION, found.asymmetric)):
        for key, value in published.items():
            assert estimates[key].value == pytest.approx(value, rel=0.01), key
            assert estimates[key].is_identified
    for key, value in EMPS.items():
        low, high = found.parameters[key].interval
        assert low < value < high
    assert abs(found.asymmetry_z) > 10.0
    assert found.encoder_step == pytest.approx(50e-9)
    assert found.is_identified
    assert 240.4 < found.d_bar < 2.1 * 240.4


def test_emps_keeps_its_mass_with_a_coarse_encoder_or_noise(emps):
    noise = np.random.default_rng(1).normal(0.0, 100e-6, len(emps['position']))
    coarse = 250e-6 * np.round(emps['position'] / 250e-6)
    for position in (coarse, emps['position'] + noise):
        found = ic.identify({**emps, 'position': position})
        assert found.parameters['m'].value == pytest.approx(EMPS['m'], rel=0.03)
        assert found.attenuation < 1e-3
    assert found.position_noise == pytest.approx(100e-6, rel=0.05)


def test_the_first_three_seconds_of_emps_have_one_direction(emps):
    found = ic.identify({name: values[:3000] for name, values in emps.items()})
    assert found.parameters['m'].value == pytest.approx(EMPS['m'], rel=0.01)
    for name in ('d', 'F_c', 'offset'):
        assert 'one direction of motion only' in found.parameters[name].verdict
        assert math.isnan(found.parameters[name].value)
    assert not found.is_identified
    assert 'move in both directions' in found.advice


@pytest.mark.parametrize(
    'parts', [[(1700, 2400)], [(700, 1200), (1700, 2400), (3800, 4350), (4800, 5500)]]
)
def test_constant_speed_does_not_identify_the_mass_of_emps(emps, parts):
    found = ic.identify([{name: values[a:b] for name, values in emps.items()} for a, b in parts])
    assert 'is below what the model leaves over' in found.parameters['m'].verdict
    assert math.isnan(found.parameters['m'].value)
    assert not found.is_identified
    assert any('accelerate' in text for text in found.advice)


def test_the_mass_of_the_tiago_torso_is_refused():
    found = ic.identify(recorded('tiago_torso_lift'))
    assert 'not excited' in found.parameters['m'].verdict
    assert not found.is_identified
    assert any('so it was resampled' in text for text in found.warnings)
    assert any('accelerate' in text for text in found.advice)


@pytest.mark.soak
def test_25_000_samples_take_less_than_200_ms_of_processor_time(emps):
    ic.identify(emps)
    took = []
    for _ in range(5):
        start = time.process_time()
        ic.identify(emps)
        took.append(time.process_time() - start)
    assert min(took) < 0.2
