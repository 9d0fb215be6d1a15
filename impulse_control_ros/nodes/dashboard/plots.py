"""The plots of the page, drawn by BokehJS; the page fills their two data sources."""

from collections.abc import Callable
from typing import Any

from bokeh.embed import components
from bokeh.model import Model
from bokeh.models import (
    BasicTicker,
    ColumnDataSource,
    DataRange1d,
    PanTool,
    ResetTool,
    WheelZoomTool,
)
from bokeh.models.annotations import BoxAnnotation, Span
from bokeh.plotting import figure
from bokeh.transform import factor_cmap, factor_mark

from impulse_control_ros.core.control_law import GUARDS
from impulse_control_ros.core.live_run import IMPULSE, SAMPLE

LINE, SETPOINT = '#0072B2', '#D55E00'
COLORS, MARKERS = ('#CC79A7', '#009E73', '#E69F00'), ('circle', 'diamond', 'square')
WINDOW = 10.0  # s shown
# what the lines show: plot, column, and whether it is a set-point
LINES = (
    ('position', 'setpoint', True),
    ('position', 'position', False),
    ('velocity', 'velocity', False),
    ('effort', 'feedback', False),
    ('effort', 'effort', False),  # instead of the feedback of an unknown law
)


def plots() -> tuple[str, dict[str, str]]:
    """Return the script that draws the plots, and the element of each by name."""
    samples = ColumnDataSource({name: [] for name in SAMPLE}, name='samples')
    impulses = ColumnDataSource({name: [] for name in IMPULSE}, name='impulses')
    time = DataRange1d(follow='end', follow_interval=WINDOW, range_padding=0.0)
    made = {
        'position': _plot('time [s]', 'position [m]', x_range=time),
        'velocity': _plot('time [s]', 'velocity [m/s]', x_range=time),
        'effort': _plot('time [s]', 'effort [N]', x_range=time),
        'impulse': _plot('time [s]', 'area [N s]', x_range=time),
        'phase': _plot('error [m]', 'velocity [m/s]'),
    }
    for name, column, is_setpoint in LINES:
        line: dict[str, Any] = {'x': 'time', 'y': column, 'source': samples, 'name': column}
        if is_setpoint:
            made[name].step(**line, mode='after', color=SETPOINT, line_dash='dashed')
        else:
            made[name].line(**line, color=LINE, line_width=1.5, visible=column != 'effort')
    _draw_phases(made['phase'], samples, impulses)
    for name, column in (('position',) * 2, ('velocity',) * 2, ('impulse', 'area')):
        _mark(made[name], 'time', column, impulses)
    for name in ('position', 'velocity', 'phase'):
        made[name].add_layout(
            BoxAnnotation(
                name=f'{name}_band',
                visible=False,  # until it is known
                fill_alpha=0.15,
                fill_color=SETPOINT,
                line_color=None,
            )
        )
    models: dict[str, Model] = {**made}
    script, elements = components(models, wrap_script=False)
    # it warns of the ranges of a plot that has no data yet
    return f"Bokeh.set_log_level('error');\n{script}", elements


def _draw_phases(plot: figure, samples: ColumnDataSource, impulses: ColumnDataSource) -> None:
    """Draw the phase portrait, its guards e = 0 and v = 0, and the jumps."""
    plot.line('error', 'velocity', source=samples, color=LINE, alpha=0.7)
    jumps = _by_guard(factor_cmap, COLORS)
    plot.segment('error', 'velocity', 'error', 'after', source=impulses, color=jumps)
    _mark(plot, 'error', 'velocity', impulses)
    for dimension in ('height', 'width'):
        plot.add_layout(Span(location=0, dimension=dimension, line_color='gray', line_alpha=0.5))


def _by_guard(mapped: Callable[..., Any], values: tuple[str, ...]) -> Any:
    return mapped('guard', values, GUARDS[1:])


def _mark(plot: figure, x: str, y: str, impulses: ColumnDataSource) -> None:
    """Mark the impulses, by guard."""
    plot.scatter(
        x,
        y,
        source=impulses,
        size=5,
        line_color=None,
        marker=_by_guard(factor_mark, MARKERS),
        fill_color=_by_guard(factor_cmap, COLORS),
    )


def _plot(x: str, y: str, **options: Any) -> figure:
    """Return an empty plot that lets finger and wheel scroll the page."""
    plot = figure(
        x_axis_label=x,
        y_axis_label=y,
        height=200,
        sizing_mode='stretch_width',
        tools=[PanTool(), WheelZoomTool(), ResetTool()],
        active_drag=None,
        active_scroll=None,
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
        y_range=DataRange1d(only_visible=True),
        **options,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.xaxis.ticker = BasicTicker(desired_num_ticks=4)  # labels of small numbers are long
    plot.grid.grid_line_color = 'gray'
    plot.grid.grid_line_alpha = 0.25
    return plot
