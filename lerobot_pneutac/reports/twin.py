"""The page of `pneutac report`: a twin, its history and its numbers."""

from lerobot_pneutac.reports.compare import history
from lerobot_pneutac.reports.page import Report


def twin_page(r) -> Report:
    """The report of a `TwinReport`."""
    page = Report(r.title)
    page.lead(r.sentence)
    if r.twin.history:
        page.heading("How it became so")
        for unit in dict.fromkeys(e["unit"] for e in r.rows() if e["unit"]):
            entries = [e for e in r.rows() if e["unit"] == unit]
            if len(entries) > 1:
                page.figure(history(entries, unit), "Errors as each version recorded them.", 340)
        page.table(r.rows())
    if r.twin.effects:
        page.heading("What its effects do")
        page.text("\n\n".join(r.described()))
    page.heading("Its numbers")
    page.table(r.parameters(), "Units are in the names; where no interval stands, none was fitted.")
    if "rest_image" in r.twin.arrays:
        page.heading("Its touch sensor without contact")
        page.image(r.twin.arrays["rest_image"], width=240)
    return page
