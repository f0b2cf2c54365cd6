"""Build RotaryCrane.fmu: ``python build_fmu.py [-o DIR]``."""

import sys

try:
    from crane_fmu.build import main
except ModuleNotFoundError as error:
    sys.exit(f"build_fmu.py: the package {error.name} is needed for this: pip install '.[fmu]'")

if __name__ == "__main__":
    raise SystemExit(main())
