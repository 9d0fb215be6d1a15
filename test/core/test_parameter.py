"""Parameters: declared once, frozen, and refused with the thing, its value and what is allowed."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.hybrid import solve
from impulse_control_ros.core.parameter import build, declared, RENAMED
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import ParameterError
from impulse_control_ros.files.experiment import ControllerParameters
from impulse_control_ros.files.parameter_file import load_experiment


@pytest.mark.parametrize(
    ('kind', 'values', 'said'),
    [
        (Plant, {'m': 0.0}, ['m = 0.0', '> 0', '[kg]']),
        (Plant, {'m': -1}, ['m = -1.0', '> 0', '[kg]']),
        (Plant, {'F_c': -1e-9}, ['F_c = -1e-09', '>= 0', '[N]']),
        (Plant, {'x_0': float('nan')}, ['x_0 = nan', '[-1e+09, 1e+09]', '[m]']),
        (Plant, {'v_0': float('inf')}, ['v_0 = inf', '[-1e+09, 1e+09]', '[m/s]']),
        (Plant, {'m': True}, ['m = True', 'a number']),
        (Plant, {'time_step': 1.23456789e-5}, ['time_step = 1.23456789e-05', 'whole number']),
        (Plant, {'damping.value': 0.0}, ['damping.value = 0.0', '> 0', '(1)', '[N s/m]']),
        (
            Plant,
            {'damping.kind': 'wavy'},
            ["damping.kind = 'wavy'", 'constant, noise, sinusoidal'],
        ),
        (Plant, {'damping.lower': 2.0}, ['damping.lower = 2.0', 'damping.upper = 1.5']),
        (Plant, {'damping.seed': 1.5}, ['damping.seed = 1.5', 'an integer']),
        (Plant, {'mass': 1.0}, ['mass = 1.0', 'no such parameter']),
        (Plant, {'damping.kid': 'noise'}, ['damping.kid', 'is damping.kind meant?']),
        (ControlGains, {'alpha_ratio': 1.0}, ['alpha_ratio = 1.0', '[0.5, 1)', '(19)']),
        (ControlGains, {'alpha_ratio': 0.4999}, ['alpha_ratio = 0.4999', '[0.5, 1)', '(19)']),
        (ControlGains, {'c': 1.5}, ['c = 1.5', 'one of 1.0, 2.0']),
        (ControlGains, {'d_bar': 0.0}, ['d_bar = 0.0', '> 0', '[N s/m]']),
        (ControlGains, {'K': 'ten'}, ["K = 'ten'", 'a number', '[N/m]']),
        (ControlGains, {'impulses': 1}, ['impulses = 1', 'true or false']),
        (ControlGains, {'hold_off': -1}, ['hold_off = -1', '>= 0', '[samples]']),
        (ControlGains, {'D': None}, ['D = None', 'a number']),
    ],
)
def test_a_refusal_names_the_parameter_its_value_and_what_is_allowed(kind, values, said):
    with pytest.raises(ParameterError) as refused:
        build(kind, values)
    for part in said:
        assert part in str(refused.value)
    assert '\n' not in str(refused.value)


def test_an_integer_given_for_a_float_is_taken_as_a_float():
    gains = build(ControlGains, {'K': 12, 'c': 1})
    assert (gains.K, type(gains.K), gains.c, type(gains.c)) == (12.0, float, 1.0, float)


@pytest.mark.parametrize('text', ['1e-6', '1e-06', '1e3', '-2.5E1', '.5e0', '+1.e+2'])
def test_a_number_that_yaml_1_1_takes_for_a_string_is_a_number(text):
    assert build(ControlGains, {'x_r': text}).x_r == float(text)


@pytest.mark.parametrize('text', ['1', '0.5', 'e3', '1e', '1e3 ', '0x1', 'nan', 'inf', '1e400'])
def test_any_other_string_is_no_number(text):
    with pytest.raises(ParameterError, match='x_r = '):
        build(ControlGains, {'x_r': text})


@pytest.mark.parametrize('ratio', [0.5, 0.75, 0.9999999999999999])
def test_the_bounds_of_alpha_are_half_open(ratio):
    assert ControlGains(alpha_ratio=ratio).alpha_ratio == ratio


def test_a_set_is_frozen():
    with pytest.raises(FrozenInstanceError):
        Plant().m = 2.0


def test_flat_and_build_are_inverse_to_each_other():
    axis = Plant(m=0.25, damping=Damping(kind='noise', seed=7))
    assert axis.flat()['damping.seed'] == 7
    assert build(Plant, axis.flat()) == axis


def test_every_parameter_has_a_description_and_every_quantity_a_unit():
    dimensionless = {
        'c',
        'alpha_ratio',
        'mass_ratio_limits.lower',
        'mass_ratio_limits.upper',
    }
    for kind in (Plant, ControlGains):
        for name, default, spec in declared(kind):
            assert spec.description
            assert spec.unit or not isinstance(default, float) or name in dimensionless


@pytest.mark.parametrize(('old', 'new'), RENAMED.items())
def test_a_former_name_is_refused_with_the_present_one(old, new):
    with pytest.raises(ParameterError, match=f'{old} = 1: .*its name is now {new}$'):
        build(ControllerParameters, {old: 1})
    with pytest.raises(ParameterError, match=f'-p {old}:=1: .*its name is now {new}$'):
        load_experiment(rules=[f'{old}:=1'])
    assert new in ControllerParameters().flat()


def test_a_former_or_unknown_name_is_refused_by_the_class_too():
    with pytest.raises(ParameterError, match='lead = 0.5: .*its name is now guard_lookahead'):
        ControlGains(lead=0.5)
    with pytest.raises(ParameterError, match='dampng = 1: .*is damping meant'):
        Plant(dampng=1)


def test_a_nested_set_must_be_of_its_class():
    with pytest.raises(ParameterError, match="damping = 'noise': must be of class Damping"):
        Plant(damping='noise')


@pytest.mark.parametrize('kind', [np.float32, np.float64, np.int64, np.uint8])
def test_numpy_numbers_are_numbers(kind):
    assert type(ControlGains(K=kind(3)).K) is float
    assert type(ControlGains(hold_off=np.int64(3)).hold_off) is int
    assert ControlGains(impulses=np.bool_(False)).impulses is False
    with pytest.raises(ParameterError, match='hold_off = 3.0: must be an integer'):
        ControlGains(hold_off=np.float64(3))


@pytest.mark.parametrize('duration', [float('nan'), float('inf'), 0.0, -1.0])
def test_a_duration_is_positive_and_finite(duration):
    for run in (simulate, solve):
        with pytest.raises(ParameterError, match='duration = .*: must be > 0 and finite'):
            run(Plant(F_c=0.0), ControlGains(), duration)
