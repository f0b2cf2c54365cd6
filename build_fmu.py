"""Build RotaryCrane.fmu: ``python build_fmu.py [-o DIR]``."""

import sys

NEEDED = "build_fmu.py: the package {} is needed for this: pip install '.[fmu]'"

try:
    from crane_fmu.build import main
except ModuleNotFoundError as error:
    sys.exit(NEEDED.format(error.name))

if __name__ == "__main__":
    try:
        raise SystemExit(main())
    except ModuleNotFoundError as error:
        sys.exit(NEEDED.format(error.name))
