"""Twin, diagnose and train soft pneumatic fingers with camera-based touch, inside LeRobot.

```python
from lerobot_pneutac import Recording, Twin, add, calibrate, compare, diagnose

recording = Recording.load("bench")
twin = calibrate(Twin.load("finger"), recording).twin
print(compare(twin, recording).heldout, diagnose(twin, recording).verdict)
result = add(twin, recording, "creep")
result.report("out")
```

Importing registers the Gymnasium environments `pneutac_sim/switch` and so on, and loads nothing else.
"""

import importlib
from typing import TYPE_CHECKING

import pneutac_sim  # noqa: F401  registers the environments

if TYPE_CHECKING:
    from lerobot_pneutac.verbs.add import Addition, add
    from lerobot_pneutac.verbs.calibrate import calibrate
    from lerobot_pneutac.verbs.compare import compare
    from lerobot_pneutac.verbs.control import Control, control
    from lerobot_pneutac.verbs.design import Design, PressDesign, design, design_press
    from lerobot_pneutac.verbs.design_motion import MotionDesign, design_motion
    from lerobot_pneutac.verbs.diagnose import Diagnosis, diagnose
    from lerobot_pneutac.verbs.learn import Learning, learn
    from lerobot_pneutac.verbs.result import Calibration, Comparison
    from pneutac_datasets.demonstrations.reading import Demonstrations, load_demonstrations
    from pneutac_datasets.recording.recording import Recording
    from pneutac_sim.errors import InputError
    from pneutac_sim.twin import Twin

_NAMES = {
    "pneutac_sim.twin": "Twin",
    "pneutac_sim.errors": "InputError",
    "pneutac_datasets.recording.recording": "Recording",
    "pneutac_datasets.demonstrations.reading": "Demonstrations load_demonstrations",
    "lerobot_pneutac.verbs.result": "Calibration Comparison",
    "lerobot_pneutac.verbs.calibrate": "calibrate",
    "lerobot_pneutac.verbs.compare": "compare",
    "lerobot_pneutac.verbs.control": "Control control",
    "lerobot_pneutac.verbs.design": "Design PressDesign design design_press",
    "lerobot_pneutac.verbs.design_motion": "MotionDesign design_motion",
    "lerobot_pneutac.verbs.diagnose": "Diagnosis diagnose",
    "lerobot_pneutac.verbs.learn": "Learning learn",
    "lerobot_pneutac.verbs.add": "Addition add",
}
_MODULES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = [
    "Addition", "Calibration", "Comparison", "Control", "Demonstrations", "Design", "Diagnosis", "InputError",
    "Learning", "MotionDesign", "PressDesign", "Recording", "Twin", "add", "calibrate", "compare", "control",
    "design", "design_motion", "design_press", "diagnose", "learn", "load_demonstrations",
]  # fmt: skip


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module 'lerobot_pneutac' has no attribute '{name}'")
    value = getattr(importlib.import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
