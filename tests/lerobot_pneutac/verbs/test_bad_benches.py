"""Whatever a verb refuses of a bench recording, `check` says first; no bad fit is stored, no output lost."""

import contextlib
import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from lerobot_pneutac.cli import main, run_verb
from lerobot_pneutac.study import study_of
from lerobot_pneutac.study.pair import load_pair
from lerobot_pneutac.verbs.calibrate import calibrate
from lerobot_pneutac.verbs.check import check_path
from lerobot_pneutac.verbs.compare import compare
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin, Value
from pneutac_sim.world.arms import ARMS
from pneutac_sim.world.station import Station


def table(n=600):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(0, 20, n // 40), 40).round(2)
    s = {"trial": np.repeat([0, 1], n // 2), "time_s": np.tile(np.arange(n // 2) / 20, 2)}
    s |= {"pressure_cmd_kpa": u, "bend_angle_rad": 0.02 * (u + 3) + 0.002 * rng.normal(size=n)}
    return pd.DataFrame(s)


def write(folder, samples, **meta):
    folder.mkdir(parents=True, exist_ok=True)
    samples.to_csv(folder / "samples.csv", index=False)
    (folder / "recording.json").write_text(json.dumps({"device": "finger", "length_mm": 100} | meta))
    return folder


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twin")
    twin = replace(Twin.builtin(), length_mm=100.0)
    twin.parameters["gain_rad_per_kpa"] = Value(0.005)
    return twin.save(folder)


BAD = {
    "no pressure": lambda s: s.assign(pressure_cmd_kpa=0.0),
    "one pressure": lambda s: s.assign(pressure_cmd_kpa=12.7),
    "five rows at rest": lambda s: s.head(5),
    "two rows": lambda s: s.iloc[[0, 300]],
    "thirteen rows": lambda s: s.iloc[:600:50],
    "no pose": lambda s: s.drop(columns="bend_angle_rad"),
    "a pose that stands": lambda s: s.assign(bend_angle_rad=0.1),
    "time goes back": lambda s: s.assign(time_s=-s.time_s),
    "milliseconds": lambda s: s.assign(pressure_cmd_kpa=3000 * s.pressure_cmd_kpa),
    "degrees": lambda s: s.assign(bend_angle_rad=1000 * s.bend_angle_rad),
    "no trial": lambda s: s.drop(columns="trial"),
    "no command": lambda s: s.rename(columns={"pressure_cmd_kpa": "pressure_kpa"}),
    "an empty cell": lambda s: s.assign(bend_angle_rad=s.bend_angle_rad.where(s.index != 7)),
    "a trial that comes back": lambda s: s.assign(trial=(s.index // 100 % 2)),
    "no rows": lambda s: s.head(0),
}


def refused(call):
    try:
        call()
    except InputError as e:
        return str(e)
    return ""


@pytest.mark.parametrize("bad", BAD)
def test_check_says_first_what_a_verb_refuses(bad, twin, tmp_path):
    folder = write(tmp_path / "r", BAD[bad](table()))
    said = {
        "calibrate": refused(lambda: calibrate(*load_pair(twin, folder, "fit"))),
        "compare": refused(lambda: compare(*load_pair(twin, folder, "compare"))),
        "diagnose": refused(lambda: study_of(*load_pair(twin, folder, "diagnose"))),
    }
    faults = check_path(folder).faults
    assert any(said.values()) and faults
    for sentence in filter(None, said.values()):
        assert any(sentence == f or re.split(r"; | Missing|, and fitting", sentence)[0] in f for f in faults)


def test_a_good_recording_is_refused_by_none(twin, tmp_path):
    folder = write(tmp_path / "r", table())
    assert check_path(folder).faults == []
    found = calibrate(*load_pair(twin, folder, "fit"))
    assert found.worse == "" and found.error["heldout"] < 0.003


def test_a_calibration_alone_takes_a_twin_without_its_gain_and_finds_it(tmp_path, twin, capsys):
    folder, recording = tmp_path / "twin", write(tmp_path / "bench", table())
    without = Twin.load(twin)
    del without.parameters["gain_rad_per_kpa"]
    without.save(folder)
    given = [f"--twin={folder}", f"--recording={recording}"]
    verbs = ["compare"], ["diagnose"], ["add", "--effect=creep"], ["learn", "--bench=standin", "--out=o"]
    for verb, *more in verbs:
        with pytest.raises(InputError, match="twin.yaml: body: gain_rad_per_kpa is missing; `pneutac cal"):
            run_verb(verb, given[: 1 if verb == "learn" else 2] + more)
    run_verb("calibrate", given)
    said = " ".join(capsys.readouterr().out.split())
    assert f"note: {folder / 'twin.yaml'} has no gain_rad_per_kpa; the fit begins at defaults." in said
    assert 4 * Twin.load(folder).parameter("gain_rad_per_kpa") == pytest.approx(0.02, rel=0.02)


def test_a_fit_that_is_worse_than_the_twin_was_is_not_stored(twin, tmp_path, monkeypatch):
    folder, copy = write(tmp_path / "r", table()), tmp_path / "twin"
    shutil.copytree(twin, copy)
    found = calibrate(*load_pair(copy, folder, "fit"))
    object.__setattr__(found, "before", found.error["heldout"] / 1.5)
    with pytest.raises(InputError, match=r"Nothing was stored: .* and the twin as it was by"):
        found.save(copy)
    monkeypatch.setattr("lerobot_pneutac.verbs.calibrate.calibrate", lambda *a, **k: found)
    argv = ["pneutac", "calibrate", f"--twin={copy}", f"--recording={folder}", f"--out={tmp_path / 'out'}"]
    monkeypatch.setattr(sys, "argv", argv)
    with pytest.raises(SystemExit, match="Nothing was stored"):
        main()
    assert Twin.load(copy).history == [] and (tmp_path / "out" / "result.json").is_file()


@pytest.mark.parametrize("verb", ["compare"])
def test_results_are_written_before_anyone_stops_reading(verb, twin, tmp_path, monkeypatch):
    """As `pneutac compare --out=O | head -1`: the first line that is printed breaks the pipe."""
    folder, copy = write(tmp_path / "r", table()), tmp_path / "twin"
    shutil.copytree(twin, copy)

    class Closed:
        encoding = "utf-8"

        def write(self, text):
            if text:
                raise BrokenPipeError

        def flush(self):
            pass

        def isatty(self):
            return False

        def fileno(self):
            raise OSError

    out = tmp_path / "out"
    argv = ["pneutac", verb, f"--twin={copy}", f"--recording={folder}", f"--out={out}"]
    monkeypatch.setattr(sys, "argv", argv)
    with monkeypatch.context() as m, contextlib.suppress(SystemExit, OSError, BrokenPipeError):
        m.setattr(sys, "stdout", Closed())
        main()
    assert (out / "result.json").is_file() and (out / "report.html").is_file()


@pytest.mark.parametrize("verb", ["compare", "calibrate", "diagnose"])
def test_out_is_tried_before_the_work(verb, twin, tmp_path, monkeypatch):
    folder = write(tmp_path / "r", table())
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file" / "out", tmp_path / ("x" * 300)):
        argv = ["pneutac", verb, f"--twin={twin}", f"--recording={folder}", f"--out={out}"]
        monkeypatch.setattr(sys, "argv", argv)
        with pytest.raises(SystemExit, match=r"--out=.* cannot be written \(.*\); choose another folder"):
            main()


def test_a_folder_that_cannot_be_read_or_written_is_one_sentence(twin, tmp_path, monkeypatch):
    folder = write(tmp_path / "r", table())

    def denied(*_args, **_options):
        raise PermissionError(13, "Permission denied", str(folder / "samples.csv"))

    monkeypatch.setattr("pandas.read_csv", denied)
    for argv in (["compare", f"--twin={twin}", f"--recording={folder}"], ["check", str(folder)]):
        monkeypatch.setattr(sys, "argv", ["pneutac", *argv])
        with pytest.raises(SystemExit) as e:
            main()
        assert "samples.csv" in str(e.value) and "Permission denied" in str(e.value)


def test_commands_to_copy_are_quoted(tmp_path, monkeypatch, capsys):
    folder, twin = write(tmp_path / "Übung 1" / "Messung", table()), tmp_path / "Übung 1" / "Zwilling"
    monkeypatch.setattr(sys, "argv", ["pneutac", "new", f"--twin={twin}", f"--recording={folder}"])
    main()
    assert f"pneutac calibrate '--twin={twin}' '--recording={folder}'" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"pneutac new --twin='.*Übung 2'"):
        Twin.load(tmp_path / "Übung 2")


def station(folder, **fields):
    (folder / "station.yaml").write_text(yaml.safe_dump({"format": "pneutac-station/1"} | fields))
    return check_path(folder / "station.yaml").faults


@pytest.mark.parametrize("name", ["workspace_low_m", "home_m"])
def test_a_station_in_millimetres_is_named(name, tmp_path):
    faults = station(tmp_path, **{name: [300.0, -200.0, 180.0]})
    assert any(f"{name} is [300.0, -200.0, 180.0], which can only be millimetres" in f for f in faults)


@pytest.mark.parametrize("arm", ["ur5", "so101"])
def test_an_arm_in_millimetres_or_with_a_joint_that_copies_is_named(arm, tmp_path):
    described = ARMS[arm][0]
    text = Path(described.urdf).read_text()

    def fault(changed):
        (tmp_path / "arm.urdf").write_text(changed)
        fields = {"urdf": "arm.urdf", "flange": described.flange, "home_rad": list(described.home_rad)}
        return " ".join(station(tmp_path, arm=fields))

    def thousand(found):
        return f'xyz="{" ".join(str(1000 * float(x)) for x in found[1].split())}"'

    assert fault(text) == ""
    assert "can only be millimetres" in fault(re.sub(r'(?<=<origin )xyz="([^"]*)"', thousand, text))
    first, copy = re.findall(r'<joint name="([^"]+)" type="revolute"', text)[:2]
    end = text.index("</joint>", text.index(f'<joint name="{copy}"'))
    mimic = f'<mimic joint="{first}" multiplier="-1"/>'
    assert f"joint '{copy}' copies '{first}' (mimic)" in fault(text[:end] + mimic + text[end:])
    assert fault(text[:end] + f"<!-- {mimic} -->" + text[end:]) == ""


def test_a_station_is_looked_at_with_the_conditions_that_its_twin_asks_for(tmp_path):
    station(tmp_path)
    twin = Twin.builtin()
    twin.effects = {"thermal": {}}
    (fault,) = check_path(tmp_path / "station.yaml", twin).faults
    assert "needs the condition 'temperature_c'" in fault


HUGE = 10**400, [[]], None, {"value": float("nan")}


@pytest.mark.parametrize("value", HUGE, ids=[repr(v)[:12] for v in HUGE])
def test_a_file_with_any_number_in_any_place_is_read_or_one_sentence(value, tmp_path):
    """Every field of a twin, a station and a recording in turn; nothing but an InputError may come out."""
    twin = Twin.builtin()
    twin.effects = {"creep": {"share": Value(0.1, (0.05, 0.2))}}
    twin.save(tmp_path)
    for path in places(content := yaml.safe_load((tmp_path / "twin.yaml").read_text())):
        (tmp_path / "twin.yaml").write_text(yaml.safe_dump(put(content, path, value)))
        refused(lambda: Twin.load(tmp_path))
        Twin.faults(tmp_path)
    corner = [0.3, -0.2, 0.2]
    content = {"format": "pneutac-station/1", "workspace_low_m": corner, "mount_mm": 20, "control_hz": 15}
    content |= {"latency_s": 0.1, "home_m": [0.4, 0.0, 0.3], "arm": "ur5"}
    for path in places(content):
        (tmp_path / "station.yaml").write_text(yaml.safe_dump(put(content, path, value)))
        refused(lambda: Station.load(tmp_path / "station.yaml"))
    content = {"device": "finger", "length_mm": 100, "noise": {"bend_angle_rad": 0.1}}
    content |= {
        "samples": "samples.csv",
        "trials": {"0": {"start": "rested"}},
        "spine_joint_positions_mm": [10, 50],
        "supply_kpa": 3,
    }
    folder = write(tmp_path / "r", table(80))
    for path in places(content):
        (folder / "recording.json").write_text(json.dumps(put(content, path, value)))
        refused(lambda: Recording.load(folder))


def places(content, before=()):
    pairs = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in pairs:
        yield (*before, key)
        if isinstance(value, dict | list):
            yield from places(value, (*before, key))


def put(content, path, value):
    """A copy with a value in one place; a place that is not there is made."""
    content = json.loads(json.dumps(content))
    inside = content
    for key in path[:-1]:
        inside = inside.setdefault(key, {}) if isinstance(inside, dict) else inside[key]
    inside[path[-1]] = value
    return content
