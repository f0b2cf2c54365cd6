"""``python -m crane_fmu``: the same as the command ``crane-fmu``."""

from crane_fmu.cli import main

main()
