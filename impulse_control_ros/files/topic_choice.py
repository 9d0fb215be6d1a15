"""Select one topic of each kind: the topics of two systems are never merged."""

from collections.abc import Collection, Sequence
from typing import NamedTuple


class Selection(NamedTuple):
    """
    The part of a bag to read; an empty field selects nothing.

    ``run`` is a number or an id, ``namespace`` the namespace of the topics, ``topics`` are full
    names, one of each kind. ``log_time`` replaces the stamps by the times of recording.
    """

    run: str = ''
    joint: str = ''
    namespace: str = ''
    topics: Sequence[str] = ()
    log_time: bool = False


def namespace_of(name: str) -> str:
    """Return the namespace of a topic or node."""
    return name.rpartition('/')[0] or '/'


def absolute(name: str) -> str:
    """Return a name with a leading slash and no trailing one."""
    return '/' + name.strip('/')


def preferred(found: Collection[str], selection: Selection, near: str = '') -> list[str]:
    """
    Return the first non-empty group of the topics ``found``, which are of one kind.

    The groups are: the selected topics, those in the selected namespace, those in the namespace
    ``near``, all.
    """
    namespaces = [near] if near else []
    if selection.namespace:
        namespaces.insert(0, absolute(selection.namespace))
    wanted = {absolute(topic) for topic in selection.topics}
    for choice in (
        [name for name in found if name in wanted],
        *([name for name in found if namespace_of(name) == one] for one in namespaces),
    ):
        if choice:
            return sorted(choice)
    return sorted(found)


def one_of(kind: str, found: Collection[str], selection: Selection, near: str = '') -> str:
    """Return the topic of a ``kind``, '' if there is none; raises ValueError for several."""
    names = preferred(found, selection, near)
    if len(names) > 1:
        raise ValueError(
            f'{kind} are on {", ".join(names)}: choose one with '
            f'--namespace {namespace_of(names[0])} or --topic {names[0]}'
        )
    return names[0] if names else ''


def require_selected(selection: Selection, topics: Collection[str]) -> None:
    """Raise ValueError if a selected topic or namespace is not among the ``topics`` of a bag."""
    named = ', '.join(sorted(topics)) or 'none'
    for topic in map(absolute, selection.topics):
        if topic not in topics:
            raise ValueError(f'topic {topic} is not in the bag; its topics: {named}')
    namespace = absolute(selection.namespace)
    if selection.namespace and namespace not in map(namespace_of, topics):
        raise ValueError(f'no topic in the namespace {namespace}; its topics: {named}')
