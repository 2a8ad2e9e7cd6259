"""What the results of all verbs share: `result.json`, a report, a look in a notebook."""

from pathlib import Path

import numpy as np
from PIL import Image

from lerobot_pneutac.reports.page import Report, write_result


class Result:
    """Base of the frozen dataclasses that the verbs return.

    Attributes:
        title: heading of table and report.
        findings: what the checks of the recording found, one sentence each.
    """

    title: str = ""
    findings: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """What a reader should take away; empty where the table says it all."""
        return ""

    def rows(self) -> list[dict]:
        """The short table; each row has the same keys."""
        return []

    def remarks(self) -> list[str]:
        """What a reader should know beside the table, one sentence each."""
        return []

    def to_dict(self) -> dict:
        """The content of `result.json`."""
        raise NotImplementedError

    def page(self) -> Report:
        """The report, not yet written."""
        page = Report(self.title)
        if self.sentence:
            page.lead(self.sentence)
        page.table(self.rows())
        return page

    def pictures(self) -> dict[str, np.ndarray]:
        """Pictures that lie beside the report, file name to uint8 (H, W, 3)."""
        return {}

    def report(self, out: str | Path, command: str = "") -> Path:
        """Writes `result.json`, `report.html` and pictures into folder `out`; returns the page's path.

        Args:
            out: folder, made where there is none.
            command: that does it again, shown at the end of the page.
        """
        write_result(out, self.to_dict())
        for name, picture in self.pictures().items():
            Image.fromarray(picture).save(Path(out) / name)
        page = self.page()
        if command:
            page.heading("Do it again")
            page.code(command)
        return page.write(out)

    def __repr__(self) -> str:
        """Kind and sentence; the numbers are in `to_dict`."""
        return f"<{type(self).__name__}: {self.sentence or self.title}>"

    def _repr_html_(self) -> str:
        page = Report(self.title)
        page.lead(self.sentence)
        page.table(self.rows())
        for remark in self.remarks():
            page.text(remark)
        return page.fragment()
