"""Build RotaryCrane.fmu: ``python build_fmu.py [-o DIR]``, which is ``crane-fmu build``."""

import sys

from crane_fmu.cli import main

if __name__ == "__main__":
    sys.argv[1:1] = ["build"]
    main()
