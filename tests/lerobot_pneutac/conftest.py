import pytest


@pytest.fixture(scope="module")
def no_soft_body():
    """Calibrations leave the joint stiffness as it is: its fit runs material points, for a minute."""
    from lerobot_pneutac.verbs import fit_body

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_body, "fit_compliance", lambda twin, *_: fit_body.Compliance(twin, ""))
        yield
