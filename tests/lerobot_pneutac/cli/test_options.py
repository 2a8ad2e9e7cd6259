"""How far a verb has come, on a terminal and elsewhere.

What a hostile recording names reaches the terminal and the report as plain text.

The command `pneutac`, whatever its verb.

A lab's own table at the command line: shown once, confirmed, kept beside it, checked.
"""

import ast
import io
import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console
from snapshots import Sentences

from lerobot_pneutac.cli import VERBS, _dispatch, main, options_class, run_verb
from lerobot_pneutac.cli import terminal as module
from lerobot_pneutac.cli.benchmark import TABLES
from lerobot_pneutac.cli.options import list_options, name_option, parse_options
from lerobot_pneutac.cli.terminal import progress_bar, show
from lerobot_pneutac.verbs.calibrate import calibrate
from lerobot_pneutac.verbs.check import USAGE, check_path
from lerobot_pneutac.verbs.result import Result
from pneutac_datasets.recording.recording import Recording
from pneutac_datasets.recording.sources.plain import refuse_other_axes
from pneutac_sim.errors import InputError
from pneutac_sim.twin import Twin


@dataclass
class Planner:
    """A group.

    Attributes:
        horizon: steps that a plan
            looks ahead.
    """

    horizon: int = 10


@dataclass
class Options:
    """Options of a command.

    Attributes:
        tasks: which ones.
        seeds: of everything: 100 % of it.
        size: both.
        out: folder.
        program: its name.
        planner: a group.
        overwrite: whether what is there goes.
    """

    tasks: tuple[str, ...] = ("a",)
    seeds: tuple[int, ...] | None = None
    size: tuple[int, int] = (1, 2)
    out: Path = Path("x,y")
    program: str = "all"
    planner: Planner = field(default_factory=Planner)
    overwrite: bool = False


@pytest.mark.parametrize("text", ["2026-13-40", "2026-02-30", "2026-03-01"])
def test_a_date_is_a_text_even_where_there_is_no_such_day(text):
    assert parse_options(Options, [f"--program={text}"], "x").program == text


@pytest.mark.parametrize(
    "argv", [["--tasks=b,c", "--seeds=3", "--size=4,5"], ["--tasks=[b, c]", "--seeds=[3]", "--size=[4, 5]"]]
)
def test_a_list_needs_no_brackets(argv):
    assert parse_options(Options, argv) == Options(("b", "c"), (3,), (4, 5))


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["--overwrite"], True),
        (["--overwrite", "true"], True),
        (["--overwrite=false"], False),
    ],
)
def test_a_flag_may_stand_alone(argv, expected):
    assert parse_options(Options, argv).overwrite is expected


@pytest.mark.parametrize(
    ("argv", "sentence"),
    [
        (["--overwrit"], "There is no option --overwrit; did you mean --overwrite?"),
        (["--horizon=3"], "There is no option --horizon; did you mean --planner.horizon?"),
        (
            ["--zzz=3"],
            "There is no option --zzz; the options are --tasks, --seeds, --size, --out, --program, "
            "--planner.horizon, --overwrite.",
        ),
        (["--out"], "--out has no value; write --out=VALUE."),
        (["bench"], "'bench' is not an option; they are written --name=value."),
        (
            ["--seeds=[1"],
            "--seeds is '[1'; it must be a whole number, or several with commas, as in --seeds=A,B.",
        ),
        (["--size=@"], "--size is '@'; it must be 2 whole numbers with commas, as in --size=A,B."),
        (["--planner.horizon=true"], "--planner.horizon is 'true'; it must be a whole number."),
        (["--overwrite=1"], "--overwrite is '1'; it must be true or false."),
    ],
)
def test_a_wrong_option_is_one_sentence(argv, sentence):
    with pytest.raises(InputError) as e:
        parse_options(Options, argv)
    assert str(e.value) == sentence


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("horizon is 1; it must be 2 or more.", "--planner.horizon is 1; it must be 2 or more."),
        ("outside/x.csv is empty.", "outside/x.csv is empty."),
        ("size=3 must go with seeds=1.", "--size=3 must go with --seeds=1."),
        ("Run `pneutac new --size=3`, or a/size=3.", "Run `pneutac new --size=3`, or a/size=3."),
        ("planner.horizon is missing.", "--planner.horizon is missing."),
    ],
)
def test_a_librarys_sentence_about_a_parameter_is_told_of_the_option(sentence, told):
    assert name_option(sentence, Options) == told
    assert name_option("size is of a finger.", Options, ["--out=size"]) == "size is of a finger."


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("program: [a", "line 1, is not valid YAML: expected"),
        ("programm: x", "no option --programm; did you mean --program?"),
        ("\xff\x00", "is no text in UTF-8"),
        ("planner: {horizon: true}", r"o\.yaml: planner\.horizon is True; it must be a whole number"),
        ("out: 20260301", r"o\.yaml: out is 20260301; it must be a path"),
    ],
)
def test_a_bad_file_of_options_is_one_sentence(tmp_path, content, sentence):
    file = tmp_path / "o.yaml"
    file.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError, match=sentence) as e:
        parse_options(Options, [f"--config_path={file}"])
    assert "\n" not in str(e.value)


def test_a_file_of_options_is_read_and_the_command_line_wins(tmp_path):
    file = tmp_path / "o.yaml"
    file.write_text("program: x\nplanner: {horizon: 3}\nseeds: [1, 2]")
    found = parse_options(Options, [f"--config_path={file}", "--program=y"])
    assert (found.program, found.planner.horizon, found.seeds) == ("y", 3, (1, 2))


def test_names_may_look_like_numbers_and_hold_spaces(tmp_path):
    folder = tmp_path / "a b"
    folder.mkdir()
    (folder / "o.yaml").write_text("seeds:")
    argv = [f"--config_path={folder / 'o.yaml'}", "--out=20260301", "--tasks=1,true", "--program=1e3"]
    found = parse_options(Options, argv)
    assert (found.out, found.tasks, found.program, found.seeds) == (
        Path("20260301"),
        ("1", "true"),
        "1e3",
        None,
    )


def test_a_number_that_would_fill_the_memory_is_refused_before_the_work():
    """A billion of what is counted or held at once; what comes one after the other may be as many."""
    tried = 0
    for command in ("demo", *(f"benchmark {name}" for name in TABLES)):
        kind = options_class(command)
        for option in list_options(kind):
            if option.kind is int and not option.name.endswith(("seed", "steps", "updates")):
                tried += 1
                with pytest.raises(InputError, match=rf"^(--)?{option.name} is 1(0*|e\+09)[;.]"):
                    parse_options(kind, [f"--{option.name}={10**9}"])
    assert tried > 30


# What a verb needs beside the option that is tried; others need nothing, or `--out`.
NEEDED = {"new": "--twin=o", "measure": "--bench=standin --out=o", "convert": "--source=t.csv"}
NEEDED |= dict.fromkeys(
    ("calibrate", "compare", "diagnose", "add", "design"), "--twin=finger --recording=bench"
)
NEEDED |= {"studio": "--twin=finger", "history": "--twin=finger", "ppo": "--out=o --student.root=s"}
NEEDED |= dict.fromkeys(("learn", "control", "surrogate", "render"), "--twin=finger --out=o")
NEEDED["benchmark worlds"] = "--device=cpu"  # where it has -1 processes, none
NEEDED["add"] += " --effect=creep"
NEEDED["augment"] = "--dataset.repo_id=local/d --dataset.root=d --output.repo_id=local/e --output.root=e"
NEEDED["augment"] += " --method=planner"
# Options that may be 0, as a seed, or below, as a place; `learn` refuses a budget with what it needs.
ZERO = r"seed|first_seed|seeds|jobs|port|restore|base_id|tip_rgb|base_rgb|samples|fingers|arms|hidden|person"
ZERO += r"|start_width|real_share|films|arm_minutes|check_mpm|min_kpa|noise|processes|.*_weight|jitter_.*"
ZERO += "|start_range"
SIGNED = r"(min|max|pressure)_kpa|base_offset_mm|offset_s|conditions|[xy]_mm|yaw_rad|(azimuth|elevation)_deg"
SIGNED += "|budget_min"


@pytest.mark.parametrize("verb", sorted({*NEEDED, *(f"benchmark {name}" for name in TABLES)}))
def test_no_number_is_nonsense(verb, tmp_path, monkeypatch):
    """Two of nan, inf, -1, 0 and 1e308 in turn: what cannot be is one sentence, and writes nothing."""
    monkeypatch.chdir(tmp_path)
    for folder in ("finger", "bench", "d"):
        Path(folder).mkdir()
    Path("t.csv").touch()
    kind, turn = options_class(verb), sorted([*NEEDED, *TABLES, verb]).index(verb)
    for k, option in enumerate(list_options(kind)):
        numbers = re.findall("int|float", str(option.kind))
        if not numbers or "Path" in str(option.kind):
            continue
        every = (".nan", ".inf", "-1", "0", str(10**308) if set(numbers) == {"int"} else "1e308")
        for bad in (every[(turn + k) % 5], every[(turn + k + 2) % 5]):
            several = str(option.kind).startswith("tuple") and "..." not in str(option.kind)
            value = ",".join([bad] * (len(numbers) if several else 1))
            value = f"{{temperature_c: {bad}}}" if "dict" in str(option.kind) else value
            name = option.name.rpartition(".")[2]
            fine = (
                re.fullmatch(SIGNED, name) and bad in ("-1", "0") or re.fullmatch(ZERO, name) and bad == "0"
            )
            fine = fine or (verb, name, bad) == ("benchmark worlds", "processes", "-1")
            try:
                parse_options(kind, [*shlex.split(NEEDED.get(verb, "")), f"--{option.name}={value}"])
            except InputError as e:
                assert name in str(e) and "\n" not in str(e) and len(str(e)) < 300, e
            else:
                assert fine, f"{verb} takes --{option.name}={value}"
    assert {p.name for p in tmp_path.iterdir()} == {"finger", "bench", "d", "t.csv"}


@pytest.mark.parametrize(("verb", "meant"), [("fit", "calibrate"), ("record", "measure"), ("chek", "check")])
def test_a_verb_of_another_name_is_understood(verb, meant, monkeypatch):
    monkeypatch.setattr("sys.argv", ["pneutac", verb])
    with pytest.raises(SystemExit, match=f"no command '{verb}'; did you mean '{meant}'"):
        main()


def test_help_tells_every_option_with_its_default(capsys):
    with pytest.raises(SystemExit) as e:
        parse_options(Options, ["--help"])
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert e.value.code == 0
    for line in (
        "--tasks=A,B which ones (default a).",
        "--seeds=A,B of everything: 100 % of it.",
        "--overwrite whether what is there goes.",
        "--planner.* a group.",
        "--planner.horizon=INT steps that a plan looks ahead (default 10).",
    ):
        assert line in lines


@pytest.mark.parametrize("name", [*VERBS, *(f"benchmark {t}" for t in TABLES)])
def test_every_option_of_every_verb_has_a_help_text(name):
    config = options_class(name)
    if name in ("benchmark", "check", "doctor"):
        assert config is None
        return
    mute = [o.name for o in list_options(config) if not o.text and not o.name.startswith(("camera", "digit"))]
    assert mute == []  # those of LeRobot's cameras are LeRobot's


def _texts(tree):
    """Each text of a file that is no docstring, with {} where it is filled in."""
    inside = {id(part) for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for part in n.values}
    inside |= {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
    for n in ast.walk(tree):
        if isinstance(n, ast.JoinedStr):
            yield "".join(v.value if isinstance(v, ast.Constant) else "{}" for v in n.values)
        elif isinstance(n, ast.Constant) and isinstance(n.value, str) and id(n) not in inside:
            yield n.value


def _options(verb):
    """Names of a command's options, those of `check` as its usage lists them."""
    kind = options_class(verb)
    known = {o.name for o in list_options(kind)} | set(getattr(kind, "aliases", ())) if kind else set()
    return known | set(re.findall(r"--([\w.]+)", USAGE)) if verb == "check" else known


def test_every_command_in_a_sentence_has_the_options_that_stand_there():
    """`pneutac VERB --option` in any text of the product, and bare options in the sentences of a verb."""
    root, wrong, seen = Path(__file__).parents[3], [], 0
    known = {verb: _options(verb) for verb in (*VERBS, *(f"benchmark {name}" for name in TABLES))}
    folders = ("lerobot_pneutac", "datasets", "sim", "robots", "packages")
    for file in (f for name in folders for f in (root / name).rglob("*.py")):
        for text in _texts(ast.parse(file.read_text())):
            for verb, rest in re.findall(r"pneutac (benchmark \w+|\w+)((?: (?!pneutac )[^`]*)?)", text):
                for option in re.findall(r"--(\w[\w.]*\w)", rest) if verb in known else ():
                    seen += 1
                    wrong += [(file.name, text)] * (option not in {*known[verb], "help", "config_path"})
    for name in ("options", "sentences"):  # what a verb answers to bad input
        said = Sentences(name).said
        for case, sentence in ((c, s) for c, s in said.items() if c.startswith("pneutac ")):
            verb = " ".join(case.split()[1 : 2 + case.startswith("pneutac benchmark")])
            for option in re.findall(r"(?<![\w-])--(\w[\w.]*\w)", re.sub(r"`[^`]*`", "", sentence)):
                seen += 1
                own = option in {*known.get(verb, ()), "help", "config_path"}
                foreign = re.match(r"(robot|dataset|teleop)\.", option) or f"no option --{option}" in sentence
                wrong += [(case, sentence)] * (not own and not foreign)
    assert wrong == [] and seen > 150


@pytest.mark.parametrize("first", ["", "Frame,"])
def test_a_remedy_of_check_works_when_it_is_pasted(tmp_path, first):
    rows = "".join(f"{f'{k},' * bool(first)}{k % 9},{100 - k % 9},{k % 9}\n" for k in range(99))
    (tmp_path / "a b.csv").write_text(f"{first}p_cmd [kPa],x [mm],z [mm]\n{rows}")
    [fault] = check_path(tmp_path / "a b.csv").faults
    [command] = re.findall("`pneutac convert ([^`]*--rate_hz[^`]*)`", fault)
    run_verb("convert", [*shlex.split(command), "--yes"])
    assert check_path(tmp_path / "a b.csv").kind == "bench recording"


def _pneutac(*argv, **options):
    command = [sys.executable, "-m", "lerobot_pneutac.cli", *argv]
    return subprocess.run(command, capture_output=True, text=True, **options)


def test_version_and_the_list_of_verbs():
    assert _pneutac("--version").stdout.startswith("pneutac 0.")
    listed = _pneutac("--help").stdout
    assert all(f"  {verb} " in listed for verb in VERBS)


def test_a_reader_that_has_seen_enough_is_no_error():
    command = f"'{sys.executable}' -m lerobot_pneutac.cli --help"
    out = subprocess.run(["bash", "-c", f"set -o pipefail; {command} | true"], capture_output=True, text=True)
    assert out.stderr == ""


def test_without_a_terminal_there_is_a_line_at_once_and_every_ten_seconds(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    console = Console(file=io.StringIO(), width=80)
    with progress_bar(console) as progress:
        for i in range(25):
            now[0] = float(i)
            progress("fitting", i, 25)
    left = ", about 1 min left"
    assert console.file.getvalue().splitlines() == [
        "fitting: 0 of 25", *(f"fitting: {i} of 25{left}" for i in (10, 20))
    ]  # fmt: skip


def test_time_left_counts_from_the_first_that_was_done(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    console = Console(file=io.StringIO(), width=80)
    with progress_bar(console) as progress:
        for second, done in ((0, 0), (400, 0), (480, 1), (540, 2), (600, 3)):  # it compiles for eight minutes
            now[0] = float(second)
            progress("making", done, 10)
    *before, second, third = console.file.getvalue().splitlines()
    assert before[-1] == "making: 1 of 10"
    assert (second, third) == ("making: 2 of 10, about 8 min left", "making: 3 of 10, about 7 min left")


def test_a_terminal_gets_a_bar_that_leaves_nothing_behind():
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with progress_bar(console) as progress:
        progress("fitting with and without a friction of many small elements", 19, 240)
        end = time.monotonic() + 60
        while "19/240" not in console.file.getvalue() and time.monotonic() < end:
            time.sleep(0.05)
    drawn = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", console.file.getvalue())
    assert "fitting with and without a ..." in drawn and "19/240 0:00:0" in drawn and "…" not in drawn
    assert "fitting" not in console.file.getvalue().split("\r")[-1]


HOSTILE = "a\x1b[2J[/nothing] <script>alert(1)</script> \x9b31m"


@dataclass(frozen=True)
class Hostile(Result):
    title = "Hostile"
    findings = (HOSTILE,)

    @property
    def sentence(self):
        return HOSTILE

    def rows(self):
        return [{"program": HOSTILE, "error": 1.0}]

    def remarks(self):
        return [f"[bold]where:[/] {HOSTILE}", "[bold]plain[/]"]

    def to_dict(self):
        return {"program": HOSTILE}


def test_names_are_text_on_a_terminal():
    out = io.StringIO()
    show(Hostile(), Console(file=out, width=200))
    text = out.getvalue()
    assert "\x1b" not in text and "\x9b" not in text
    assert text.count("\\x1b[2J[/nothing]") == 4 and text.count("<script>") == 4
    assert "[bold]plain" not in text


def test_names_are_text_in_a_report(tmp_path):
    page = Hostile().report(tmp_path, "pneutac compare '<script>'").read_text()
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page


@pytest.mark.parametrize("character", ["\x1b", "\r", "\u202e"])
def test_no_message_moves_a_terminals_cursor(character):
    assert character not in str(InputError(f"field '{character}' is unknown."))


SWALLOWED = """
import os, signal, sys, threading, time
from lerobot_pneutac import cli
def verb(argv):
    try:
        os.kill(os.getpid(), getattr(signal, sys.argv[1]))
        time.sleep(60)
    except KeyboardInterrupt:
        pass  # as Taichi's import does
    lock = threading.Lock()
    with lock:  # as where the interrupt comes between a wait's release and its taking the lock back
        lock.release()
        time.sleep(60)
signal.signal(getattr(signal, sys.argv[1]), signal.SIG_DFL)  # what started the tests may ignore it
cli._dispatch, sys.argv[0] = verb, "pneutac"
cli.main()
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_that_a_library_swallows_comes_again(name):
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED, name], capture_output=True, text=True, timeout=300
    )
    assert (done.returncode, done.stderr) == (130, "pneutac: interrupted.\n")


def test_an_interrupted_command_says_whether_it_goes_on(monkeypatch, capsys):
    def interrupted(argv):
        sys.argv[0] = f"pneutac {argv[0]}"
        raise KeyboardInterrupt

    monkeypatch.setattr("lerobot_pneutac.cli._dispatch", interrupted)
    for verb in ("surrogate", "diagnose"):
        monkeypatch.setattr(sys, "argv", ["pneutac", verb])
        with pytest.raises(SystemExit):
            main()
    assert capsys.readouterr().err.splitlines() == [
        "pneutac surrogate: interrupted; the same command goes on from what is finished.",
        "pneutac diagnose: interrupted; only what ends is stored, so the same command begins anew.",
    ]


OWN = "trial program time_s pressure_cmd_kpa tip_x_mm tip_y_mm tip_z_mm temperature_c payload_g gravity_x"
LAB = "Lauf,Programm,Zeit [s],p_soll [bar],x,y,z,Temp,Gewicht [g],gx,gy,gz"
COLUMNS = dict(zip([*OWN.split(), "gravity_y", "gravity_z"], LAB.split(","), strict=True))


def bench():
    """Three runs of a finger of 73 mm, by a recording's names, with the digits that CSV keeps."""
    runs, parts = (("stairs", 21.4, 0), ("warm", 39.1, 0), ("payload", 21.4, 2.7)), []
    for run, (program, warm, load) in enumerate(runs):
        t = np.round(np.arange(0, 20, 0.05), 2)
        p = np.round(np.clip(12 * np.floor(t / 4), 0, 48), 3)
        z = np.round(0.6 * p + 0.05 * np.sin(7 * t + run), 3)
        x = np.round(np.sqrt(73.0**2 - z**2), 3)
        values = run + 1, program, t, p, x, 0.1, z, warm, load, 0.0, 0.0, -1.0
        parts.append(pd.DataFrame(dict(zip(COLUMNS, values, strict=True))))
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """`lab.csv` of German names, semicolons, decimal commas, bar and metres, and one file a run."""
    monkeypatch.chdir(tmp_path)
    table = bench()
    table["pressure_cmd_kpa"] = (table["pressure_cmd_kpa"] / 100).round(6)
    for a in "xyz":
        table[f"tip_{a}_mm"] = (table[f"tip_{a}_mm"] / 1000).round(6)
    table = table.rename(columns=COLUMNS)
    table.to_csv("lab.csv", sep=";", decimal=",", index=False)
    (tmp_path / "runs").mkdir()
    for run, rows in table.groupby("Lauf"):
        rows.to_csv(f"runs/lauf_{run}.csv", sep=";", decimal=",", index=False)
    monkeypatch.setattr(sys, "stdin", open("/dev/null"))
    return tmp_path


@pytest.mark.parametrize(("given", "kept"), [("lab.csv", "lab"), ("runs/*.csv", "runs/lauf_1_to_lauf_3")])
def test_one_command_goes_from_a_table_to_a_twin(folder, capsys, given, kept):
    with pytest.raises(SystemExit, match="Add --yes if this is right"):
        _dispatch(["new", "--twin=twin", f"--recording={given}"])
    assert not (folder / "twin").exists()
    capsys.readouterr()
    _dispatch(["new", "--twin=twin", f"--recording={given}", "--yes"])
    said = capsys.readouterr().out
    shown = said.partition("Stored in")[0]
    assert "3 runs, 59.8 s, 20 Hz (semicolons, decimal commas)" in shown and "length 73 mm" in shown
    assert len(shown.split()) <= 80
    recording = Recording.load(f"{kept}.recording")
    stored, own = recording.samples[list(COLUMNS)], bench()[list(COLUMNS)]
    pd.testing.assert_frame_equal(stored, own, check_dtype=False, rtol=0, atol=1e-12)
    _dispatch(["compare", "--twin=twin", f"--recording={given}"])
    assert "Lauf" not in capsys.readouterr().out  # shown once
    _dispatch(["check", given])
    assert "good" in capsys.readouterr().out


def test_a_changed_table_is_converted_again_by_its_mapping(folder, capsys):
    _dispatch(["convert", "lab.csv", "--yes"])
    meta = json.loads((folder / "lab.recording" / "recording.json").read_text())
    mine = json.dumps(meta | {"noise": {}, "notes": "mine"})
    (folder / "lab.recording" / "recording.json").write_text(mine)
    lines = (folder / "lab.csv").read_text().splitlines()
    (folder / "lab.csv").write_text("\n".join(lines[:-10]) + "\n")
    capsys.readouterr()
    _dispatch(["new", "--twin=twin", "--recording=lab.csv"])
    assert "Stored in lab.recording, by lab.recording/mapping.yaml" in capsys.readouterr().out
    recording = Recording.load("lab.recording")
    assert len(recording) == len(lines) - 11 and recording.meta["notes"] == "mine"
    (folder / "other.csv").write_text("\n".join(lines[:-20]) + "\n")
    _dispatch(["compare", "--twin=twin", "--recording=other.csv", "--mapping=lab.recording/mapping.yaml"])
    (folder / "theirs.recording").mkdir()
    (folder / "theirs.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(SystemExit, match="theirs.recording exists and is no earlier conversion"):
        _dispatch(["new", "--twin=t2", "--recording=theirs.csv", "--yes"])


AXES = {  # of a table: columns of the right one, and what turns it
    "y": ({"tip_x_mm": "x", "tip_z_mm": "y"}, 1, "--base_z=y"),
    "-y": ({"tip_x_mm": "x", "tip_z_mm": "y"}, -1, "--base_z=-y"),
    "-z": ({"tip_x_mm": "x", "tip_y_mm": "y", "tip_z_mm": "z"}, -1, "--base_z=-z"),
    "z along": ({"tip_x_mm": "z", "tip_z_mm": "x"}, 1, "--base_x=z --base_z=x"),
    "y along": ({"tip_x_mm": "y", "tip_z_mm": "z"}, 1, "--base_x=y"),
}


@pytest.mark.parametrize("axes", AXES)
def test_a_tip_in_other_axes_is_refused_with_the_command_that_turns_it(folder, capsys, axes):
    names, sign, turn = AXES[axes]
    units = "m" if "along" in axes else "mm"
    right = bench()
    table = right[["time_s", "trial", "pressure_cmd_kpa"]].rename(columns={"pressure_cmd_kpa": "p [kPa]"})
    for column, name in names.items():
        values = right[column] * (sign if column == "tip_z_mm" else 1)
        table[name + " [mm]" * (units == "mm")] = values / (1000 if units == "m" else 1)
    table.to_csv("turned.csv", index=False)
    new = ["new", "--twin=twin", "--recording=turned.csv", "--yes"]
    with pytest.raises(SystemExit, match="where .* must point; `pneutac convert turned.csv") as refused:
        _dispatch(new)
    assert not (folder / "twin").exists() and not (folder / "turned.recording").exists()
    command = re.search("`pneutac (.*?)`", str(refused.value))[1]
    assert turn in command
    _dispatch(shlex.split(command))
    _dispatch(new)
    tip = Recording.load("turned.recording").samples[["tip_x_mm", "tip_z_mm"]].to_numpy()
    np.testing.assert_allclose(tip, right[["tip_x_mm", "tip_z_mm"]], atol=1e-9)


def test_a_recording_in_other_axes_is_refused_until_the_command_has_turned_it(folder):
    right = bench()
    flat = right.drop(columns=["tip_y_mm"]).rename(columns={"tip_z_mm": "tip_y_mm"})
    Recording(folder, {"device": "finger", "length_mm": 73.0}, flat, "finger").write(folder / "flat")
    twin = Twin("finger", 73.0, [20.0, 50.0])
    for refuses in (
        lambda: _dispatch(["new", "--twin=twin", "--recording=flat"]),
        lambda: _dispatch(["check", "flat"]),
        lambda: calibrate(twin, Recording.load("flat")),
    ):
        with pytest.raises((SystemExit, InputError)) as refused:
            refuses()
    command = re.search("`pneutac (.*?)`", str(refused.value))[1]
    assert command == "convert flat/samples.csv --base_z=y --length_mm=73 --out=flat_turned"
    _dispatch(shlex.split(command))
    refuse_other_axes(Recording.load("flat_turned"))
    assert Recording.load("flat_turned").length_mm == 73.0


def test_an_earlier_conversion_is_replaced_only_where_that_is_said(folder):
    _dispatch(["convert", "lab.csv", "--yes"])
    _dispatch(["convert", "lab.csv", "--yes"])  # the same again
    stored = (folder / "lab.recording" / "samples.csv").read_bytes()
    other = ["convert", "lab.csv", "--yes", "--columns=p_soll [bar]: pressure_cmd_kpa [psi]"]
    with pytest.raises(SystemExit, match="lab.recording holds a conversion of other tables or with other"):
        _dispatch(other)
    for line in (other, ["convert", "runs/lauf_1.csv", "--yes"]):
        with pytest.raises(SystemExit, match="--out=lab.recording holds a recording; give another folder"):
            _dispatch([*line, "--out=lab.recording"])
    assert (folder / "lab.recording" / "samples.csv").read_bytes() == stored
    _dispatch([*other, "--replace", "--out=lab.recording"])
    assert (folder / "lab.recording" / "samples.csv").read_bytes() != stored


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("new --twin=t --recording=lab.xlsx", "There is no file 'lab.xlsx'"),
        ("new --twin=t --recording=lbb.csv", "There is no file 'lbb.csv'; there is lab.csv."),
        ("new --twin=t --recording=none/*.csv", "There is no file 'none/\\*.csv'"),
        (
            "convert lab.csv --columns={p_soll[bar]:pressure_cmd_kpa}",
            "has no column 'p_soll\\[bar\\]'; it has",
        ),
        ("convert lab.csv --columns=[", "columns is '\\[', which names no column"),
        ("convert lab.csv --base=1,2", "--base is '1,2'; of a table give three mm"),
        ("convert lab.csv --base_x=z --base_z=z", "--base_x is 'z' and base_z 'z'; give two different"),
        ("convert lab.csv --mapping=lab.csv", "name: value"),
        (
            "calibrate --twin=t --recording=lab.csv --mapping=none.yaml",
            "--mapping is 'none.yaml', which is no file",
        ),
        ("convert runs --out=x", "is no ROS 2 bag|is missing"),
    ],
)
def test_what_is_wrong_is_one_sentence(folder, line, says):
    with pytest.raises(SystemExit, match=says) as e:
        _dispatch(line.split())
    assert str(e.value).count("\n") == 0
    assert not (folder / "t").exists()


def test_check_tells_what_is_open_in_a_table(folder, capsys):
    (folder / "open.csv").write_text("t,p,x,z\n0,0,70,0\n0.1,1,69,5\n0.2,2,68,9\n")
    with pytest.raises(SystemExit):
        _dispatch(["check", "open.csv"])
    assert "'p' (0 to 2) has no unit" in " ".join(capsys.readouterr().out.split())


def test_a_table_with_the_columns_of_a_confirmed_one_is_not_asked_about(folder):
    shutil.copy("lab.csv", "friday.csv")
    other = pd.read_csv("lab.csv", sep=";", decimal=",").rename(columns={"Lauf": "Versuch"})
    other.to_csv("other.csv", sep=";", decimal=",", index=False)
    _dispatch(["new", "--twin=twin", "--recording=lab.csv", "--yes"])
    _dispatch(["compare", "--twin=twin", "--recording=friday.csv"])
    assert (folder / "friday.recording" / "recording.json").is_file()
    with pytest.raises(SystemExit, match="Add --yes if this is right"):
        _dispatch(["compare", "--twin=twin", "--recording=other.csv"])
