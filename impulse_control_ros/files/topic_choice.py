"""Which of several topics of one kind is read: two systems in a bag are never merged."""

from collections.abc import Collection, Sequence
from typing import NamedTuple


class Selection(NamedTuple):
    """
    What to read of a bag; what is empty is left to the bag.

    ``run``: number or id. ``namespace``: that of the topics. ``topics``: full names, one of a
    kind. ``log_time``: whether a message has the time at which it was recorded as its stamp.
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
    """Return a name with its slash in front, and none behind."""
    return '/' + name.strip('/')


def preferred(found: Collection[str], selection: Selection, near: str = '') -> list[str]:
    """
    Return the topics to choose from, of one kind among those ``found``.

    Those that are selected come first, then those in the namespace that is selected, then those
    in the namespace ``near``.
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
    """Return the one topic of a ``kind``, '' for none; raises ValueError for several."""
    names = preferred(found, selection, near)
    if len(names) > 1:
        raise ValueError(
            f'{kind} are on {", ".join(names)}: choose one with '
            f'--namespace {namespace_of(names[0])} or --topic {names[0]}'
        )
    return names[0] if names else ''


def require_selected(selection: Selection, topics: Collection[str]) -> None:
    """Raise ValueError for a topic or a namespace that is not among the ``topics`` of a bag."""
    named = ', '.join(sorted(topics)) or 'none'
    for topic in map(absolute, selection.topics):
        if topic not in topics:
            raise ValueError(f'topic {topic} is not in it; its topics: {named}')
    namespace = absolute(selection.namespace)
    if selection.namespace and namespace not in map(namespace_of, topics):
        raise ValueError(f'no topic in the namespace {namespace}; its topics: {named}')
