"""The daemon under test, and what it says over HTTP."""

import json
import os
import re
import subprocess
import threading
import urllib.request

PATIENCE_S = 60


class Daemon:
    """`plumb serve` with `config`; ends with the block."""

    def __init__(self, binary, config, folder, **environment):
        file = folder / "plumb.toml"
        file.write_text(f'[store]\npath = "{folder / "store"}"\n' + config)
        command = [binary, "serve", "--config", file, "--listen", "127.0.0.1:0"]
        environment = {**os.environ, "RUST_LOG": "info", **environment}
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        self.log = []

    def __enter__(self):
        for line in self.process.stderr:
            self.log.append(line)
            found = re.search(r"http://[\d.:]+", line)
            if found:
                self.address = found[0]
                threading.Thread(target=lambda: self.log.extend(self.process.stderr), daemon=True).start()
                return self
        raise AssertionError("".join(self.log))

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait(timeout=30)

    def ask(self, path, body=None):
        """The answer to a GET, or to a POST of `body`."""
        sent = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, sent, {"content-type": "application/json"})
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
            return json.loads(answer.read())

    def events(self, camera):
        """What happens to the camera from now on: pairs of the kind and the event."""
        stream = urllib.request.urlopen(f"{self.address}/v1/events?camera={camera}", timeout=PATIENCE_S)

        def each():
            kind = None
            for line in stream:
                name, _, value = line.decode().rstrip("\n").partition(": ")
                if name == "event":
                    kind = value
                elif name == "data":
                    yield kind, json.loads(value)

        return each()

    def wait_for_state(self, events, camera, wanted):
        """The camera's status once it is `wanted`: asked for now, and after each of its events that says that it changed."""
        status = self.ask(f"/v1/cameras/{camera}")
        while not wanted(status):
            next(event for kind, event in events if kind == "camera")
            status = self.ask(f"/v1/cameras/{camera}")
        return status
