"""`pneutac effects`: what it lists and shows, and that an exported file does what the effect does."""

import importlib.util
import re
import sys

import numpy as np
import pytest
from verbs import refused, verb

from lerobot_pneutac.cli import run_verb
from lerobot_pneutac.verbs.effects import effect_source, file_name, list_effects, show_effect, tips
from pneutac_sim.effects.body_effect import BodyEffect
from pneutac_sim.effects.laws import law_names
from pneutac_sim.effects.registry import all_effects, body_effects, get_effect
from pneutac_sim.errors import InputError


@pytest.fixture
def load(tmp_path):
    def of(name: str):
        path = tmp_path / f"{file_name(name)}.py"
        path.write_text(effect_source(name))
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        sys.modules[path.stem] = module
        spec.loader.exec_module(module)
        return module.EFFECT

    yield of
    for name in law_names():
        sys.modules.pop(file_name(name), None)


def bench(effect: BodyEffect):
    """A signal that moves, rests and turns back, and conditions that move."""
    rng = np.random.default_rng(3)
    n = 400
    channels = 5 if effect.of_markers else 2
    x = np.cumsum(rng.normal(0, 1.0, (n, channels)), axis=0)
    x[100:160] = x[100]
    x = 12.0 * np.abs(x) / np.abs(x).max()
    dt = rng.uniform(0.03, 0.07, n)
    conditions = rng.uniform(0.5, 1.5, (n, len(effect.columns))) * 30.0
    return x, dt, conditions


SOME = ("play(p)^3", "lag(p; time moves with dT)", "tip_y += x z")


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_an_exported_law_does_what_the_law_does(name, load):
    law, own = get_effect(name), load(name)
    x, dt, conditions = bench(law)
    expected = law.apply(x, dt, {"weight": 0.3}, conditions)
    assert np.abs(expected - x).max() > 1e-3
    np.testing.assert_allclose(
        own.apply(x, dt, {"weight": 0.3}, conditions), expected, rtol=1e-12, atol=1e-12
    )
    assert own.parameters == law.parameters and own.name == file_name(name) != name


@pytest.mark.parametrize("name", law_names())
def test_every_law_can_be_exported(name, load):
    """The file runs as Python; that it computes the law is tried of some laws above, of all nightly."""
    law, own = get_effect(name), load(name)
    assert own.name == file_name(name) != name and own.stage == law.stage
    assert (own.parameters, own.columns, own.of_markers) == (law.parameters, law.columns, law.of_markers)


def test_an_exported_law_holds_what_it_runs_alone():
    text = effect_source("lag(p)")
    assert 'lag_p = "lag_p:EFFECT"' in text and "pneutac.effects" in text and "TIMES_S" not in text
    assert set(re.findall(r"def (\w+)", text)) == {"lag_weights", "_lag", "lag", "pressure", "run_drive"}


@pytest.mark.parametrize("name", ["lag(p^2)", "hysteresis", "shadow"])
def test_show_writes_a_page(name, tmp_path, capsys):
    verb("effects", "show", name, out=tmp_path / "page")
    page = (tmp_path / "page" / "report.html").read_text()
    assert ("Plotly.newPlot" in page) == (name in body_effects() or name == "lag(p^2)")
    out = capsys.readouterr().out
    assert "equation:" in out and show_effect(name).sentence[-40:] in " ".join(out.split())
    assert show_effect(name).to_dict()["parameters"]


@pytest.mark.parametrize("name", [*all_effects(), *law_names()])
def test_the_sentence_of_a_catalogue_speaks_of_nobodys_device(name):
    assert not re.search(r"\b[Yy]our\b", sentence := show_effect(name).sentence) and sentence[0].isupper()


def test_a_late_law_makes_the_tip_late():
    t, command_kpa, without, with_it = tips("lag(p)")
    held = (t > 15) & (t < 20)
    rising = (t > 8.0) & (t < 8.4)
    assert np.abs(with_it - without)[rising].max() > 20 * np.abs(with_it - without)[held & (t > 19)].max()
    assert command_kpa.max() == 12.0


def test_export_writes_a_new_file_once(tmp_path):
    out = tmp_path / "mine.py"
    verb("effects", "export", "lag(p^2)", out=out)
    assert "EFFECT = BodyEffect(" in out.read_text()
    refused("is there already; give a new name", "effects", "export", "lag(p^2)", out=out)


WRONG = (
    (["cook"], "no action of effects"),
    (["show"], "Name the effect"),
    (["show", "crep"], "did you mean 'creep'"),
)


@pytest.mark.parametrize("argv, sentence", WRONG)
def test_what_is_wrong_is_told(argv, sentence):
    with pytest.raises(InputError, match=sentence):
        run_verb("effects", argv)


def test_list_names_all(capsys):
    verb("effects", "list")
    out = capsys.readouterr().out
    assert "creep" in out and "tracker_lag" in out
    assert len(list_effects()) == len(all_effects()) + len(law_names())
