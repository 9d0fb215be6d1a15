"""The breadth-first search of all that can happen within a bound, and of what follows fairly."""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from test.core.protocol_model.moves import is_fed, moves
from test.core.protocol_model.recorder import require, Violation
from test.core.protocol_model.world import World

ENOUGH = 200  # moves of a fair schedule within which the plant steps


class Found(NamedTuple):
    """``worlds`` were seen; ``broken`` is the property that does not hold, '' for none."""

    worlds: int
    broken: str = ''
    trace: tuple[str, ...] = ()


def search(starts: Iterable[World], last_tick: int) -> Found:
    """Search all worlds up to ``last_tick``, shortest traces first, until a property is broken."""
    parents: dict[World, World | None] = dict.fromkeys(starts)
    queue = deque(parents)
    steps: set[World] = set()  # a fair schedule lets the plant step from here
    while queue:
        world = queue.popleft()
        try:
            for _, after in moves(world):
                if after not in parents and after.plant.tick <= last_tick:
                    parents[after] = world
                    queue.append(after)
            require_progress(world, steps)
        except Violation as broken:
            rule, *what = map(str, broken.args)
            return Found(len(parents), rule, (*trace(world, parents), ' '.join(what)))
    return Found(len(parents))


def require_progress(world: World, steps: set[World]) -> None:
    """Follow the fair schedule until the plant steps, if plant and a controller live."""
    path, at = [], world
    while at.plant.tick == world.plant.tick and at not in steps and is_fed(at):
        path.append(at)
        at = next(moves(at))[1]
        require(len(path) < ENOUGH, '2: the plant steps whenever it and a controller live')
    steps.update(path)


def trace(world: World, parents: dict[World, World | None]) -> list[str]:
    """Return what has led to a world."""
    before = parents[world]
    if before is None:
        return [f'start with {world.bound}']
    what = next(what for what, after in moves(before) if after == world)
    spent = [
        f'({name})'
        for name, left in world.bound._asdict().items()
        if left < getattr(before.bound, name)
    ]
    return [*trace(before, parents), ' '.join(map(str, (*what, *spent)))]
