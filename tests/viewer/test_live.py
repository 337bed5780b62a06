"""The live viewer's server: heard on this machine alone, and no harm to those who draw."""

import socket
import time

import pytest

from fishrl.viewer import Server, start_drawing
from fishrl.viewer import process as process_module
from fishrl.viewer.process import HOST, Viewer, find_port
from tests.viewer.scenes import make_frame, make_scene

FLOWS = {0: "flow 0"}


def find_listeners(port: int) -> set[str]:
    """Return the addresses, as the kernel writes them, at which a port of this machine listens."""
    found = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with open(table) as lines:
            for line in list(lines)[1:]:
                address, number = line.split()[1].split(":")
                if int(number, 16) == port and line.split()[3] == "0A":
                    found.add(address)
    return found


def test_streams_are_heard_on_this_machine_alone_and_the_end_of_the_server_harms_nobody() -> None:
    with Server(port=29400, opens_window=False) as server:
        assert server.url == f"rerun+http://127.0.0.1:{server.port}/proxy"
        web_port = int(server.page.split("?")[0].rsplit(":", 1)[1])
        for port in (server.port, web_port):
            deadline = time.monotonic() + 20.0
            while not find_listeners(port) and time.monotonic() < deadline:
                time.sleep(0.05)
            assert find_listeners(port) == {"0100007F"}  # 127.0.0.1, lowest byte first
        drawing = start_drawing(make_scene(), flows=FLOWS, url=server.url)
        drawing.draw(0, make_frame(0))
        drawing.stream.flush(timeout_sec=20.0)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((HOST, server.port), timeout=1.0)
    start = time.monotonic()
    for number in range(1, 30):
        drawing.draw(0, make_frame(number))
    drawing.close()
    assert time.monotonic() - start < 20.0


def test_a_taken_port_gives_way_to_the_next() -> None:
    with socket.socket() as taken:
        taken.bind((HOST, 0))
        taken.listen()
        first = taken.getsockname()[1]
        assert first < find_port(first) < first + 100


def test_no_port_at_all_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_module, "_MAX_PORT", 2000)
    with pytest.raises(ValueError, match="it and the hundred after it are taken"):
        find_port(2000)


def test_a_program_that_ends_at_once_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"rerun does not run on port .* with --no-such"):
        Viewer("--no-such-option", port=29500)
