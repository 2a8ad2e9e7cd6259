"""The studio's session: versions to look at and to go back to, one work at a time, twins of other devices.

The studio's address: who may open a connection, who may not, and one that is taken.

A body in real time is the pipeline's, its links are its kinematics, and its skin goes with them.
"""

import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from verbs import refused
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from lerobot_pneutac.studio.app import Session, Studio
from lerobot_pneutac.studio.live import LiveBody, Shape, links
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.errors import InputError
from pneutac_sim.finger.stages import forward_kinematics_spatial
from pneutac_sim.twin import PAPER_FINGER, Twin, Value

GOLDEN = Path(__file__).parents[2] / "golden" / "recordings"


@pytest.fixture
def folder(tmp_path):
    twin = Twin.builtin()
    errors = {"train": 2.0, "heldout": 2.2, "unit": "mm", "seed": 3}
    twin.save_version(tmp_path / "finger", "calibrated", "bench", errors)
    twin.effects["creep"] = get_effect("creep").start(15.0)
    twin.save_version(tmp_path / "finger", "added creep", "bench", errors | {"heldout": 0.6})
    return tmp_path / "finger"


def test_looking_writes_nothing_and_going_back_loses_nothing(folder):
    session, told = Session(folder, None), []
    session.when_changed(lambda: told.append(session.version))
    before = (folder / "twin.yaml").read_bytes()
    session.look_at(0)
    assert not session.twin.effects and (folder / "twin.yaml").read_bytes() == before
    session.keep()
    history = Twin.load(folder).history
    assert [e["change"] for e in history] == ["calibrated", "added creep", "back to version 0: calibrated"]
    assert history[2]["heldout"] == 2.2 and history[2]["seed"] == 3 and not Twin.load(folder).effects
    session.look_at(1)
    session.keep()  # and forth
    assert "creep" in Twin.load(folder).effects and told == [0, None, 1, None]
    with pytest.raises(InputError, match="choose an earlier one"):
        session.keep()


def test_a_misspelt_folder_is_told_before_there_is_an_address(folder, tmp_path, capsys):
    refused("no twin at", "studio", twin=tmp_path / "nothing", port=0)
    refused("no bench recording at", "studio", twin=folder, recording=tmp_path / "nothing", port=0)
    assert capsys.readouterr().out == ""


def test_one_work_at_a_time(folder):
    session, go, done = Session(folder, None), threading.Event(), threading.Event()
    session.begin("diagnosing", lambda show: go.wait(60), print, print)
    with pytest.raises(InputError, match="Still diagnosing"):
        session.begin("trying", lambda show: None, print, print)
    go.set()
    end = time.monotonic() + 60
    while session.working and time.monotonic() < end:
        time.sleep(0.01)
    session.begin("trying", lambda show: done.set(), print, print)
    assert done.wait(60)


def test_what_does_not_go_together_is_refused(folder, tmp_path):
    with pytest.raises(InputError, match="no twin at"):
        Session(tmp_path / "nothing", None)
    with pytest.raises(InputError, match="--recording=DIR"):
        Session(folder, None).needs_recording()
    with pytest.raises(InputError, match="give it by --demonstrations="):
        Session(folder, GOLDEN / "demos")
    arm = tmp_path / "arm"
    arm.mkdir()
    (arm / "recording.json").write_text('{"device": "arm", "length_mm": 180, "samples": "samples.csv"}')
    head = (
        "trial,time_s,pressure_cmd_1_kpa,pressure_cmd_2_kpa,pressure_cmd_3_kpa,tip_x_mm,tip_y_mm,tip_z_mm\n"
    )
    rows = "".join(f"0,{i / 10},{i},0,0,{180 - i},0,{i}\n" for i in range(30))
    (arm / "samples.csv").write_text(head + rows)
    with pytest.raises(InputError, match="open a twin with a recording of its own device"):
        Session(folder, arm)


@pytest.fixture
def studio():
    studio = Studio(port=0)
    yield studio
    studio.close()


@pytest.mark.parametrize("origin", [None, "http://localhost:9000", "http://127.0.0.1:8080"])
def test_programs_and_pages_of_this_machine_come_in(studio, origin):
    address = studio.address.replace("http", "ws")
    with connect(address, origin=origin, compression=None, subprotocols=["viser-v1.1.1"]) as connection:
        assert connection.protocol.state.name == "OPEN"


@pytest.mark.parametrize(
    "origin",
    ["http://localhost.elsewhere.example:8080", "null"],
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


FINGER = Twin.builtin()
AT = np.array(FINGER.spine_joint_positions_mm)


def test_links_end_where_the_kinematics_says():
    q = np.random.default_rng(0).normal(0, 0.4, (4, 2))
    shape = Shape(*links(q, AT), np.zeros(5))
    tip, _ = forward_kinematics_spatial(q[None], AT, FINGER.length_mm)
    np.testing.assert_allclose(shape.spine_mm(FINGER.length_mm, AT)[-1], tip[0], atol=1e-9)
    np.testing.assert_allclose(
        shape.turns @ shape.turns.transpose(0, 2, 1), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12
    )


def test_a_poke_bends_towards_where_it_pushes_as_springs_do():
    stiff = FINGER.copy()
    stiff.parameters["joint_stiffness_nm_per_rad"] = Value(100 * PAPER_FINGER["joint_stiffness_nm_per_rad"])
    free = LiveBody(stiff, {}).step(np.zeros(1), np.zeros(3), 0.1)
    poked = LiveBody(stiff, {}).step(np.zeros(1), np.array([0.0, 0.0, 0.1]), 0.1)
    # small angles: each joint turns by F lever / K, and moves the tip by lever times that
    levers = free.markers[0] - free.places_mm[1:, 0]
    moved = 0.1 * (1e-3 * levers**2).sum() / stiff.parameter("joint_stiffness_nm_per_rad")
    np.testing.assert_allclose(poked.markers[2] - free.markers[2], moved, rtol=0.03)
