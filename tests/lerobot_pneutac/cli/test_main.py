"""The command `pneutac`, whatever its verb."""

import sys
import threading

import pytest

from lerobot_pneutac import cli


def test_an_interrupt_inside_a_lock_is_an_interrupt(monkeypatch, capsys):
    def verb(argv):
        lock = threading.Lock()
        with lock:  # as where the interrupt comes between a wait's release and its taking the lock back
            lock.release()
            raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_dispatch", verb)
    monkeypatch.setattr(sys, "argv", ["pneutac", "benchmark", "policy"])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert stopped.value.code == 130
    assert capsys.readouterr().err == "pneutac: interrupted.\n"
