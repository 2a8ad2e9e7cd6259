"""Every block of the tutorials, and of the how-to pages that need no hardware, runs as printed."""

import os
import re
from pathlib import Path

import pytest
from doc_blocks import blocks, run_block, run_page

NIGHTLY = pytest.mark.nightly

pytestmark = pytest.mark.timeout(1200)  # two busy cores; a page takes one or two minutes on idle ones


@pytest.mark.parametrize(
    "page",
    [
        # The same verbs are in the README, and in the tests of tables and networks.
        pytest.param("docs/tutorials/your_csv.md", marks=NIGHTLY),
        pytest.param("docs/tutorials/missing_effect.md", marks=NIGHTLY),
        pytest.param("docs/how_to/read_a_diagnosis.md", marks=NIGHTLY),
        pytest.param("docs/tutorials/digit_from_two_images.md", marks=NIGHTLY),
        pytest.param("docs/how_to/networks.md", marks=NIGHTLY),
        # The same loop, without augmentation and stand-in, is in test_plugin_loop.
        pytest.param("docs/tutorials/train_on_the_switch.md", marks=[NIGHTLY, pytest.mark.timeout(2400)]),
        pytest.param("docs/tutorials/own_finger.md", marks=NIGHTLY),
        pytest.param("docs/how_to/pictures.md", marks=NIGHTLY),
        pytest.param("docs/how_to/photographs.md", marks=NIGHTLY),
        # It searches again after each of a dozen programs.
        pytest.param("docs/how_to/ask_the_bench.md", marks=[NIGHTLY, pytest.mark.timeout(2400)]),
        pytest.param("docs/how_to/command_a_bend.md", marks=NIGHTLY),
        pytest.param("docs/how_to/take_the_finger_along.md", marks=NIGHTLY),
        pytest.param("docs/how_to/demonstrations.md", marks=NIGHTLY),
        pytest.param("docs/how_to/scene_cameras.md", marks=NIGHTLY),
        pytest.param("docs/how_to/several_chambers.md", marks=NIGHTLY),
    ],
)
def test_blocks_run(page, tmp_path):
    run_page(page, tmp_path)


@NIGHTLY
def test_blocks_on_photographs_print_the_errors_that_their_comments_tell(tmp_path):
    page = "docs/tutorials/digit_from_two_images.md"
    if "PNEUTAC_DATA" not in os.environ:
        pytest.skip("PNEUTAC_DATA is unset: there are no real photographs to calibrate to")
    (tmp_path / "digit_fots").symlink_to(Path(os.environ["PNEUTAC_DATA"]) / "tactile" / "digit_fots")
    (block,) = [b for b in blocks(page) if b.why == "needs the photographs"]
    printed = run_block(page, block, tmp_path)
    told = re.findall(r"#.*?(\d+\.\d+) levels", block.text)
    assert len(told) == 2
    assert all(f"error is {x} levels" in printed for x in told), printed
