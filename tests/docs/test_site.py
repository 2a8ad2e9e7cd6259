"""What the site is generated from; `make docs` builds all of it, strictly.

The map: its generated part is up to date, every file and name exists; thresholds of the diagnosis.

The page's state machine is the firmware's, and the tests that it names exist.
"""

import re

import controller_states as states
import pytest
from doc_blocks import FENCE, ROOT
from latex2mathml.converter import convert
from lerobot.cameras import CameraConfig
from lerobot.configs import PreTrainedConfig
from lerobot.envs.configs import EnvConfig
from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig
from pressure_rig import build

import lerobot_robot_pneutac  # noqa: F401
from lerobot_pneutac.cli import PLUGIN_VERBS, VERBS
from lerobot_pneutac.diagnosis import thresholds
from pneutac_sim.effects import all_effects
from pneutac_sim.effects.laws import law_names
from pneutac_sim.effects.registry import get_effect
from pneutac_sim.features import task_names

GENERATED = {
    "concepts/effects.md",
    "concepts/laws.md",
    "concepts/places.md",
    "reference/commands.md",
    "changes.md",
    "contributing.md",
}


def test_the_page_of_installation_has_every_verb_where_it_runs():
    page = (ROOT / "docs" / "install.md").read_text()
    bench, plugin = re.findall(r"^\| `\w+` (?:alone|too) \| (.*?)(?:; also .*)? \|$", page, re.MULTILINE)
    verbs = [[words.split()[0] for words in re.findall(r"`(.*?)`", row)] for row in (bench, plugin)]
    assert sorted(verbs[1]) == sorted(PLUGIN_VERBS)
    assert sorted(verbs[0]) == sorted(set(VERBS) - set(PLUGIN_VERBS))


@pytest.mark.parametrize("name", [*all_effects(), *law_names()])
def test_an_effect_shows_its_equation(name):
    assert convert(get_effect(name).equation.replace("|", r"\vert ")).startswith("<math")


def test_the_table_of_places_has_every_effect_and_asks_the_places(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "generate")
    import catalogue

    page = catalogue.places_page()
    assert all(f"| `{name}` |" in page for name in all_effects())
    rows = [line for line in page.splitlines() if line.startswith(("| `", "| law"))]
    assert len(rows) < len(all_effects()) + 12 and all(r.count("|") == rows[0].count("|") for r in rows)
    assert catalogue.places("thermal") == ("joints",) * 5
    assert catalogue.places("tip_y += x z") == ("tip", "tip; no pictures", "tip", "tip", "tip")
    assert catalogue.places("base_tilt") == ("tip",) * 5
    assert catalogue.places("camera_misalignment") == (*("reading",) * 4, "-")
    assert catalogue.places("shadow") == (*("image",) * 4, "area")
    assert catalogue.places("registration_shift") == ("photographs", "-", "-", "-", "-")


def test_what_a_reader_runs_meets_no_folder_of_another_page():
    runs = [ROOT / "README.md", *ROOT.glob("docs/tutorials/*.md"), *ROOT.glob("examples/*.py")]
    folders = [set(re.findall(r"outputs/(\w+)", p.read_text())) - {"demo"} for p in runs]
    assert sum(map(len, folders)) == len(set().union(*folders)) > 8


def test_every_page_is_in_the_navigation_and_the_other_way_round():
    nav = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text().partition("\nnav:")[2]))
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs").rglob("*.md")}
    tables = {f"results/{p.relative_to(ROOT / 'benchmarks')}" for p in (ROOT / "benchmarks").rglob("*.md")}
    tables = {t.replace("README.md", "index.md") for t in tables}
    notes = {t for t in tables if t.startswith("results/notes/")}  # for developers; results link to them
    assert notes and nav == pages | GENERATED | tables - notes


def test_every_relative_link_resolves_in_the_repository():
    pages = [*ROOT.glob("*.md"), *(p for top in ("docs", "benchmarks") for p in (ROOT / top).rglob("*.md"))]
    links = [
        (page.relative_to(ROOT), link)
        for page in pages
        for link in re.findall(r"\]\((?![a-z]+:|#)([^)\s#]+)", FENCE.sub("", page.read_text()))
        if not (page.parent / link).exists()
    ]
    assert len(pages) > 60 and links == []


def test_the_page_on_lerobot_has_every_task_and_every_type():
    page = (ROOT / "docs/lerobot.md").read_text()
    kinds = (RobotConfig, TeleoperatorConfig, CameraConfig, EnvConfig, PreTrainedConfig)
    ours = ("lerobot_robot_pneutac.", "lerobot_camera_digit.")
    types = [n for k in kinds for n, c in k.get_known_choices().items() if c.__module__.startswith(ours)]
    assert len(types) > 13 and [n for n in (*types, *task_names()) if f"`{n}`" not in page] == []


PAGE = (ROOT / "docs/concepts/map.md").read_text()


@pytest.fixture
def idea_map(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "generate")
    import idea_map

    return idea_map


def test_effects_and_commands_are_up_to_date(idea_map):
    assert PAGE.endswith(idea_map.generated()), "run `python docs/generate/idea_map.py`"


def test_every_file_and_name_exists(idea_map):
    assert not idea_map.missing(PAGE)
    assert idea_map.missing("`sim/none.py`, `sim/pneutac_sim/twin.py`: `Other`") == [
        "sim/none.py",
        "sim/pneutac_sim/twin.py Other",
    ]


def test_it_has_every_equation_of_the_paper():
    """Five are numbered there; the others stand in its text."""
    numbered = [f"paper, eq. {n}:" for n in range(1, 6)]
    others = r"q^{cmd}_n|L\,\nabla d_g|\tau_s =|\tau_r^\star =|f_m :|o_t =|1000\,|\hat I - I_{indent}"
    assert [text for text in (*numbered, *others.split("|")) if text not in PAGE] == []


def test_the_page_of_the_diagnosis_has_the_thresholds_of_the_code():
    page = (ROOT / "docs/concepts/diagnosis.md").read_text()
    rows = re.findall(r"^\| `([A-Z_]+)` \| ([\d.]+) \|", page, re.M)
    assert len(rows) > 9
    assert [(name, float(value)) for name, value in rows if getattr(thresholds, name) != float(value)] == []
    assert len(page.split()) <= 900


@pytest.fixture(scope="module")
def found():
    return states.transitions(build())


def test_table_and_picture_are_the_firmwares_own(found):
    assert states.BEGIN + "\n" + states.table(found) + "\n" + states.END in states.PAGE.read_text()
    picture, leads = states.PICTURE.read_text(), {e for (s, e), new in found.items() if new != s}
    assert all(f">{text}<" in picture for text in leads | set(states.STATES))


def test_only_following_has_air_and_only_a_set_point_leads_there(found):
    into = {(state, event) for (state, event), new in found.items() if new == "following" != state}
    assert into == {("ready", "set-point within the limits")}
    assert {new for (_, event), new in found.items() if event == "a fault"} == {"fault"}


def test_every_test_that_is_named_exists():
    names = set(re.findall(r"`(test_\w+\.py)`", states.PAGE.read_text()))
    assert len(names) > 4
    assert not [name for name in names if not (ROOT / "tests/robots/hardware" / name).exists()]
