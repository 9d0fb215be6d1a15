"""The exact solution: closed forms, an independent high-precision reference, laws, the figures."""

import math
from random import Random

from hypothesis import example, given, settings, strategies as st
from mpmath import expm, findroot, matrix, mp, mpf
import numpy as np
import pytest

from impulse_control_ros.core.control_gains import ControlGains
from impulse_control_ros.core.control_law import POSITION_ZERO, VELOCITY_ZERO
from impulse_control_ros.core.damping import Damping
from impulse_control_ros.core.flow import first_zero, response
from impulse_control_ros.core.hybrid import End, Reading, solve
from impulse_control_ros.core.plant import Plant
from impulse_control_ros.core.simulate import simulate
from impulse_control_ros.errors import ParameterError

mp.dps = 40
FIG_2 = Plant(x_0=0.5, F_c=0.0, damping=Damping(value=0.15))
FIG_5 = Plant(x_0=0.15, F_c=1.0, damping=Damping(value=0.15))
PD = ControlGains(impulses=False)
FIRST_ZERO = 0.12143680500356
FIRST_ZERO_SPEED = 3.49358568945
BOUNCE = 0.045631664494
BOUNCE_TIME = 0.252531890597
BOUNCE_RATIO = 0.0912633


def one_jump(axis, controller, duration, **options):
    return solve(axis, controller, duration, reading=Reading.ONE_JUMP, **options)


# The closed forms, one by one.


def textbook_response(rate, stiffness, t):
    """Return E C, h and H by their definitions; complex roots serve every damping."""
    rate, stiffness, t = mpf(rate), mpf(stiffness), mpf(t)
    root = mp.sqrt(stiffness - rate**2)
    decay = mp.exp(-rate * t)
    h = decay * (mp.sin(root * t) / root if root else t)
    cosine = decay * mp.cos(root * t)
    return [mp.re(value) for value in (cosine, h, (1 - cosine - rate * h) / stiffness)]


RATES = {
    'no damping': 1e-9,
    'underdamped': 3.25,
    'nearly critical': 10 * (1 - 1e-13),
    'critical': 10.0,
    'just overdamped': 10 * (1 + 1e-13),
    'overdamped': 40.0,
    'far overdamped': 1e5,
}


@pytest.mark.parametrize('rate', RATES.values(), ids=RATES)
@pytest.mark.parametrize('t', [0.0, 1e-9, 1e-5, 9.9e-3, 1.01e-2, 0.1, 1.0, 30.0])
def test_the_response_is_that_of_the_textbook_at_every_damping_and_time(rate, t):
    cosine, h, integral = response(rate, 100.0, t)
    expected = [float(value) for value in textbook_response(rate, 100.0, t)]
    assert cosine == pytest.approx(expected[0], rel=1e-12, abs=1e-14)
    assert h == pytest.approx(expected[1], rel=1e-12, abs=1e-15)
    assert integral == pytest.approx(expected[2], rel=1e-12, abs=1e-17)


@pytest.mark.parametrize('rate', RATES.values(), ids=RATES)
@pytest.mark.parametrize(
    ('value', 'slope'),
    [(1.0, -1.0), (1.0, -9.999), (1.0, -60.0), (1e-3, -9.0), (1.0, 3.0), (0.0, 1.0), (1.0, 0.0)],
)
def test_a_first_zero_is_a_zero_and_there_is_none_before(rate, value, slope):
    t = first_zero(value, slope, rate, 100.0)
    curvature = mpf(100) - mpf(rate) ** 2
    if curvature <= 0 and value * mp.sqrt(-curvature) >= -mpf(slope):
        assert t == math.inf
        return
    root = mp.sqrt(curvature)
    phase = (
        mp.atan2(mpf(value) * root, -mpf(slope)) / root
        if curvature > 0
        else (
            mp.re(mp.atan(mpf(value) * root / -mpf(slope)) / root)
            if root
            else mpf(value) / -mpf(slope)
        )
    )
    # Half a period near critical damping is as uncertain as the last bit of the rate makes it.
    rel = 1e-12 if slope < 0 else 1e-12 + 4e-14 / abs(float(curvature))
    assert t == pytest.approx(float(phase), rel=rel)


# The reference: arcs by mp.expm of the matrix of (11), guards by findroot, jumps by (17).


class Reference:
    """Event-driven solution in 40 digits, which imports nothing of the package."""

    def __init__(self, axis, gains, breaks, dampings, strict):
        self.m, self.F_c = mpf(axis.m), mpf(axis.F_c)
        self.K, self.D = mpf(gains.K), mpf(gains.D)
        self.velocity_gain = mpf(gains.d_bar) / gains.c / self.m
        self.factor = 1 - 2 * mpf(gains.alpha_ratio) * mpf(gains.m) / self.m
        self.impulses, self.strict = gains.impulses, strict
        self.ends = [mpf(end) for end in breaks] + [mp.inf]
        self.dampings = [mpf(value) for value in dampings]
        self.x_r = mpf(gains.x_r)
        self.arcs, self.events, self.rest = [], [], None
        self.t, self.e, self.v = mpf(0), mpf(axis.x_0) - self.x_r, mpf(axis.v_0)

    def run(self, duration, most):
        on_axis = self.e == 0 or self.v == 0
        while self.t < duration and len(self.events) < most:
            if on_axis and self.impulses:
                self.jump()
            if self.v == 0 and self.K * abs(self.e) <= self.F_c:
                self.rest = self.t
                break
            on_axis = self.arc(duration)
        return self

    def jump(self):
        before = self.v
        if self.v == 0:
            guard, self.v = 2, -self.velocity_gain * self.e
        else:
            guard, self.v = 1, mpf(0) if self.strict else self.factor * self.v
        self.events.append((self.t, guard, self.x_r + self.e, before, self.v))

    def arc(self, duration):
        piece = next(i for i, end in enumerate(self.ends) if self.t < end)
        until = min(self.ends[piece], duration)
        s = mp.sign(self.v) or -mp.sign(self.e)
        A = matrix(
            [
                [0, 1, 0],
                [
                    -self.K / self.m,
                    -(self.dampings[piece] + self.D) / self.m,
                    -self.F_c * s / self.m,
                ],
                [0, 0, 0],
            ]
        )
        start = matrix([self.e, self.v, 1])
        self.arcs.append((self.t, A, start))

        def after(t):
            return expm(A * t) * start

        step = mpf('0.05') / max(mp.sqrt(self.K / self.m), -A[1, 1])
        stride, state, t = expm(A * step), start, mpf(0)
        while self.t + t < until:
            state, t = stride * state, t + step
            row = next(
                (
                    row
                    for row in ([1] if not self.impulses else [0, 1])
                    if (
                        state[row] * s > 0 and start[row] * s < 0
                        if row == 0
                        else state[row] * s <= 0
                    )
                ),
                None,
            )
            if row is not None:
                if row == 1:
                    root = findroot(lambda t: after(t)[1], (t - step, t), solver='anderson')
                    crossed = self.impulses and start[0] * s < 0 < after(root)[0] * s
                    row = 0 if crossed else 1
                if row == 0:
                    root = findroot(lambda t: after(t)[0], (t - step, t), solver='anderson')
                if self.t + root > until:
                    break
                self.t += root
                self.e, self.v, _ = after(root)
                if row == 0:
                    self.e = mpf(0)
                else:
                    self.v = mpf(0)
                return True
        self.e, self.v, _ = after(until - self.t)
        self.t = until
        return False

    def at(self, t):
        start, A, state = next(arc for arc in reversed(self.arcs) if arc[0] <= t)
        e, v, _ = expm(A * (mpf(t) - start)) * state
        return float(self.x_r + e), float(v)


def random_case(seed):
    """Draw an axis, gains, breaks, dampings: all dampings, frictions, masses and starts."""
    draw = Random(seed)
    m, K, d_bar = draw.uniform(0.05, 0.5), draw.uniform(2, 40), draw.uniform(0.5, 3)
    d, D = draw.uniform(0.05, d_bar), draw.uniform(0, 2)
    if seed % 3 == 0:  # critical but for the rounding, or for a little more
        D = max(2 * math.sqrt(m * K) * (1 + draw.choice([0, 1e-12, -1e-8])) - d, 0.0)
    axis = Plant(
        m=m,
        F_c=draw.choice([0.0, 0.0, draw.uniform(0.05, 2)]),
        x_0=draw.uniform(-1, 1),
        v_0=draw.choice([0.0, draw.uniform(-3, 3)]),
        damping=Damping(value=d),
    )
    gains = ControlGains(
        m=m * draw.uniform(0.8, 1.2),
        K=K,
        D=D,
        d_bar=d_bar,
        c=draw.choice([1.0, 2.0]),
        alpha_ratio=draw.uniform(0.5, 0.83),
        x_r=draw.choice([0.0, draw.uniform(-0.5, 0.5)]),
        impulses=seed % 5 != 0,
    )
    breaks = sorted(draw.uniform(0, 1) for _ in range(seed % 4))
    return axis, gains, breaks, [d, *(draw.uniform(0.05, d_bar) for _ in breaks)]


@pytest.mark.parametrize('reading', Reading)
@pytest.mark.parametrize('seed', range(24))
def test_any_solution_is_that_of_the_independent_reference_to_1e_10(seed, reading):
    axis, gains, breaks, dampings = random_case(seed)
    reference = Reference(axis, gains, breaks, dampings, reading is Reading.STRICT).run(1.5, 7)
    until = min(float(reference.t), 1.5)
    solution = solve(axis, gains, 1.5, reading=reading, breaks=breaks, dampings=dampings)
    events = solution.events[: len(reference.events)]
    assert len(events) == len(reference.events)
    for event, expected in zip(events.tolist(), reference.events, strict=True):
        assert event[1] == expected[1]
        assert event == pytest.approx([float(value) for value in expected], rel=1e-12, abs=1e-12)
    if reference.rest is not None:
        assert solution.end in (End.ORIGIN, End.STICKS)
        assert solution.end_time == pytest.approx(float(reference.rest), abs=1e-12)
    for t in np.linspace(0.0, until, 12, endpoint=False):
        assert solution.at(t) == pytest.approx(reference.at(t), rel=1e-11, abs=1e-11)


# The figures of the paper.


def test_fig_2_read_strictly_the_origin_is_reached_at_the_first_position_zero():
    solution = solve(FIG_2, ControlGains(), 2.0)
    assert solution.events.tolist() == [
        (0.0, VELOCITY_ZERO, 0.5, 0.0, pytest.approx(-3.75)),
        (
            pytest.approx(FIRST_ZERO, abs=1e-14),
            POSITION_ZERO,
            0.0,
            pytest.approx(-FIRST_ZERO_SPEED, abs=1e-11),
            0.0,
        ),
    ]
    assert solution.end is End.ORIGIN
    assert solution.end_time == solution.events['time'][-1]


def test_fig_2_with_one_jump_for_each_crossing_the_axis_bounces_by_a_constant_ratio():
    solution = one_jump(FIG_2, ControlGains(), 2.0)
    turns = solution.events[solution.events['guard'] == VELOCITY_ZERO]
    assert turns['time'][1] == pytest.approx(BOUNCE_TIME, abs=1e-12)
    assert turns['position'][1] == pytest.approx(BOUNCE, abs=1e-12)
    assert np.diff(turns['time']) == pytest.approx(turns['time'][1])
    ratios = turns['position'][1:] / turns['position'][:-1]
    assert ratios == pytest.approx(BOUNCE_RATIO, rel=1e-6)
    assert solution.end is End.DURATION


def test_fig_5_impulses_move_the_sticking_axis_on_for_ever():
    solution = solve(FIG_5, ControlGains(), 2.0)
    time, position = solution.events['time'], solution.events['position']
    assert len(solution.events) == 8444
    assert set(solution.events['guard']) == {VELOCITY_ZERO}
    for tolerance, count, at in ((1e-2, 23, 0.542), (1e-3, 336, 1.155)):
        first = np.flatnonzero(position < tolerance)[0]
        assert (first, time[first]) == (count, pytest.approx(at, abs=5e-4))
    assert solution.at(2.0)[0] == pytest.approx(4.195e-5, abs=5e-9)


def test_fig_5_pd_alone_sticks_inside_the_dead_zone():
    solution = solve(FIG_5, PD, 2.0)
    assert solution.end is End.STICKS
    assert solution.end_time == pytest.approx(0.33219, abs=5e-6)
    assert solution.at([0.5, 100.0])[0] == pytest.approx([0.083014] * 2, abs=5e-7)
    assert len(solution.events) == 0


def test_fig_1_damping_at_its_upper_bound_is_the_critical_closed_form():
    t = np.linspace(0.0, 3.0, 301)
    x, v = solve(Plant(x_0=0.5, F_c=0.0, damping=Damping(value=1.5)), PD, 3.0).at(t)
    assert x == pytest.approx(0.5 * (1 + 10 * t) * np.exp(-10 * t), rel=1e-12, abs=1e-15)
    assert v == pytest.approx(-50 * t * np.exp(-10 * t), rel=1e-12, abs=1e-14)


# Laws of the jumps, the friction, the ends.

amount = st.floats(0.01, 2.0)


@settings(max_examples=60, deadline=None)
@given(amount, st.floats(0.05, 3.0), amount, st.floats(0.5, 0.99), st.sampled_from([0.0, 1.0]))
def test_a_mirrored_start_gives_the_mirrored_motion(x_0, d, m, alpha_ratio, F_c):
    gains = ControlGains(m=m, alpha_ratio=alpha_ratio)
    sides = [
        one_jump(Plant(m=m, x_0=x, F_c=F_c, damping=Damping(value=d)), gains, 0.5)
        for x in (x_0, -x_0)
    ]
    t = np.linspace(0.0, sides[0].end_time, 50)
    assert sides[0].at(t)[0].tolist() == (-sides[1].at(t)[0]).tolist()
    assert sides[0].events['time'].tolist() == sides[1].events['time'].tolist()


@settings(max_examples=60, deadline=None)
@given(amount, st.floats(0.05, 3.0), st.floats(0.0, 2.0), st.booleans())
def test_the_position_is_continuous_and_energy_falls_between_the_jumps(x_0, d, F_c, impulses):
    axis = Plant(x_0=x_0, F_c=F_c, damping=Damping(value=d))
    solution = one_jump(axis, ControlGains(impulses=impulses), 0.5, event_limit=200)
    arcs = solution.arcs
    for arc, after in zip(arcs, arcs[1:], strict=False):
        t = np.linspace(arc['time'], after['time'], 20)[:-1]
        x, v = solution.at(t)
        assert np.all(np.diff(0.1 * v**2 / 2 + 10.0 * x**2 / 2) <= 1e-13)
        x, v = solution.at(np.nextafter(after['time'], 0.0))
        assert x == pytest.approx(after['error'], abs=1e-12)
        assert v == pytest.approx(after['before'], abs=1e-10)


def test_a_set_point_shifts_the_motion():
    t = np.linspace(0.0, 0.12, 50)
    at_zero = solve(FIG_2, ControlGains(), 1.0)
    shifted = solve(
        Plant(x_0=2.5, F_c=0.0, damping=Damping(value=0.15)), ControlGains(x_r=2.0), 1.0
    )
    assert shifted.at(t)[0] == pytest.approx(2.0 + at_zero.at(t)[0], abs=1e-15)
    assert shifted.events['position'].tolist() == [2.5, 2.0]


@pytest.mark.parametrize('split', [0.03, FIRST_ZERO, 0.2, BOUNCE_TIME])
def test_a_break_between_equal_dampings_changes_nothing(split):
    whole = one_jump(FIG_2, ControlGains(), 1.0)
    parts = one_jump(FIG_2, ControlGains(), 1.0, breaks=[split], dampings=[0.15, 0.15])
    t = np.linspace(0.0, 1.0, 101)
    assert np.abs(whole.at(t)[0] - parts.at(t)[0]).max() < 1e-14
    assert whole.events['guard'].tolist() == parts.events['guard'].tolist()


def test_an_evaluation_is_right_continuous_whatever_the_order_and_shape_of_the_times():
    solution = one_jump(FIG_2, ControlGains(), 1.0)
    zero = solution.events['time'][1]
    times = np.array([[0.9, zero, 0.0], [zero, 1.0, 0.3]])
    x, v = solution.at(times)
    assert x.shape == v.shape == (2, 3)
    assert v[0, 1] == v[1, 0] == solution.events['velocity_after'][1]
    assert v[0, 2] == pytest.approx(-3.75)
    assert [solution.at(t)[0] for t in times.ravel()] == x.ravel().tolist()
    assert np.shape(solution.at(0.5)[0]) == ()


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.1, 1.0),
    st.floats(0.1, 1.4),
    st.sampled_from([0.0, 1.0]),
    st.sampled_from([1e-5, 1e-4, 3.3e-3]),
    st.sampled_from(Reading),
)
@example(0.76171875, 0.334476067260463, 1.0, 1e-5, Reading.ONE_JUMP)
def test_on_a_sampling_grid_it_is_the_same_to_the_last_bits(x_0, d, F_c, time_step, reading):
    solution = solve(
        Plant(x_0=x_0, F_c=F_c),
        ControlGains(x_r=0.05),
        1.0,
        reading=reading,
        breaks=[0.1, 0.3],
        dampings=[d, 1.5, 0.15],
    )
    steps = int(min(0.9, solution.last) / time_step)  # its events may accumulate before
    times, positions, velocities = solution.sampled(time_step, steps)
    x, v = solution.at(times)
    assert times.tolist() == [k * time_step for k in range(steps + 1)]
    assert np.abs(positions - x).max() < 2e-15
    assert np.abs(velocities - v).max() < 2e-14


def test_a_sampling_grid_ends_where_the_solution_does():
    solution = one_jump(FIG_2, ControlGains(), 0.3)
    assert len(solution.sampled(1e-4, 3000)[0]) == 3001  # 3000 * 1e-4 > 0.3
    with pytest.raises(ParameterError, match=r'steps = 3001: must be in \[0, 3000\]'):
        solution.sampled(1e-4, 3001)
    with pytest.raises(ParameterError, match='time_step = 0.0'):
        solution.sampled(0.0, 1)
    resting = solve(FIG_2, ControlGains(), 0.3)
    assert resting.sampled(1e-2, 1000)[1][-1] == 0.0


def test_half_the_alpha_of_a_reversal_stops_in_the_origin_in_either_reading():
    for reading in Reading:
        solution = solve(FIG_2, ControlGains(alpha_ratio=0.5), 1.0, reading=reading)
        assert (solution.end, len(solution.events)) == (End.ORIGIN, 2)


def test_a_start_at_rest_in_the_set_point_stays():
    axis = Plant(x_0=1.0, F_c=1.0, damping=Damping(value=0.15))
    solution = solve(axis, ControlGains(x_r=1.0), 1.0)
    assert (solution.end, solution.end_time, len(solution.events)) == (End.ORIGIN, 0.0, 0)
    assert solution.at(50.0) == (1.0, 0.0)


def test_a_start_on_the_position_guard_jumps_at_once():
    axis = Plant(x_0=0.0, v_0=2.0, F_c=0.0, damping=Damping(value=0.15))
    assert solve(axis, ControlGains(), 1.0).end_time == 0.0
    first = one_jump(axis, ControlGains(), 1.0).events[0].tolist()
    assert first == (0.0, POSITION_ZERO, 0.0, 2.0, pytest.approx(-0.4))


def test_a_mass_taken_much_too_large_makes_the_strict_jumps_endless_and_the_bounce_grow():
    heavy = ControlGains(m=0.34, alpha_ratio=0.6)
    assert solve(FIG_2, heavy, 1.0).end is End.ENDLESS_JUMPS
    speeds = np.abs(one_jump(FIG_2, heavy, 2.0).events['velocity_after'][1::2])
    assert np.all(np.diff(speeds) > 0.0)
    grown = one_jump(FIG_2, heavy, 1e6)
    assert grown.end is End.DIVERGES
    assert grown.end_time < 1e6
    assert np.isfinite(grown.at(np.linspace(0.0, grown.end_time, 999))).all()


def test_a_limit_of_events_ends_the_solution_and_says_so():
    solution = solve(FIG_5, ControlGains(), 2.0, event_limit=100)
    whole = solve(FIG_5, ControlGains(), 2.0)
    assert solution.end is End.EVENT_LIMIT
    assert solution.events.tolist() == whole.events[:100].tolist()
    assert solution.end_time == whole.events['time'][100]
    with pytest.raises(ParameterError, match=r'time = 1\.9: must be in \[0, 0\.8'):
        solution.at(1.9)


def test_the_limits_of_the_sampled_controller_do_not_apply():
    sampled = ControlGains(
        effort_limit=1.0, position_deadband=1.0, velocity_deadband=9.0, hold_off=9, time_step=1e-3
    )
    assert solve(FIG_2, sampled, 1.0).events.tolist() == (
        solve(FIG_2, ControlGains(), 1.0).events.tolist()
    )


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        ({'duration': 0.0}, r'duration = 0\.0: must be > 0 and finite \[s\]'),
        ({'duration': math.inf}, 'duration = inf'),
        ({'event_limit': -1}, 'event_limit = -1'),
        ({'breaks': [0.2, 0.1], 'dampings': [1, 1, 1]}, r'breaks = \[0\.2, 0\.1\].*ascending'),
        ({'breaks': [0.0], 'dampings': [1, 1]}, r'breaks = \[0\.0\].*> 0 \[s\]'),
        ({'breaks': [0.1]}, r'dampings = \(1,\).*shape \(2,\)'),
        ({'dampings': [0.0]}, r'dampings = 0\.0: must be > 0 and finite \[N s/m\]'),
        ({'plant': Plant(F_c=0.0, damping=Damping(kind='noise'))}, "damping.kind = 'noise'"),
    ],
)
def test_what_makes_no_motion_is_refused(options, said):
    with pytest.raises(ParameterError, match=said):
        solve(**{'plant': FIG_2, 'gains': ControlGains(), 'duration': 1.0} | options)


# The sampled loop tends to it.


def sampled_error(step, reading, hold_off):
    """Return max abs(x - x_exact) [m]; the dampings shift the zero within its sample."""
    errors = []
    for d in np.linspace(0.1, 0.2, 11):
        axis = Plant(x_0=0.5, F_c=0.0, time_step=step, damping=Damping(value=float(d)))
        gains = ControlGains(time_step=step, hold_off=hold_off)
        run = simulate(axis, gains, 0.3)
        exact, _ = solve(axis, gains, 0.3, reading=reading).at(run.time.clip(max=0.3))
        errors.append(np.abs(run.position - exact).max())
    return max(errors)


@pytest.mark.parametrize(('reading', 'hold_off'), [(Reading.STRICT, 0), (Reading.ONE_JUMP, 8)])
def test_the_sampled_loop_converges_to_its_reading_at_first_order(reading, hold_off):
    coarse, middle, fine = (sampled_error(step, reading, hold_off) for step in (1e-3, 1e-4, 1e-5))
    assert coarse < 7e-3
    assert coarse / middle == pytest.approx(10.0, rel=0.25)
    assert middle / fine == pytest.approx(10.0, rel=0.25)


@pytest.mark.parametrize(('reading', 'hold_off'), [(Reading.ONE_JUMP, 0), (Reading.STRICT, 8)])
def test_the_sampled_loop_does_not_converge_to_the_other_reading(reading, hold_off):
    assert sampled_error(1e-5, reading, hold_off) > 0.04


def test_under_varying_damping_the_sampled_loop_converges_too():
    axis = Plant(x_0=0.5, F_c=0.0, damping=Damping(kind='sinusoidal'))
    run = simulate(axis, ControlGains(), 0.5)
    solution = solve(axis, ControlGains(), 0.5, breaks=run.time[1:-1], dampings=run.damping)
    assert solution.end is End.ORIGIN
    assert np.abs(run.position - solution.at(run.time.clip(max=0.5))[0]).max() < 5e-4
