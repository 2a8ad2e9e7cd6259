from dataclasses import dataclass
from pathlib import Path

import pytest

from lerobot_pneutac.cli.options import parse_options
from pneutac_sim.errors import InputError


@dataclass
class Options:
    tasks: tuple[str, ...] = ("a",)
    seeds: tuple[int, ...] | None = None
    size: tuple[int, int] = (1, 2)
    out: Path = Path("x,y")
    program: str = "all"


@pytest.mark.parametrize(
    "argv", [["--tasks=b,c", "--seeds=3", "--size=4,5"], ["--tasks=[b, c]", "--seeds=[3]", "--size=[4, 5]"]]
)
def test_a_list_needs_no_brackets(argv):
    assert parse_options(Options, argv) == Options(("b", "c"), (3,), (4, 5))


def test_texts_keep_their_commas():
    found = parse_options(Options, ["--out=p,q", "--program=steps,ramps"])
    assert (found.out, found.program) == (Path("p,q"), "steps,ramps")


def test_a_bad_number_in_a_list_is_one_sentence():
    with pytest.raises(InputError, match="seeds"):
        parse_options(Options, ["--seeds=x"])
