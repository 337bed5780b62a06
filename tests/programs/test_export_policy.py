"""Uploads of an exported policy."""

import socket

import pytest

from fishrl.programs.export_policy import upload
from fishrl.zoo import find_policy


def test_a_hub_that_does_not_answer_is_an_error_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", f"http://127.0.0.1:{port}")
    with pytest.raises(OSError, match=r"^upload = me/fish: .*refused$"):
        upload(find_policy("predation_small"), "me/fish")
