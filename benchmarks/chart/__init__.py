"""The work-precision study behind docs/speed-accuracy: `make chart`, or `python -m benchmarks.chart`."""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before NumPy is loaded: one processor for everyone
