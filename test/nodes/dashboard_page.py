"""The dashboard in a browser."""

import re

from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from test.processes import wait_for

ADDRESS = re.compile(r'open (http://127\.0\.0\.1:(\d+)/)')


def start_dashboard(graph, port=0):
    made = graph.start('dashboard', '--no-browser', '--port', port)
    made.says('open http')
    return made, ADDRESS.search(made.output)


class Page:
    """The dashboard in the browser."""

    def __init__(self, browser, address):
        self.browser = browser
        browser.get(address)
        self.until("return document.body.dataset.ready === 'yes'", 'frames')

    def run(self, script, *arguments):
        return self.browser.execute_script(script, *arguments)

    def until(self, script, what, *arguments):
        return wait_for(lambda: self.run(script, *arguments), what)

    def field(self, name, value):
        """Wait until the field of a parameter shows ``value``."""
        self.until(
            'return document.getElementById(arguments[0])?.value === arguments[1]',
            f'{name} = {value}, not {self.value(name)}',
            name,
            value,
        )

    def value(self, name):
        return self.run('return document.getElementById(arguments[0])?.value', name)

    def enter(self, name, value):
        field = wait_for(lambda: self.browser.find_elements(By.ID, name), name)[0]
        self.run('arguments[0].select()', field)
        field.send_keys(value, Keys.ENTER)

    def slider(self, name):
        return self.browser.find_element(
            By.CSS_SELECTOR, f'[data-name="{name}"] input[type=range]'
        )

    def press(self, what):
        """Press a button, and return what the page says of it."""
        self.run("document.getElementById('said').textContent = ''")
        self.browser.find_element(By.CSS_SELECTOR, f'button[data-do="{what}"]').click()
        return self.until("return document.getElementById('said').textContent", what)

    def undo(self, change):
        """Press Undo once it offers to set ``change`` back, as in 'K = 10.0'."""
        self.until(
            "const {disabled, title} = document.getElementById('undo');"
            'return !disabled && title.endsWith(arguments[0])',
            f'undo of {change}',
            change,
        )
        self.browser.find_element(By.ID, 'undo').click()

    def text(self, name):
        return self.run('return document.getElementById(arguments[0]).textContent', name)

    @property
    def time(self):
        return float(self.run('return document.body.dataset.time') or 0.0)

    def column(self, source, name):
        return self.run(
            'return Bokeh.documents[0].get_model_by_name(arguments[0]).data[arguments[1]]',
            source,
            name,
        )
