"""The studio's address: who may open a connection, who may not, and one that is taken."""

import socket

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from lerobot_pneutac.studio.app import Studio
from pneutac_sim.errors import InputError


@pytest.fixture
def studio():
    studio = Studio(port=0)
    yield studio
    studio.close()


@pytest.mark.parametrize(
    "origin", [None, "http://localhost:9000", "http://127.0.0.1:8080", "http://localhost"]
)
def test_programs_and_pages_of_this_machine_come_in(studio, origin):
    address = studio.address.replace("http", "ws")
    with connect(address, origin=origin, compression=None, subprotocols=["viser-v1.1.1"]) as connection:
        assert connection.protocol.state.name == "OPEN"


@pytest.mark.parametrize(
    "origin",
    ["http://elsewhere.example", "http://localhost.elsewhere.example:8080", "null", "https://localhost"],
)
def test_pages_of_other_sites_do_not(studio, origin):
    with pytest.raises(InvalidStatus, match="403"):
        connect(studio.address.replace("http", "ws"), origin=origin, compression=None)


def test_other_machines_do_not(studio):
    port = studio.server.get_port()
    assert studio.server.get_host() == "127.0.0.1"
    own = next((a[4][0] for a in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)), "127.0.0.1")
    if own.startswith("127."):
        pytest.skip("this machine has no address in a network")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((own, port), timeout=5)


def test_a_port_in_use_is_one_sentence_and_a_closed_one_is_free():
    first = Studio(port=0)
    port = first.server.get_port()
    with pytest.raises(
        InputError, match=rf"port={port} cannot be had \(Address already in use\); .*--port=0"
    ):
        Studio(port)
    first.close()
    again = Studio(port)
    assert again.server.get_port() == port
    again.close()
