"""`pneutac doctor` names what is missing and its remedy, on a machine that lacks anything."""

import os
import sys
from types import SimpleNamespace

import pytest
from verbs import verb

from lerobot_camera_digit import digit as digit_camera
from lerobot_pneutac.verbs import doctor
from lerobot_robot_pneutac import lerobot_inside


def told(capsys) -> str:
    return " ".join(capsys.readouterr().out.split())


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")


def test_a_package_that_cannot_be_imported_is_a_row_and_not_an_end(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pneutac_sim.world", None)  # as without MuJoCo, which it imports
    with pytest.raises(SystemExit):
        verb("doctor")
    said = told(capsys)
    assert "import of pneutac_sim.world halted" in said and "HF_HOME" in said  # also what follows


def test_ports_without_permission_and_a_digit_are_told(monkeypatch, capsys, tmp_path):
    from serial.tools import list_ports

    monkeypatch.setattr(list_ports, "comports", lambda: [SimpleNamespace(device="/dev/ttyACM7")])
    monkeypatch.setattr(os, "access", lambda path, mode: "ttyACM7" not in str(path))
    usb = tmp_path / "usb"
    (usb / "1-1:1.0" / "video4linux" / "video3").mkdir(parents=True)
    for file, text in (("product", "DIGIT"), ("serial", "D20001"), ("bcdDevice", "0200")):
        (usb / file).write_text(text)
    node = tmp_path / "class" / "video3"
    node.mkdir(parents=True)
    (node / "index").write_text("0")
    (node / "device").symlink_to(usb / "1-1:1.0")
    monkeypatch.setattr(digit_camera, "SYSFS", tmp_path / "class")
    with pytest.raises(SystemExit):
        verb("doctor")
    said = told(capsys)
    assert "no permission on /dev/ttyACM7 sudo usermod -aG dialout" in said
    assert "D20001 at /dev/video3" in said


def test_a_version_that_is_not_there_is_missing(monkeypatch):
    version = doctor.importlib.metadata.version

    def without_numba(name):
        if name == "numba":
            raise doctor.importlib.metadata.PackageNotFoundError(name)
        return version(name)

    monkeypatch.setattr(doctor.importlib.metadata, "version", without_numba)
    assert ("numba", doctor.FAIL, "not installed", "uv pip install numba") == doctor.check_package("numba")


@pytest.mark.parametrize("installed", ["0.5.1", "0.7.0"])
def test_an_older_or_newer_lerobot_is_named_with_the_one_to_install(monkeypatch, installed):
    version = doctor.importlib.metadata.version
    monkeypatch.setattr(
        doctor.importlib.metadata, "version", lambda n: installed if n == "lerobot" else version(n)
    )
    remedy = "PneuTac is made for LeRobot 0.6: uv pip install 'lerobot==0.6.*'"
    assert ("lerobot", doctor.FAIL, installed, remedy) == doctor.check_package("lerobot")
    monkeypatch.undo()
    assert doctor.LEROBOT == lerobot_inside.KNOWN and doctor.check_package("lerobot")[1] == doctor.OK
