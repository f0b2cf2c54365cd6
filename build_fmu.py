"""Build RotaryCrane.fmu: ``python build_fmu.py [-o DIR]``."""

from crane_fmu.build import main

if __name__ == "__main__":
    raise SystemExit(main())
