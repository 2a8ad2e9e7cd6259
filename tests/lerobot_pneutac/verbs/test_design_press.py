"""`pneutac design` of a gel: the press that tells models apart."""

import json
from dataclasses import replace

import pandas as pd
import pytest
from generated import once
from verbs import refused, verb

from lerobot_pneutac.diagnosis.result import Candidate
from lerobot_pneutac.verbs.design import held_choice
from lerobot_pneutac.verbs.diagnose import save_candidates
from pneutac_datasets.generate.gel import write_gel_recording
from pneutac_datasets.recording.gel import GelRecording
from pneutac_datasets.recording.recording import Recording
from pneutac_sim.errors import InputError
from pneutac_sim.gel.fit import fit_presses
from pneutac_sim.gel.model import GelModel
from pneutac_sim.twin import Twin

CREEP = {"late_4s": 0.05, "late_20s": 0.1, "late_100s": 0.05}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return once(write_gel_recording, tmp_path_factory.mktemp("gel") / "recording", seed=2, heldout=4)


@pytest.fixture(scope="module")
def models(recording):
    """Two gels that differ by a fifth of their shadows' depth, fitted to the same presses otherwise."""
    data = GelRecording.load(recording)
    photographs = data.samples
    gel = fit_presses(photographs, data.px_per_mm, ("shadow",), data.thickness_mm).gel
    made = []
    for share, terms, probability in ((1.0, ("shadow",), 0.6), (0.8, (), 0.4)):
        shadow = {k: v * (share if "levels" in k else 1.0) for k, v in gel.effects["shadow"].items()}
        twin = Twin("gel", 16.0)
        replace(gel, effects={"shadow": shadow}).into_twin(twin)
        made.append(Candidate(twin, terms, probability))
    return made


def test_models_that_predict_the_same_are_told_apart_by_none(recording, models, tmp_path, capsys):
    save_candidates(tmp_path / "same", [models[0], Candidate(models[0].twin, (), 0.4)])
    twin = models[1].twin.save(tmp_path / "twin")
    common = [f"--twin={twin}", f"--recording={recording.folder}"]
    verb("design", *common, f"--diagnosis={tmp_path / 'same'}")
    assert "No press of these indenters would distinguish" in " ".join(capsys.readouterr().out.split())

    save_candidates(tmp_path / "apart", models)
    verb("design", *common, f"--diagnosis={tmp_path / 'apart'}", f"--out={tmp_path / 'out'}")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert not result["tells_little"] and [c["terms"] for c in result["contenders"]] == [["shadow"], []]
    assert "data:image/png;base64" in (tmp_path / "out" / "report.html").read_text()
    # Its row describes a press as a recording does.
    (row,) = pd.read_csv(tmp_path / "out" / "press.csv").to_dict("records")
    samples = recording.samples.iloc[:1].assign(**row)
    (again,) = GelRecording.load(Recording(recording.folder, recording.meta, samples, "gel")).samples
    assert {"x_mm": again.press.x_mm, "depth_mm": again.press.depth_mm}.items() <= result["press"].items()

    with pytest.raises(InputError, match="max_kpa is of a bench's program, not of a gel's press"):
        verb("design", *common, f"--diagnosis={tmp_path / 'apart'}", "--max_kpa=10")
    refused("contenders.json; give the folder", "design", *common, f"--diagnosis={tmp_path / 'nothing'}")


def test_two_presses_are_asked_for_where_creep_is_in_question(recording, models, tmp_path, capsys):
    """The first is held, the second comes soon and elsewhere; of one press nobody could tell."""
    data = GelRecording.load(recording)
    proposed = held_choice(data, models)
    assert (
        proposed.assumed
        and proposed.seen
        and "To find whether it creeps, hold the sphere" in proposed.sentence
    )
    assert (proposed.hold_s, proposed.wait_s) == (60.0, 3.0)
    assert proposed.first.depth_mm > proposed.press.depth_mm
    gel = GelModel.from_twin(models[0].twin)
    faint = replace(gel, effects=gel.effects | {"gel_creep": dict.fromkeys(CREEP, 1e-3)})
    strong = replace(gel, effects=gel.effects | {"gel_creep": CREEP})
    made = []
    for g, terms in ((strong, ("gel_creep",)), (gel, ())):
        twin = Twin("gel", 16.0)
        g.into_twin(twin)
        made.append(Candidate(twin, terms, 0.5))
    faint.into_twin(twin := Twin("gel", 16.0))
    small = held_choice(data, [Candidate(twin, ("gel_creep",), 0.5), made[1]])
    assert not small.seen and "too little to see" in small.sentence
    save_candidates(tmp_path / "creep", made)
    given = [f"--twin={made[1].twin.save(tmp_path / 'twin')}", f"--recording={recording.folder}"]
    verb("design", *given, f"--diagnosis={tmp_path / 'creep'}", f"--out={tmp_path / 'out'}")
    assert "for 60 s and lift it" in " ".join(capsys.readouterr().out.split())
    rows = pd.read_csv(tmp_path / "out" / "press.csv")
    samples = recording.samples.iloc[:2].reset_index(drop=True).assign(**rows)
    first, then = GelRecording.load(Recording(recording.folder, recording.meta, samples, "gel")).samples
    assert [(e.press, e.held_s, e.since_s) for e in then.earlier] == [(first.press, 60.0, 5.0)]
