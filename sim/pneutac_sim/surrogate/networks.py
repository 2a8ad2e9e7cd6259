"""The two networks of a twin: its own, or those that are shipped for the built-in finger and gel."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from pneutac_sim.errors import InputError, option
from pneutac_sim.surrogate.finger import SurrogateFinger, network_of
from pneutac_sim.surrogate.fingerprint import gel_fingerprint
from pneutac_sim.surrogate.network import ActionNetwork
from pneutac_sim.surrogate.perception import GelSurrogate
from pneutac_sim.twin import NETWORKS, Twin

_LOAD = {"action": ActionNetwork.load, "perception": GelSurrogate.load}
_OF = {"action": "finger", "perception": "gel"}


def builtin(name: str) -> Path:
    """File of the network that is shipped for the built-in twin, one of `NETWORKS`."""
    return Path(str(files("pneutac_sim.surrogate") / f"builtin_{name}.safetensors"))


def fits(file: Path, name: str, twin: Twin) -> bool:
    """Whether a network was trained for this twin, or for one of another modulus, by which it is scaled."""
    return _of(twin, _LOAD[name](file)) is not None


def _of(twin: Twin, network: ActionNetwork | GelSurrogate):
    """The network as this twin has it; None where it was trained for another one."""
    if isinstance(network, ActionNetwork):
        return network_of(twin, network)
    return network if network.fingerprint == gel_fingerprint(twin) else None


@dataclass(frozen=True)
class Networks:
    """What stands in for the material points of one twin.

    Attributes:
        action: f_r, of the finger.
        gel: f_m, of the gel.
    """

    action: ActionNetwork
    gel: GelSurrogate

    @classmethod
    def of(cls, twin: Twin) -> "Networks":
        """The networks of a twin.

        Raises:
            InputError: it has none, they are damaged, or they were trained for another one.
        """
        found = {}
        for name in NETWORKS:
            own = twin.networks.get(name)
            network = _of(twin, _LOAD[name](own or builtin(name)))
            if network is None:
                why = (
                    f"{own} was trained for another {_OF[name]}, or before its shape or material changed"
                    if own
                    else f"The twin has no {name} network, and its {_OF[name]} is not the built-in one"
                )
                raise InputError(
                    f"{why}; run `pneutac surrogate {option('twin', own.parent if own else 'DIR')}`, "
                    "or choose the "
                    "fidelity `probe`, which needs none."
                )
            found[name] = network
        return cls(found["action"], found["perception"])

    def finger(self, twin: Twin) -> SurrogateFinger:
        """The finger of this twin, bent by the action network."""
        return SurrogateFinger(twin, self.action)
