"""Opens report pages in headless Chromium over its debugging pipe and says, as JSON, what a reader would meet.

Standard library only. Usage:
    read_report_in_chromium.py CHROMIUM PAGE.html
    read_report_in_chromium.py CHROMIUM --pictures NEW_FOLDER OLD_FOLDER PAGE.html...
The second form writes a picture of the first screen of every page to NEW_FOLDER and compares it with that in OLD_FOLDER.
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
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        return answer["result"].get("value")

    def media(self, media="", scheme="light"):
        self.call("Emulation.setEmulatedMedia", media=media, features=[{"name": "prefers-color-scheme", "value": scheme}])

    def screen(self, width, height, mobile=False):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)

    def open(self, page):
        self.events = [e for e in self.events if e.get("method") != "Page.loadEventFired"]
        self.call("Page.navigate", url="file://" + os.path.abspath(page))
        self.wait_for("Page.loadEventFired")

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


# Words that a reader sees without scrolling.
FIRST_SCREEN = """(() => {
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), seen = [], range = document.createRange();
  while (walk.nextNode()) {
    range.selectNodeContents(walk.currentNode);
    const box = range.getBoundingClientRect();
    if (box.width && box.bottom <= innerHeight) seen.push(walk.currentNode.textContent);
  }
  return seen.join(" ").split(/\\s+/).join(" ");
})()"""

# A page on which nothing stands.
BLANK = """(() => {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [1100, 760];
  const pen = canvas.getContext("2d");
  pen.fillStyle = "white";
  pen.fillRect(0, 0, 1100, 760);
  return canvas.toDataURL("image/png").split(",")[1];
})()"""

# Mean difference of two pictures, from 0 to 1, each shrunk so that single letters do not count.
DIFFERENCE = """(async () => {
  const small = async data => {
    const image = new Image();
    image.src = "data:image/png;base64," + data;
    await image.decode();
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [110, 76];
    const pen = canvas.getContext("2d");
    pen.drawImage(image, 0, 0, 110, 76);
    return pen.getImageData(0, 0, 110, 76).data;
  };
  const [a, b] = [await small("%s"), await small("%s")];
  let sum = 0;
  a.forEach((x, i) => { sum += Math.abs(x - b[i]); });
  return sum / (255 * 0.75 * a.length);
})()"""


def pictures(browser, new, old, pages):
    """Pictures of the first screens, what they say, and how far they are from those in the folder `old`."""
    for domain in ("Page", "Runtime", "Log", "Network"):
        browser.call(domain + ".enable")
    out = {}
    for page in pages:
        name = os.path.splitext(os.path.basename(page))[0]
        browser.screen(1100, 760)
        browser.media()
        browser.open(page)
        seen = {"first_screen": browser.value(FIRST_SCREEN)}
        data = browser.call("Page.captureScreenshot", format="png")["data"]
        with open(os.path.join(new, name + ".png"), "wb") as file:
            file.write(base64.b64decode(data))
        # A measure that takes a blank page or another report for this one measures nothing.
        references = {"blank": browser.value(BLANK)}
        for file_name in sorted(os.listdir(old)):
            with open(os.path.join(old, file_name), "rb") as file:
                references[os.path.splitext(file_name)[0]] = base64.b64encode(file.read()).decode()
        differences = {key: browser.value(DIFFERENCE % (data, before)) for key, before in references.items()}
        seen["difference"] = differences.pop(name, None)
        seen["difference_of_others"] = min(differences.values())
        seen["dark"] = dark(browser)
        browser.screen(360, 740, mobile=True)
        seen["phone_width_px"] = browser.value("document.documentElement.scrollWidth")
        for suffix, shown in (("phone", (360, 740)), ("dark", (1100, 760))):
            browser.screen(*shown)
            browser.media(scheme="dark" if suffix == "dark" else "light")
            data = browser.call("Page.captureScreenshot", format="png")["data"]
            with open(os.path.join(new, name + "-" + suffix + ".png"), "wb") as file:
                file.write(base64.b64decode(data))
        out[name] = seen
    return out


def dark(browser):
    """Whether a reader who asks for dark pages gets light ink on dark paper."""
    browser.media(scheme="dark")
    style = "getComputedStyle(document.body).%s.match(/\\d+/g).slice(0,3).reduce((a,x)=>a+ +x,0)"
    ink, paper = browser.value(style % "color"), browser.value(style % "backgroundColor")
    browser.media()
    return ink > 600 and paper < 150


def read(browser, page):
    for domain in ("Page", "Runtime", "Log", "Network"):
        browser.call(domain + ".enable")
    browser.open(page)
    out = {"heading": browser.value("document.querySelector('h1').textContent")}
    # By keyboard alone: Tab until the time slider has the focus, then to its start and three steps on.
    tabs = 0
    while browser.value("document.activeElement.id") != "time" and tabs < 50:
        browser.key("Tab", 9)
        tabs += 1
    out["reached_by_tab"] = browser.value("document.activeElement.id") == "time"
    out["times"] = []
    out["times"].append(browser.value("document.getElementById('now').textContent"))
    browser.key("Home", 36)
    out["times"].append(browser.value("document.getElementById('now').textContent"))
    for _ in range(3):
        browser.key("ArrowRight", 39)
    out["times"].append(browser.value("document.getElementById('now').textContent"))
    out["dark"] = dark(browser)
    browser.screen(360, 740, mobile=True)
    out["phone_width_px"] = browser.value("document.documentElement.scrollWidth")
    browser.call("Emulation.clearDeviceMetricsOverride")
    browser.media("print")
    out["slider_in_print"] = browser.value("getComputedStyle(document.getElementById('time')).display")
    browser.media()
    pdf = base64.b64decode(browser.call("Page.printToPDF")["data"])
    out["prints"] = pdf.startswith(b"%PDF") and len(pdf) > 2000
    sent = [e["params"]["request"]["url"] for e in browser.events if e.get("method") == "Network.requestWillBeSent"]
    out["network"] = [u for u in sent if not u.startswith(("file:", "data:"))]
    out["complaints"] = complaints(browser.events)
    return out


def main():
    chromium, *rest = sys.argv[1:]
    with tempfile.TemporaryDirectory() as profile:
        browser = Browser(chromium, profile)
        if rest[0] == "--pictures":
            new, old, *pages = rest[1:]
            print(json.dumps(pictures(browser, new, old, pages)))
        else:
            print(json.dumps(read(browser, rest[0])))
        browser.close()


main()
