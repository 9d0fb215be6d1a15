"""
The layouts for Foxglove and PlotJuggler, against a real bag.

Neither application is on PyPI. What they make of a layout is written down here from the sources
of Lichtblick (the open successor of Foxglove Studio) and PlotJuggler.
"""

import json
import re
from xml.etree import ElementTree

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from test.conftest import ROOT

FOXGLOVE = json.loads((ROOT / 'layouts' / 'foxglove.json').read_text())
PLOTJUGGLER = ElementTree.parse(ROOT / 'layouts' / 'plotjuggler.xml').getroot()
PANELS = FOXGLOVE['configById']
MESSAGE_PATH = re.compile(r'(?P<topic>/[\w/]+)(?P<fields>(\.\w+(\[\d+\])?)+)')
NUMBERS = {'float64', 'float32', 'uint8', 'int32', 'uint32'}


@pytest.fixture(scope='module')
def summary(recorded):
    with (recorded / 'left' / 'left_0.mcap').open('rb') as stream:
        return make_reader(stream).get_summary()


@pytest.fixture(scope='module')
def topics(summary):
    """Return the schema of each topic, as it is without the namespace of the bag."""
    return {
        channel.topic.removeprefix('/left'): summary.schemas[channel.schema_id]
        for channel in summary.channels.values()
    }


@pytest.fixture(scope='module')
def messages(recorded):
    """Return the decoded messages of each topic."""
    found = {}
    with (recorded / 'left' / 'left_0.mcap').open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, _, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic.removeprefix('/left'), []).append(decoded)
    return found


# -- Foxglove -----------------------------------------------------------------------------------


def leaves(node):
    if isinstance(node, str):
        return [node]
    assert node['direction'] in ('row', 'column')
    assert 0 < node['splitPercentage'] < 100
    return leaves(node['first']) + leaves(node['second'])


def message_paths():
    for panel in PANELS.values():
        for path in [*panel.get('paths', ()), *filter(None, [panel.get('xAxisPath')])]:
            assert path['enabled'] is True
            yield path['value']


def type_at(path, topics):
    """Return the basic type that a message path leads to by the definitions in the bag."""
    match = MESSAGE_PATH.fullmatch(path)
    schema = topics[match['topic']]
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schema.data.decode(), schema.name))
    kind = (Nodetype.NAME, schema.name)
    for name, index in re.findall(r'\.(\w+)(\[\d+\])?', match['fields']):
        kind = dict(store.fielddefs[kind[1]][1])[name]
        if index:
            assert kind[0] == Nodetype.SEQUENCE
            kind = kind[1][0]
    assert kind[0] == Nodetype.BASE
    return kind[1][0]


def test_each_panel_has_one_place_in_the_tree():
    assert sorted(leaves(FOXGLOVE['layout'])) == sorted(PANELS)
    assert FOXGLOVE.keys() == {
        'configById',
        'globalVariables',
        'userNodes',
        'playbackConfig',
        'layout',
    }


def test_the_panels_are_of_known_types():
    assert {panel.split('!')[0] for panel in PANELS} == {
        'Plot',
        'StateTransitions',
        'DiagnosticSummary',
        'Parameters',
    }


def test_each_message_path_leads_to_a_number_or_a_name(topics):
    paths = list(message_paths())
    assert len(paths) > 8
    for path in paths:
        expected = {'string'} if path.endswith('frame_id') else NUMBERS
        assert type_at(path, topics) in expected, path


def test_each_indexed_field_is_filled_in_real_messages(messages):
    for topic, field in re.findall(r'(/\w+)\.(\w+)\[0\]', ' '.join(message_paths())):
        assert all(len(getattr(message, field)) == 1 for message in messages[topic])


def test_the_phase_portrait_pairs_fields_of_one_topic():
    panel = PANELS['Plot!phase']
    assert panel['xAxisVal'] == 'custom'
    assert {path['value'].split('.')[0] for path in panel['paths']} == {
        panel['xAxisPath']['value'].split('.')[0]
    }


def test_the_diagnostics_panel_shows_a_topic_of_diagnostics(topics):
    topic = PANELS['DiagnosticSummary!nodes']['topicToRender']
    assert topics[topic].name == 'diagnostic_msgs/msg/DiagnosticArray'


# -- PlotJuggler --------------------------------------------------------------------------------


def curves_of(messages, topics):
    """Return the names of the numeric curves that PlotJuggler makes of a bag."""
    names = {
        f'{topic}/data'
        for topic, schema in topics.items()
        if schema.name == 'std_msgs/msg/Float64'
    }
    for topic, decoded in messages.items():
        kind = topics[topic].name
        for message in decoded:
            if kind == 'sensor_msgs/msg/JointState':
                names |= {
                    f'{topic}/{joint}/{field}'
                    for field in ('position', 'velocity', 'effort')
                    for joint, _ in zip(message.name, getattr(message, field), strict=False)
                }
            elif kind == 'diagnostic_msgs/msg/DiagnosticArray':
                names |= {
                    f'{topic}/{status.hardware_id}/{status.name.removeprefix("/left")}/{value.key}'
                    for status in message.status
                    for value in status.values
                }
    return names


def test_each_curve_is_one_that_plotjuggler_makes_of_a_bag(messages, topics):
    known = curves_of(messages, topics)
    curves = list(PLOTJUGGLER.iter('curve'))
    assert len(curves) > 10
    for curve in curves:
        wanted = (
            {curve.get('curve_x'), curve.get('curve_y')}
            if curve.get('curve_x')
            else {curve.get('name')}
        )
        assert wanted <= known


def test_a_plot_over_another_curve_is_an_xy_plot_and_no_other():
    modes = {plot.get('mode'): plot for plot in PLOTJUGGLER.iter('plot')}
    assert modes.keys() == {'TimeSeries', 'XYPlot'}
    for plot in PLOTJUGGLER.iter('plot'):
        for curve in plot.iter('curve'):
            assert ('curve_x' in curve.attrib) == (plot.get('mode') == 'XYPlot')


def test_each_splitter_has_as_many_parts_and_sizes_as_it_says():
    assert [
        (widget.get('name'), widget.get('parent')) for widget in PLOTJUGGLER.iter('tabbed_widget')
    ] == [('Main Window', 'main_window')]
    for splitter in PLOTJUGGLER.iter('DockSplitter'):
        assert splitter.get('orientation') in ('|', '-')
        assert int(splitter.get('count')) == len(splitter)
        assert len(splitter.get('sizes').split(';')) == len(splitter)
    for area in PLOTJUGGLER.iter('DockArea'):
        assert [child.tag for child in area] == ['plot']
