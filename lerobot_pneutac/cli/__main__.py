"""`python -m lerobot_pneutac.cli VERB`: the command `pneutac`, where it is not on the PATH."""

from lerobot_pneutac.cli import main

main()
