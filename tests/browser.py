"""Headless Chromium, which logs what pages ask for."""

import json
import os
import shutil
from contextlib import contextmanager
from importlib.util import find_spec

import pytest


@contextmanager
def chromium(profile):
    """A driver with nothing open; tests are skipped without Chromium or Selenium."""
    binary, chromedriver = shutil.which("chromium"), shutil.which("chromedriver")
    if not binary or not chromedriver or not find_spec("selenium"):
        reason = "needs the apt packages chromium and chromium-driver and the extra dev"
        if os.environ.get("SWEEPOPT_BROWSER") == "required":
            pytest.fail(reason)
        pytest.skip(reason)
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    disabled = ["gpu", "dev-shm-usage", "quic", "background-networking", "component-update"]
    switches = ["headless", "no-sandbox", "no-first-run", "window-size=1400,900"]
    switches += [f"disable-{part}" for part in (*disabled, "sync")]
    for switch in (*switches, f"user-data-dir={profile}"):
        options.add_argument(f"--{switch}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(chromedriver)
    with webdriver.Chrome(options=options, service=service) as driver:
        driver.set_page_load_timeout(300)
        driver.set_script_timeout(300)
        driver.get("about:blank")  # leaves Chromium's own first page
        driver.get_log("performance")
        yield driver


def requested(driver):
    """Addresses that pages have asked for since."""
    events = [json.loads(each["message"])["message"] for each in driver.get_log("performance")]
    return [
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    ]
