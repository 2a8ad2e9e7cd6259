"""Who may import whom, and which packages are declared: the same checks as `make lint`."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent


@pytest.mark.parametrize("command", [["lint-imports"], ["deptry", "--no-ansi", "."]], ids=lambda c: c[0])
def test_imports_keep_to_the_contracts(command):
    """Layers, no circles, a physics without LeRobot; every imported package is declared."""
    done = subprocess.run(
        [BIN / command[0], *command[1:]], cwd=ROOT, text=True, capture_output=True, timeout=300
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
