"""The studio's door: who comes in, who does not, and an address that is taken."""

import http.client
import http.server
import threading

import pytest

from lerobot_pneutac.studio.front import SAYS, front_page
from lerobot_pneutac.studio.gate import ALIVE, Gate
from pneutac_sim.errors import InputError


class _Page(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Length", "5")
        self.end_headers()
        self.wfile.write(b"inner")

    def log_message(self, *_):
        pass


@pytest.fixture
def inner():
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Page)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield server.server_address[1]
    server.shutdown()


def _get(port, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.request("GET", path, headers=headers)
    reply = connection.getresponse()
    return reply.status, reply.read().decode(), reply.headers


def test_this_machine_comes_in_and_a_foreign_page_does_not(inner):
    gate = Gate("127.0.0.1", 0, inner)
    try:
        here = f"127.0.0.1:{gate.port}"
        assert _get(gate.port)[:2] == (200, "inner")
        assert _get(gate.port, Origin=f"http://{here}")[0] == 200
        assert _get(gate.port, Origin="http://elsewhere.example")[0] == 403
        assert _get(gate.port, Host="elsewhere.example")[0] == 403  # a name that was rebound to this machine
    finally:
        gate.close()


def test_other_machines_show_the_token_once(inner):
    gate = Gate("0.0.0.0", 0, inner, token="secret")
    try:
        assert _get(gate.port)[0] == 403
        assert _get(gate.port, "/?token=wrong")[0] == 403
        status, _, headers = _get(gate.port, "/?token=secret")
        assert status == 303 and headers["Location"] == "/"
        cookie = headers["Set-Cookie"].partition(";")[0]
        assert _get(gate.port, Cookie=f"other=1; {cookie}")[:2] == (200, "inner")
        assert _get(gate.port, Cookie=cookie[:-1])[0] == 403
    finally:
        gate.close()


def test_the_viewers_page_also_watches_for_its_server():
    page = front_page().decode()
    assert SAYS in page and f'fetch("{ALIVE}"' in page and 'id="root"' in page


def test_the_page_is_the_gates_own_and_the_rest_the_viewers(inner):
    gate = Gate("0.0.0.0", 0, inner, token="secret", page=b"own")
    try:
        assert _get(gate.port)[0] == 403 and _get(gate.port, ALIVE)[0] == 403
        cookie = {"Cookie": "pneutac_studio=secret"}
        assert _get(gate.port, "/?fixedDpr=1", **cookie)[:2] == (200, "own")
        assert _get(gate.port, ALIVE, **cookie)[0] == 204
        assert _get(gate.port, "/font.woff", **cookie)[:2] == (200, "inner")
    finally:
        gate.close()


def test_an_address_in_use_is_one_sentence_and_a_closed_one_is_free(inner):
    gate = Gate("127.0.0.1", 0, inner)
    with pytest.raises(
        InputError, match=rf"port={gate.port} .* cannot be had \(Address already in use\); .*--port=0"
    ):
        Gate("127.0.0.1", gate.port, inner)
    with pytest.raises(InputError, match="host=no.such.host.invalid is no address"):
        Gate("no.such.host.invalid", 0, inner)
    gate.close()
    Gate("127.0.0.1", gate.port, inner).close()
