"""The failure atlas behind docs/stability: `make atlas`, or `python -m benchmarks.atlas`.

One file a row. A row shows a way in which servo-constraint integration fails as theory predicts, and beside it a route
of this library that does not fail.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))  # some rows measure the mechanisms of the tests
