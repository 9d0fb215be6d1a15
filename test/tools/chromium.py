"""Pages of our reports in Chromium, without a network."""

from collections.abc import Iterator
import json
from pathlib import Path

from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from test.chromium import open_chromium

PATIENCE = 120.0


class Page:
    """A page in the browser."""

    def __init__(self, browser, path):
        self.browser = browser
        browser.get_log('performance')
        browser.get(path.as_uri())
        self.until('return document.body.dataset.ready === "yes"')

    def run(self, script, *arguments):
        return self.browser.execute_script(script, *arguments)

    def until(self, script, *arguments):
        WebDriverWait(self.browser, PATIENCE).until(lambda _: self.run(script, *arguments))

    def traces(self, plot, **wanted):
        """Return name, key and points of the traces of a plot that have these attributes."""
        found = self.run(
            'return document.getElementById(arguments[0]).data.map((one) => '
            '({name: one.name, meta: one.meta, mode: one.mode, x: one.x, y: one.y}))',
            plot,
        )
        return [one for one in found if all(one[key] == value for key, value in wanted.items())]

    def zoom(self, plot, **ranges):
        self.run(
            'const [plot, ranges] = arguments; return Plotly.relayout(plot, ranges)',
            plot,
            {name.replace('_', '.'): value for name, value in ranges.items()},
        )

    def requests(self):
        """Return what was asked of the network or of a file since the page was opened."""
        messages = [
            json.loads(entry['message'])['message']
            for entry in self.browser.get_log('performance')
        ]
        return [
            message['params']['request']['url']
            for message in messages
            if message['method'] == 'Network.requestWillBeSent'
        ]

    def click(self, name):
        self.browser.find_element(By.CSS_SELECTOR, f'#legend [data-name="{name}"]').click()


def offline(profile: Path) -> Iterator[webdriver.Chrome]:
    """Yield a browser with a fresh profile."""
    driver = open_chromium(profile)
    driver.execute_cdp_cmd(
        'Network.emulateNetworkConditions',
        {'offline': True, 'latency': 0, 'downloadThroughput': 0, 'uploadThroughput': 0},
    )
    yield driver
    driver.quit()
