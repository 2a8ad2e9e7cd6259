import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from lerobot_pneutac.cli import VERBS, options_class
from lerobot_pneutac.cli.benchmark import TABLES
from lerobot_pneutac.cli.options import list_options, name_option, parse_options
from pneutac_sim.errors import InputError


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


@pytest.mark.parametrize(
    "argv", [["--tasks=b,c", "--seeds=3", "--size=4,5"], ["--tasks=[b, c]", "--seeds=[3]", "--size=[4, 5]"]]
)
def test_a_list_needs_no_brackets(argv):
    assert parse_options(Options, argv) == Options(("b", "c"), (3,), (4, 5))


def test_a_bad_number_in_a_list_is_one_sentence():
    with pytest.raises(InputError, match="seeds"):
        parse_options(Options, ["--seeds=x"])


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["--overwrite"], True),
        (["--overwrite", "--program=x"], True),
        (["--overwrite=true"], True),
        (["--overwrite", "true"], True),
        (["--overwrite=false"], False),
        ([], False),
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
        (["--out", "--overwrite"], "--out has no value; write --out=VALUE."),
        (["bench"], "'bench' is not an option; they are written --name=value."),
    ],
)
def test_a_wrong_option_is_one_sentence(argv, sentence):
    with pytest.raises(InputError) as e:
        parse_options(Options, argv)
    assert str(e.value) == sentence


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("seeds=-1 must be 0 or more.", "--seeds=-1 must be 0 or more."),
        ("horizon is 1; it must be 2 or more.", "--planner.horizon is 1; it must be 2 or more."),
        ("depth is 1; it must be 2 or more.", "depth is 1; it must be 2 or more."),
        ("outside/x.csv is empty.", "outside/x.csv is empty."),
        ("out of memory.", "out of memory."),
        ("planner.horizon is missing.", "--planner.horizon is missing."),
    ],
)
def test_a_librarys_sentence_about_a_parameter_is_told_of_the_option(sentence, told):
    assert name_option(sentence, Options) == told


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("program: [a", "line 1, is not valid YAML: expected"),
        ("- program", "must hold options"),
        ("programm: x", "no option --programm; did you mean --program?"),
        ("planner: {horizont: 3}", "horizont"),
        ("\xff\x00", "is not valid YAML"),
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


def test_a_file_in_place_of_the_folder_for_results_is_refused(tmp_path):
    (tmp_path / "o").touch()
    with pytest.raises(InputError, match=r"^--out=.* is a file; give a folder\.$"):
        parse_options(Options, [f"--out={tmp_path / 'o'}"])


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
