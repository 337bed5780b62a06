"""An exported policy is uploaded to a hub as it lies in its folder."""

import base64
import json
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from fishrl.programs.export_policy import upload
from fishrl.zoo import find_policy


class LocalHub(ThreadingHTTPServer):
    """Takes a new repository and one commit, as the Hugging Face Hub does."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Answer)
        self.url = f"http://127.0.0.1:{self.server_port}"
        self.files: dict[str, bytes] = {}

    def answer(self, path: str, body: bytes) -> dict[str, Any]:
        if path == "/api/repos/create":
            return {"url": f"{self.url}/me/fish"}
        if path.endswith("/me/fish/preupload/main"):
            names = [file["path"] for file in json.loads(body)["files"]]
            return {
                "files": [
                    {"path": n, "uploadMode": "regular", "shouldIgnore": False} for n in names
                ]
            }
        if path.endswith("/me/fish/commit/main"):
            lines = [json.loads(line) for line in body.splitlines()]
            for file in (line["value"] for line in lines if line["key"] == "file"):
                self.files[file["path"]] = base64.b64decode(file["content"])
            return {"commitOid": "1" * 40, "commitUrl": f"{self.url}/me/fish/commit/{'1' * 40}"}
        return {}


class Answer(BaseHTTPRequestHandler):
    server: LocalHub

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        content = json.dumps(self.server.answer(self.path, body)).encode()
        self.send_response(200)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *words: object) -> None:
        """Stay quiet."""


@pytest.fixture(autouse=True)
def direct(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ask no proxy."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalHub]:
    with LocalHub() as server:
        monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", server.url)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def test_every_file_of_the_folder_arrives(hub: LocalHub) -> None:
    folder = find_policy("predation_small")
    assert upload(folder, "me/fish").startswith(f"{hub.url}/me/fish/commit/")
    files = (file for file in folder.rglob("*") if file.is_file())
    assert hub.files == {str(file.relative_to(folder)): file.read_bytes() for file in files}


def test_a_hub_that_does_not_answer_is_an_error_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", f"http://127.0.0.1:{port}")
    with pytest.raises(OSError, match=r"^upload = me/fish: .*refused$"):
        upload(find_policy("predation_small"), "me/fish")
