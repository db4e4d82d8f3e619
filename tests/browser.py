"""A headless Chromium, asked through its own pipe (the DevTools protocol), without any package."""

import contextlib
import json
import os
import shutil
import subprocess
import tempfile

FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run")
FLAGS += ("--disable-background-networking", "--remote-debugging-pipe")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

NAMED_KEYS = {" ": ("Space", 32), "ArrowLeft": ("ArrowLeft", 37), "ArrowRight": ("ArrowRight", 39)}


class Browser:
    """One page of a Chromium, and what went wrong in it."""

    def __init__(self, folder):
        self.number, self.faults, self.requests = 0, [], []
        command_read, self.commands = os.pipe()
        self.answers, answer_write = os.pipe()
        # The pipe's ends are descriptors 3 and 4 of the browser.
        start = f'exec "$@" 3<&{command_read} 4>&{answer_write}'
        command = [CHROMIUM, *FLAGS, f"--user-data-dir={folder}", "about:blank"]
        self.process = subprocess.Popen(
            ["bash", "-c", start, "bash", *command],
            pass_fds=(command_read, answer_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(command_read)
        os.close(answer_write)
        self.rest, self.session = b"", None
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.ask(f"{domain}.enable")

    def close(self):
        with contextlib.suppress(OSError):
            os.close(self.commands)
        self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.answers)

    def ask(self, method, **params):
        """The result of one command."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self.number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def open(self, address, width=1200, height=900):
        """Load a page and wait for it."""
        self.size(width, height)
        self.requests.clear()
        self.ask("Page.navigate", url=address)
        while not self._loaded(address):
            self._next()

    def size(self, width, height):
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def value(self, expression):
        """What an expression of JavaScript, maybe a promise, comes to."""
        result = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def press(self, key):
        """Press and release a key."""
        code, number = NAMED_KEYS.get(key, (key, ord(key[0])))
        common = {"key": key, "code": code, "windowsVirtualKeyCode": number}
        self.ask("Input.dispatchKeyEvent", type="keyDown", text=key if len(key) == 1 else "", **common)
        self.ask("Input.dispatchKeyEvent", type="keyUp", **common)

    def _loaded(self, address):
        try:
            tree = self.ask("Page.getFrameTree")["frameTree"]["frame"]
        except AssertionError:
            return False
        ready = self.ask("Runtime.evaluate", expression="document.readyState", returnByValue=True)
        return tree["url"].startswith(address.split("#")[0]) and ready["result"].get("value") == "complete"

    def _next(self):
        """The next message; what it says of faults and requests is kept."""
        while b"\0" not in self.rest:
            piece = os.read(self.answers, 1 << 16)
            assert piece, "the browser has ended"
            self.rest += piece
        raw, self.rest = self.rest.split(b"\0", 1)
        message = json.loads(raw)
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.faults.append(params["exceptionDetails"])
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.faults.append(params["entry"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        return message


@contextlib.contextmanager
def browser():
    """A browser for the time of a block."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        opened = Browser(folder)
        try:
            yield opened
        finally:
            opened.close()
