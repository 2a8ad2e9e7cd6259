"""Reports open offline and carry no NaN; the command line says what is not there yet."""

import re
import subprocess
import sys

import numpy as np
import plotly.graph_objects as go
import pytest

from lerobot_pneutac.reports.page import Report, write_result


def test_page_has_no_outside_reference_and_escapes_text(tmp_path):
    report = Report("A <title>")
    report.lead("1 < 2 and `code`")
    report.table([{"a": 1.23456, "b": None, "c": True}])
    report.image(np.zeros((4, 5, 3), np.uint8), "black")
    report.figure(go.Figure(go.Scatter(x=[0, 1], y=[0, 1])))
    page = report.write(tmp_path).read_text()
    assert (tmp_path / "report.html").is_file()
    assert "A &lt;title&gt;" in page and "1 &lt; 2 and <code>code</code>" in page and "1.235" in page
    markup = re.sub(r"<script>.*?</script>", "", page, flags=re.S)
    assert not re.search(r'(src|href)="(https?:|//)', markup) and "<script src" not in page
    assert re.search(r'Plotly.newPlot\(\s*"figure1"', page)


def test_result_refuses_nan(tmp_path):
    assert write_result(tmp_path, {"x": np.float32(1.5), "y": np.arange(2)}).read_text().count("1.5") == 1
    with pytest.raises(ValueError, match="JSON"):
        write_result(tmp_path, {"x": float("nan")})


def test_unknown_verb_lists_the_verbs():
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; sys.argv=['pneutac','fly']; from lerobot_pneutac.cli.__main__ import main; main()",
        ],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 1 and "no command 'fly'" in run.stderr and "calibrate" in run.stderr
    assert "Traceback" not in run.stderr
