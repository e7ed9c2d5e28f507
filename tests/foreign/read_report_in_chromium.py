"""Opens report pages in headless Chromium over its debugging pipe and says, as JSON, what a reader would meet.

Standard library only. Usage: read_report_in_chromium.py CHROMIUM PAGE.html
"""

import base64
import json
import os
import subprocess
import sys
import tempfile


class Browser:
    """One page of one browser, driven by the DevTools protocol on file descriptors 3 (to it) and 4 (from it)."""

    def __init__(self, chromium, profile):
        to_read, self.to_write = os.pipe()
        self.from_read, from_write = os.pipe()

        def wire():
            # Beyond the numbers in use first, so that one does not overwrite the other.
            a, b = os.dup(to_read), os.dup(from_write)
            os.dup2(a, 3)
            os.dup2(b, 4)

        self.process = subprocess.Popen(
            [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe",
             "--user-data-dir=" + profile],
            preexec_fn=wire, close_fds=False, stderr=subprocess.DEVNULL)
        os.close(to_read)
        os.close(from_write)
        self.buffer, self.number, self.events, self.session = b"", 0, [], None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def receive(self):
        while b"\0" not in self.buffer:
            part = os.read(self.from_read, 1 << 16)
            if not part:
                raise SystemExit("the browser went away")
            self.buffer += part
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, **parameters):
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to_write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise SystemExit(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def wait_for(self, method):
        while not any(e.get("method") == method for e in self.events):
            self.events.append(self.receive())

    def value(self, expression):
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def key(self, name, code):
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code)

    def close(self):
        self.session = None
        self.call("Browser.close")
        self.process.wait()


def complaints(events):
    out = []
    for e in events:
        p = e.get("params", {})
        if e.get("method") == "Runtime.exceptionThrown":
            out.append(p["exceptionDetails"].get("text", "exception"))
        elif e.get("method") == "Runtime.consoleAPICalled" and p["type"] in ("error", "assert"):
            out.append("console." + p["type"])
        elif e.get("method") == "Log.entryAdded" and p["entry"]["level"] == "error":
            out.append(p["entry"]["text"])
    return out


def read(browser, page):
    for domain in ("Page", "Runtime", "Log", "Network"):
        browser.call(domain + ".enable")
    browser.call("Page.navigate", url="file://" + os.path.abspath(page))
    browser.wait_for("Page.loadEventFired")
    out = {"heading": browser.value("document.querySelector('h1').textContent")}
    # By keyboard alone: Tab until the time slider has the focus, then to its start and three steps on.
    tabs = 0
    while browser.value("document.activeElement.id") != "time" and tabs < 50:
        browser.key("Tab", 9)
        tabs += 1
    out["reached_by_tab"] = browser.value("document.activeElement.id") == "time"
    out["times"] = []
    browser.key("Home", 36)
    out["times"].append(browser.value("document.getElementById('now').textContent"))
    for _ in range(3):
        browser.key("ArrowRight", 39)
    out["times"].append(browser.value("document.getElementById('now').textContent"))
    browser.call("Emulation.setDeviceMetricsOverride", width=360, height=740, deviceScaleFactor=2, mobile=True)
    out["phone_width_px"] = browser.value("document.documentElement.scrollWidth")
    browser.call("Emulation.clearDeviceMetricsOverride")
    browser.call("Emulation.setEmulatedMedia", media="print")
    out["slider_in_print"] = browser.value("getComputedStyle(document.getElementById('time')).display")
    browser.call("Emulation.setEmulatedMedia", media="")
    pdf = base64.b64decode(browser.call("Page.printToPDF")["data"])
    out["prints"] = pdf.startswith(b"%PDF") and len(pdf) > 2000
    sent = [e["params"]["request"]["url"] for e in browser.events if e.get("method") == "Network.requestWillBeSent"]
    out["network"] = [u for u in sent if not u.startswith(("file:", "data:"))]
    out["complaints"] = complaints(browser.events)
    return out


def main():
    chromium, page = sys.argv[1:]
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(chromium, profile)
        print(json.dumps(read(browser, page)))
        browser.close()


main()
