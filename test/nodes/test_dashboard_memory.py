"""An open dashboard, for a long time: its memory, and the impulses that it counts."""

from itertools import cycle
import os
from pathlib import Path
import re
import time

import numpy as np
import pytest
from std_srvs.srv import SetBool

from impulse_control_ros.files.recording import read_bag
from test.chromium import needs_chromium, open_chromium
from test.nodes.dashboard_page import Page, start_dashboard
from test.processes import CONFIG

MINUTES = float(os.environ.get('DASHBOARD_MINUTES', '30'))
PERIOD = 5.0  # s between set-points and between samples of the memory
GROWTH = 1.1  # of the last quarter over the second one

pytestmark = [needs_chromium, pytest.mark.soak]


def descendants(pid):
    """Return a process and all below it."""
    found = [pid]
    for parent in found:
        for task in Path(f'/proc/{parent}/task').glob('*/children'):
            found += map(int, task.read_text().split())
    return found


def resident(pids):
    """
    Return the memory of processes [MB], what they share counted once.

    Mapped files are left out: their share is another whenever another browser starts or ends.
    """
    total = 0
    for pid in pids:
        try:
            rollup = Path(f'/proc/{pid}/smaps_rollup').read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        total += sum(int(size) for size in re.findall(r'Pss_(?:Anon|Shmem): +(\d+)', rollup))
    return total / 1024


def test_memory_is_flat_and_no_impulse_is_lost(graph, client, tmp_path):
    dashboard, found = start_dashboard(graph)
    process = graph.start(
        'closed_loop',
        config=CONFIG / 'axis.yaml',
        **{'recorder:bag': tmp_path / 'bag', 'plant_simulator:start_paused': True},
    )
    browser = open_chromium(tmp_path / 'profile', with_logs=False)  # which would grow
    try:
        page = Page(browser, found[1])
        page.field('controller.K', '10')
        client.call('/plant_simulator/pause', SetBool, data=False)
        memory, heap = [], []
        began = time.monotonic()
        for setpoint in cycle((0.2, 0.0)):
            if time.monotonic() > began + 60.0 * MINUTES:
                break
            client.set('controller', x_r=setpoint)
            time.sleep(PERIOD)
            browser.execute_cdp_cmd('HeapProfiler.collectGarbage', {})
            server = resident([dashboard.pid])
            memory.append((server, resident(descendants(browser.service.process.pid))))
            heap.append(page.run('return performance.memory.usedJSHeapSize') / 2**20)
            print(
                f'{time.monotonic() - began:.0f} s: server, browser, script', *memory[-1], heap[-1]
            )
        client.call('/plant_simulator/pause', SetBool, data=True)
        page.until(
            "return document.getElementById('reports').textContent.includes('resume')", 'it'
        )
        fired = sum(page.run('return Object.values(lastFrame.fired)'))
        lost = page.run('return lastFrame.lost')
    finally:
        browser.quit()
    assert process.interrupt() == 0
    assert dashboard.interrupt() == 0
    quarters = [np.median(part, axis=0) for part in np.array_split(np.array(memory), 4)]
    print('memory [MB] of server and browser by quarters', quarters, fired, 'impulses')
    assert (fired, lost) == (len(read_bag(tmp_path / 'bag').impulses), 0)
    assert (quarters[3] < GROWTH * quarters[1]).all()
