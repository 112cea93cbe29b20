"""Uses the page of a farm as people do, in a headless Chromium, and looks at what they would see."""

import argparse
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import sync_playwright

import steps
from farm import Farm, Proxy

CHROMIUM = "/usr/bin/chromium"


class Visit:
    """A page of the browser, and what went wrong in it."""

    def __init__(self, browser, farm, proxy, screenshots):
        self.farm, self.proxy, self.screenshots = farm, proxy, screenshots
        self.page = browser.new_page(viewport={"width": 1180, "height": 900}, color_scheme="light")
        self.page.set_default_timeout(60_000)
        self.errors = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self.hear)
        self.page.on("request", self.check_host)
        self.page.on("dialog", lambda dialog: dialog.accept())

    def hear(self, message):
        # A farm that is away, or asks for a token, is no fault of the page.
        if message.type == "error" and "Failed to load resource" not in message.text:
            self.errors.append(message.text)

    def check_host(self, request):
        if not request.url.startswith(self.proxy.url):
            self.errors.append(f"the page asked for {request.url}")

    def go(self, place):
        self.page.goto(self.proxy.url + place)

    def picture(self, name):
        if self.screenshots:
            self.page.screenshot(path=Path(self.screenshots) / f"page-{name}.jpg", type="jpeg", quality=85)


@contextmanager
def timed(name, times):
    begun = time.monotonic()
    yield
    times.append((time.monotonic() - begun, name))
    print(f"{times[-1][0]:6.1f} s  {name}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bin", required=True)
    parser.add_argument("--screenshots")
    options = parser.parse_args()
    scenes = Path(__file__).resolve().parents[2] / "scenes"
    farm = Farm(options.bin)
    proxy = Proxy(lambda: farm.port)
    times = []
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            visit = Visit(browser, farm, proxy, options.screenshots)
            for step in steps.ALL:
                with timed(step.__doc__, times):
                    step(visit, scenes)
                assert not visit.errors, visit.errors
            browser.close()
    except BaseException:
        print(farm.tail(), file=sys.stderr)
        raise
    finally:
        proxy.end()
        farm.end()
    print(f"{sum(seconds for seconds, _ in times):6.1f} s  in all")


if __name__ == "__main__":
    main()
