"""Headless Chromium, driven by selenium."""

from pathlib import Path
import shutil

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service

CHROMIUM = (
    shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which('google-chrome')
)
CHROMEDRIVER = shutil.which('chromedriver')
SWITCHES = (
    '--headless=new',
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--window-size=1280,900',
)
needs_chromium = pytest.mark.skipif(
    not (CHROMIUM and CHROMEDRIVER),
    reason='no chromium and chromedriver: apt-get install chromium chromium-driver',
)


def open_chromium(profile: Path, with_logs: bool = True) -> webdriver.Chrome:
    """Return a browser; it keeps logs of its console and of all that it requests."""
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for switch in (*SWITCHES, f'--user-data-dir={profile}'):
        options.add_argument(switch)
    if with_logs:
        options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    driver = webdriver.Chrome(options=options, service=Service(CHROMEDRIVER))
    if with_logs:
        driver.execute_cdp_cmd('Network.enable', {})
    return driver
