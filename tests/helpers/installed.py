"""Packages with entry points beside the library, as an installer leaves them."""

import sys
from contextlib import contextmanager


def install(folder, module, group, points, code=None):
    """A package of one module, with entry points {name: "module:object"} of a group of ours."""
    info = folder / f"{module}-0.1.0.dist-info"
    info.mkdir(parents=True)
    name = module.replace("_", "-")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 0.1.0\n")
    lines = [f"[pneutac.{group}]", *(f"{k} = {v}" for k, v in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    if code is not None:
        (folder / f"{module}.py").write_text(code)


@contextmanager
def packages(folder, monkeypatch, group, found):
    """Gives a function that installs a package for as long as this lasts; `found` keeps what is installed."""
    modules = []

    def make(module, code, points):
        install(folder, module, group, points, code)
        modules.append(module)
        monkeypatch.syspath_prepend(folder)
        found.cache_clear()

    yield make
    for module in modules:
        sys.modules.pop(module, None)
    found.cache_clear()
