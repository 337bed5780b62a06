"""Policies of the Hugging Face Hub, from a local server that answers as the hub does."""

from __future__ import annotations

import json
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest
import torch

from fishrl.training import load_plan, load_policy
from fishrl.zoo import fetch_policy, find_policy

COMMIT, NAME = "0123456789" * 4, "me/fish"


class _Hub(BaseHTTPRequestHandler):
    """Serves ``NAME`` at ``COMMIT``, with files of ``served``."""

    served: dict[str, bytes]
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        api, files = f"/api/models/{NAME}/", f"/{NAME}/resolve/{COMMIT}/"
        content, tag = None, "none"
        if path == f"{api}revision/main":
            content = json.dumps({"id": NAME, "sha": COMMIT, "siblings": []}).encode()
        elif path == f"{api}tree/{COMMIT}":
            entries = [
                {"type": "file", "path": name, "size": len(data), "oid": f"{index:040d}"}
                for index, (name, data) in enumerate(self.served.items())
            ]
            content = json.dumps(entries).encode()
        elif path.startswith(files) and path.removeprefix(files) in self.served:
            name = path.removeprefix(files)
            content, tag = self.served[name], f"{[*self.served].index(name):040d}"
        self.send_response(404 if content is None else 200)
        self.send_header("Content-Length", str(len(content or b"")))
        self.send_header("Content-Type", "application/json")
        self.send_header("ETag", f'"{tag}"')
        self.send_header("X-Repo-Commit", COMMIT)
        self.end_headers()
        if self.command == "GET" and content:
            self.wfile.write(content)

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, bytes]]:
    """Return the files of a hub, by name; those of a policy of the zoo to begin with."""
    folder = find_policy("predation_pair")
    _Hub.served = {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Hub)
    Thread(target=server.serve_forever, daemon=True).start()
    place = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    constants = "huggingface_hub.constants"
    monkeypatch.setattr(f"{constants}.ENDPOINT", place)
    template = place + "/{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(f"{constants}.HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(f"{constants}.HF_HUB_CACHE", str(tmp_path / "cache"))
    yield _Hub.served
    server.shutdown()
    server.server_close()


def test_policy_of_the_hub_is_that_which_was_uploaded(hub: dict[str, bytes]) -> None:
    hub["setup.py"] = b"raise SystemExit"
    name = f"hub:{NAME}"
    assert load_plan(name).to_config() == load_plan("zoo/predation_pair").to_config()
    theirs, ours = (load_policy(each).state_dict() for each in (name, "zoo/predation_pair"))
    assert all(torch.equal(theirs[key], value) for key, value in ours.items())
    assert not (fetch_policy(name) / "setup.py").exists()


def test_damaged_policy_of_the_hub_is_refused(hub: dict[str, bytes]) -> None:
    hub["components/0000-actor/state.pt"] = b"other weights"
    with pytest.raises(ValueError, match=r"state\.pt has changed since it was written"):
        load_policy(f"hub:{NAME}")


@pytest.mark.usefixtures("hub")
def test_missing_policy_of_the_hub_is_named_in_one_line() -> None:
    with pytest.raises(OSError, match=r"^hub:me/none: [^\n]+$"):
        load_policy("hub:me/none")
    with pytest.raises(ValueError, match="me/none/of"):
        load_policy("hub:me/none/of")
