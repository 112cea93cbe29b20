"""A farm of processes for a test: a coordinator with tokens, workers, and a proxy that puts it under a path prefix."""

import http.client
import http.server
import json
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
import urllib.request
from pathlib import Path

PATIENCE = 60


def wait_for(what, condition, patience=PATIENCE):
    """Waits until a condition holds, and returns what it gave."""
    last = time.monotonic() + patience
    while time.monotonic() < last:
        found = condition()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError(f"waited {patience} s for {what}")


class Farm:
    """Processes of a farm in a temporary folder."""

    def __init__(self, programs):
        self.programs = Path(programs)
        self.folder = Path(tempfile.mkdtemp(prefix="photonfarm-page-"))
        self.processes = []
        self.log = open(self.folder / "log", "wb")
        self.admin = self.token("boss", "admin", ["--data", self.folder / "data"])
        self.coordinator = None
        self.port = 0
        self.serve()
        # Through the farm, since a data folder belongs to one process.
        by_admin = ["--coordinator", self.url, "--token-file", self.file("boss", self.admin)]
        self.artist = self.token("artist", "submit", by_admin)
        self.worker_file = self.file("rack", self.token("rack", "worker", by_admin))

    @property
    def url(self):
        return f"http://127.0.0.1:{self.port}"

    def file(self, name, content):
        path = self.folder / f"{name}.token"
        path.write_text(content)
        path.chmod(0o600)
        return path

    def token(self, name, role, where):
        command = [self.programs / "photonfarm", "token", "create", name, "--role", role, *where]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def start(self, *command, **options):
        process = subprocess.Popen([str(part) for part in command], stderr=self.log, **options)
        self.processes.append(process)
        return process

    def serve(self):
        """Starts the coordinator: on the port that it had, if it had one."""
        self.coordinator = self.start(
            self.programs / "photonfarm", "serve", "--listen", f"127.0.0.1:{self.port}", "--data", self.folder / "data",
            "--lease-seconds", "1", stdout=subprocess.PIPE, text=True,
        )
        self.port = int(self.coordinator.stdout.readline().strip().rsplit(":", 1)[1])

    def kill_coordinator(self):
        self.coordinator.send_signal(signal.SIGKILL)
        self.coordinator.wait()

    def work(self, number):
        return self.start(
            self.programs / "photonfarm-worker", "--coordinator", self.url, "--token-file", self.worker_file,
            "--threads", "1", "--name", f"rack-{number}", "--cache", self.folder / f"cache-{number}", stdout=self.log,
        )

    def ask(self, path, method="GET", body=None):
        request = urllib.request.Request(f"{self.url}/v1/{path}", method=method)
        request.add_header("authorization", f"Bearer {self.admin}")
        if body is not None:
            request.add_header("content-type", "application/json")
            request.data = json.dumps(body).encode()
        with urllib.request.urlopen(request, timeout=20) as reply:
            return reply.read()

    def job(self, number):
        return json.loads(self.ask(f"jobs/{number}"))

    def end(self):
        for process in self.processes:
            if process.poll() is None:
                process.kill()
            process.wait()
        self.log.close()
        shutil.rmtree(self.folder, ignore_errors=True)

    def tail(self):
        return (self.folder / "log").read_text(errors="replace")[-4000:]


class Proxy:
    """Puts the farm under a path prefix, as nginx would."""

    PREFIX = "/renders/farm"

    def __init__(self, port_of_farm):
        proxy = self

        class Handler(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_):
                pass

            def forward(self):
                if not self.path.startswith(proxy.PREFIX + "/"):
                    return self.send_error(404)
                body = self.rfile.read(int(self.headers.get("content-length", 0)))
                farm = http.client.HTTPConnection("127.0.0.1", port_of_farm(), timeout=120)
                headers = {name: value for name, value in self.headers.items() if name.lower() != "connection"}
                try:
                    farm.request(self.command, self.path[len(proxy.PREFIX):], body, headers)
                    answer = farm.getresponse()
                except OSError:
                    return self.send_error(502)
                self.send_response(answer.status)
                for name, value in answer.getheaders():
                    if name.lower() not in ("transfer-encoding", "connection", "date"):
                        self.send_header(name, value)
                self.send_header("connection", "close")
                self.end_headers()
                self.close_connection = True
                try:
                    while piece := answer.read1(65536):
                        self.wfile.write(piece)
                        self.wfile.flush()
                except (OSError, http.client.HTTPException):
                    pass
                finally:
                    farm.close()

            do_GET = do_POST = do_PUT = do_DELETE = do_HEAD = forward

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}{self.PREFIX}/"

    def end(self):
        self.server.shutdown()
