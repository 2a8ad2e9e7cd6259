"""The page that a browser gets: the viewer's own, which also says when the studio is gone."""

from pathlib import Path

import viser

from lerobot_pneutac.studio.gate import ALIVE

SAYS = (
    "The studio cannot be reached. Start `pneutac studio` again at this port, and this page goes on; "
    "what was written is kept."
)
LOOKS = (
    "position:fixed; z-index:9999; top:1em; left:50%; transform:translateX(-50%); max-width:30em; "
    "padding:.8em 1em; font:16px sans-serif; color:#fff; background:#b3261e; border-radius:6px"
)
WATCH = f"""
<div id="lost" role="alert" style="{LOOKS}" hidden>{SAYS}</div>
<script>
setInterval(async () => {{
  const lost = document.getElementById("lost");
  try {{ lost.hidden = (await fetch("{ALIVE}", {{cache: "no-store"}})).ok; }} catch {{ lost.hidden = false; }}
}}, 2000);
</script>
"""


def front_page() -> bytes:
    """HTML, UTF-8."""
    page = Path(viser.__file__).parent / "client" / "build" / "index.html"
    return page.read_text(encoding="utf-8").replace("</body>", f"{WATCH}</body>").encode()
