"""Run the notebooks of the gallery, each in a kernel of its own: `make docs` has made them of the stories."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

GALLERY = Path(__file__).parent / "gallery"
STORIES = Path(__file__).parents[1] / "examples"
_LONGEST = 600
"""Time in s that a cell may take."""


def main() -> int:
    """Run every notebook in the folder of the stories; returns 1 if a cell fails or there is no notebook."""
    notebooks = sorted(GALLERY.glob("story_*.ipynb"))
    if len(notebooks) != len(list(STORIES.glob("story_*.py"))):
        print(f"{GALLERY} does not hold a notebook of every story: make docs writes them", file=sys.stderr)
        return 1
    for notebook in notebooks:
        begun = time.perf_counter()
        client = NotebookClient(
            nbformat.read(notebook, as_version=4),  # type: ignore[no-untyped-call]  # nbformat has no types for it
            timeout=_LONGEST,
            resources={"metadata": {"path": str(STORIES)}},
            extra_arguments=["--log-level=ERROR"],
        )
        try:
            client.execute()
        except CellExecutionError as error:
            print(f"{notebook.name}: {error}", file=sys.stderr)
            return 1
        print(f"{notebook.name} runs as a notebook, {time.perf_counter() - begun:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
