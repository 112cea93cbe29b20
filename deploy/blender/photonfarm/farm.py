"""A farm over HTTP: sends a scene, follows the job, fetches its picture. Nothing of Blender is needed here."""

import json
import ssl
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid

from . import blake3

PATIENCE = 30.0
ATTEMPTS = 5


class FarmError(Exception):
    """The farm refuses, or cannot be reached; the text says what to do next."""

    def __init__(self, text, code=None):
        super().__init__(text)
        self.code = code


class Unreachable(FarmError):
    """Nobody answers there now."""


class Farm:
    """A farm at an address, used with a token, if there is one."""

    def __init__(self, address, token="", authority=""):
        parts = urllib.parse.urlsplit(address.strip())
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise FarmError(f"{address!r} is no address of a farm; it looks like http://127.0.0.1:7800. Set it in the add-on's preferences")
        self.address, self.token = address.strip().rstrip("/"), token.strip()
        self.local = parts.hostname in ("127.0.0.1", "localhost", "::1")
        try:
            self.trust = ssl.create_default_context(cafile=authority or None) if parts.scheme == "https" else None
        except OSError as error:
            raise FarmError(f"The certificate {authority} cannot be read ({error}). Choose another file in the add-on's preferences") from error

    def _ask(self, method, path, body=None, kind=None, headers=()):
        request = urllib.request.Request(f"{self.address}/v1/{path}", data=body, method=method)
        if self.token:
            request.add_header("Authorization", f"Bearer {self.token}")
        if kind:
            request.add_header("Content-Type", kind)
        for name, value in dict(headers).items():
            request.add_header(name, value)
        for attempt in range(ATTEMPTS):
            try:
                with urllib.request.urlopen(request, timeout=PATIENCE, context=self.trust) as reply:
                    return reply.read(), reply.headers
            except urllib.error.HTTPError as error:
                problem = _problem(error)
                if not problem.get("retryable") or attempt == ATTEMPTS - 1:
                    raise FarmError(_advice(problem, error.code, self.address), problem.get("code")) from error
                time.sleep(min(float(problem.get("retry_after_s") or 1), 10.0))
            except (urllib.error.URLError, OSError) as error:
                reason = getattr(error, "reason", error)
                raise Unreachable(
                    f"No farm answers at {self.address} ({reason}). Is its coordinator running, and is the address in the add-on's preferences right?"
                ) from error
        raise AssertionError("the last attempt returns or raises")

    def _json(self, method, path, value=None, headers=()):
        body = json.dumps(value).encode() if value is not None else None
        reply, _ = self._ask(method, path, body, "application/json" if body else None, headers)
        return json.loads(reply)

    def send(self, files):
        """Sends a scene, of names and bytes, as far as the farm lacks it. Returns the name of the bundle."""
        hashes = {name: blake3.hexdigest(content) for name, content in files.items()}
        manifest = {name: {"hash": hashes[name], "bytes": len(content)} for name, content in files.items()}
        reply = self._json("POST", "bundles", {"files": manifest})
        contents = {hashes[name]: content for name, content in files.items()}
        for missing in reply["missing"]:
            self._ask("PUT", f"blobs/{missing}", contents[missing], "application/octet-stream")
        return reply["bundle"]

    def submit(self, spec):
        """Makes a job; its status. Sending it twice makes one."""
        return self._json("POST", "jobs", spec, {"Idempotency-Key": f"blender-{uuid.uuid4()}"})

    def status(self, job):
        """How far a job has come."""
        return self._json("GET", f"jobs/{job}")

    def picture(self, job):
        """The picture as it stands, as OpenEXR; none before the first iteration."""
        try:
            return self._ask("GET", f"jobs/{job}/image.exr")[0]
        except FarmError as error:
            if error.code == "no-image-yet":
                return None
            raise

    def cancel(self, job):
        """Ends a job. What has arrived stays."""
        return self._json("POST", f"jobs/{job}/cancel")


def _problem(error):
    try:
        problem = json.loads(error.read())
    except (ValueError, OSError):
        problem = None
    return problem if isinstance(problem, dict) else {}


def _advice(problem, status, address):
    text = problem.get("detail") or problem.get("title") or f"the answer was HTTP {status}"
    match problem.get("code"):
        case "unauthorized":
            return f"The farm does not know the token: {text}. Set a valid one in the add-on's preferences"
        case "forbidden":
            return f"The token does not allow it: {text}. Ask the farm's operator for one with the role submit"
        case "quota":
            return f"The token's quota is used up: {text}. Delete old jobs, or ask the farm's operator"
        case "limit":
            return f"The scene is beyond a limit of the farm: {text}"
        case None:
            return f"What answers at {address} is no Photonfarm ({text}). Check the address in the add-on's preferences"
    return f"The farm refuses: {text}"
